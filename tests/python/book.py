"""Runs chapters of the book and holds what they print against the block of text behind each block of code.

    pip install nbformat nbclient ipykernel matplotlib polars duckdb iceoryx2==0.10.0
    python book.py CHAPTER.md ... [--write] [--notebooks DIR] [--examples DIR]

A chapter's blocks of `bash` and `python` run in its order, in one kernel and one temporary folder, with `ema` from PATH and the
example programs of --examples beside them; a block of `toml` or `text` whose fence names a file (```toml file=NAME) is written there. In a block of expected
output `...` stands for anything within a line and, alone on a line, for any lines. --write puts
what was printed where it differs, and renews the pictures and, in --notebooks, the notebooks; without it pictures must have been drawn and
notebooks must hold the chapter's code.

Exit code: 0 as expected, 1 not, 2 command line.
"""

import argparse
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import nbclient
import nbformat
from nbformat.v4 import new_code_cell, new_markdown_cell, new_notebook

FENCE = re.compile(r"^```(\w+)(?: file=(\S+))?\n(.*?)^```\n", re.M | re.S)
EXPECTED = re.compile(r"\s*```text\n(.*?)^```\n", re.M | re.S)
PICTURE = re.compile(r"^!\[.*?\]\(\.\./pictures/(\S+?)\)\n", re.M)
SECONDS = 300


class Block:
    """A block of code, and where what it should print stands in the chapter."""

    def __init__(self, language, code, expected):
        self.language, self.code, self.expected = language, code, expected

    @property
    def source(self):
        return ("%%bash\n" if self.language == "bash" else "") + self.code.rstrip("\n")


def parts(text):
    """Text, files and blocks of a chapter, in order; of expected output its span."""
    at = 0
    while found := FENCE.search(text, at):
        language, file, body = found.groups()
        if file:
            # the reader sees it, the notebook writes it
            yield text[at : found.start()]
            yield Block("python", f"%%writefile {file}\n{body}", None)
            at = found.end()
        elif language in ("bash", "python"):
            yield text[at : found.start()]
            expected = EXPECTED.match(text, found.end())
            yield Block(language, body, expected and expected.span(1))
            at = expected.end() if expected else found.end()
        else:
            yield text[at : found.end()]
            at = found.end()
    yield text[at:]


def notebook(text):
    """The chapter as a notebook without outputs, and its blocks in the order of code cells."""
    cells, blocks = [], []
    for part in parts(text):
        if isinstance(part, Block):
            cells.append(new_code_cell(part.source))
            blocks.append(part)
        elif words := PICTURE.sub("", part).strip():
            cells.append(new_markdown_cell(words))
    for k, cell in enumerate(cells):
        cell["id"] = f"cell-{k}"
    return new_notebook(cells=cells), blocks


def sources(book):
    return [(c.cell_type, c.source) for c in book.cells]


def without(folder, text):
    """Paths of the folder that it ran in say nothing."""
    return text.replace(folder + "/", "").replace(folder, ".")


def printed(cell):
    """What a cell has written to standard output, and its value."""
    out = ""
    for o in cell.outputs:
        if o.output_type == "stream" and o.name == "stdout":
            out += o.text
        elif o.output_type == "execute_result":
            out += o.data["text/plain"] + "\n"
    return out


def pattern(expected):
    """What matches `expected`, `...` being anything."""
    lines = []
    for line in expected.splitlines(keepends=True):
        if line.strip() == "...":
            lines.append("(?:.*\n)*?")
        else:
            lines.append(r"[^\n]*?".join(re.escape(part) for part in line.split("...")))
    return re.compile("".join(lines))


def run(path, args):
    """Runs a chapter; returns what is not as it should be, in words."""
    text = path.read_text()
    book, blocks = notebook(text)
    wrong = []
    with tempfile.TemporaryDirectory() as folder:
        if args.examples:
            for file in Path(args.examples).glob("*.py"):
                shutil.copy(file, folder)
        # a command that fails is not passed over, in the middle of a block neither
        strict = Path(folder, ".strict")
        strict.write_text("set -e\n")
        os.environ["BASH_ENV"] = str(strict)
        client = nbclient.NotebookClient(book, timeout=SECONDS, record_timing=False, resources={"metadata": {"path": folder}})
        try:
            client.execute()
        except nbclient.exceptions.CellExecutionError as e:
            return [f"{path.name}: {e.ename}: {e.evalue}\n{e.traceback[-1500:]}"]
        renewed, at = "", 0
        for cell, block in zip((c for c in book.cells if c.cell_type == "code"), blocks):
            if block.expected is None:
                continue
            start, end = block.expected
            told = without(folder, printed(cell))
            if not pattern(text[start:end]).fullmatch(told):
                wrong.append(f"{path.name}: after\n{block.code}expected\n{text[start:end]}found\n{told}")
                renewed, at = renewed + text[at:start] + told, end
        renewed += text[at:]
        for name in PICTURE.findall(text):
            drawn = Path(folder, name)
            if not drawn.exists():
                wrong.append(f"{path.name}: {name} is not drawn")
            elif args.write:
                target = path.parent.parent / "pictures"
                target.mkdir(exist_ok=True)
                shutil.copy(drawn, target / name)
    if args.write:
        path.write_text(renewed)
    if args.notebooks:
        file = Path(args.notebooks, path.stem + ".ipynb")
        if args.write:
            for cell in book.cells:
                cell.metadata.clear()
                for o in cell.get("outputs", []):
                    if o.output_type == "stream":
                        o.text = without(folder, o.text)
            book.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
            file.parent.mkdir(exist_ok=True)
            nbformat.write(book, file)
        elif not file.exists() or sources(nbformat.read(file, 4)) != sources(notebook(text)[0]):
            wrong.append(f"{file.name} is not of the chapter any more: book.py --write")
    return [] if args.write else wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("chapters", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help="put what was printed into the chapters; renew pictures and notebooks")
    parser.add_argument("--notebooks", help="folder of the notebooks")
    parser.add_argument("--examples", help="folder of Python programs that chapters use")
    args = parser.parse_args()
    # the kernel and what it starts find Python's own programs too
    os.environ["PATH"] = os.pathsep.join([os.environ["PATH"], str(Path(sys.executable).parent)])
    wrong = [w for chapter in args.chapters for w in run(chapter, args)]
    print("\n".join(wrong) or "as expected")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
