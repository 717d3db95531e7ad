"""The SQL of `ema query` beside that of DuckDB, over the same Parquet files.

usage: sql_answers.py FOLDER EMA      asks both, and says where they differ
       sql_answers.py FOLDER --write  writes FOLDER/answers.txt anew, from DuckDB

FOLDER holds TABLE.csv files and answers.txt: each statement behind `> `, and its answer as CSV.
"""

import csv
import io
import math
import pathlib
import subprocess
import sys
import tempfile

import duckdb

CODECS = {"actuators": "gzip", "features": "snappy"}


def dataset(folder, out):
    """The tables as a dataset folder, written by DuckDB."""
    for source in sorted(folder.glob("*.csv")):
        table = out / source.stem
        table.mkdir()
        target = table / "part-0000.parquet"
        codec = CODECS.get(source.stem, "zstd")
        duckdb.sql(f"COPY (FROM read_csv('{source}', nullstr='')) TO '{target}' (FORMAT parquet, COMPRESSION {codec})")


def names(columns):
    """Columns of one name told apart as DuckDB tells them apart in a data frame."""
    seen, out = {}, []
    for c in columns:
        k = seen.get(c, 0)
        out.append(f"{c}_{k}" if k else c)
        seen[c] = k + 1
    return out


def text(value):
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return str(value)


def duck(connection, statement):
    answer = connection.execute(statement)
    header = names([d[0] for d in answer.description])
    return [header] + [[text(v) for v in row] for row in answer.fetchall()]


def ema(program, data, statement):
    command = [program, "query", statement, "--data", str(data), "--format", "csv"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        return [[done.stderr.strip()]]
    return list(csv.reader(io.StringIO(done.stdout)))


def same_cell(a, b):
    try:
        return math.isclose(float(a), float(b), rel_tol=1e-9, abs_tol=1e-12)
    except ValueError:
        return a == b


def same(a, b):
    rows = len(a) == len(b) and all(len(x) == len(y) for x, y in zip(a, b))
    return rows and all(same_cell(p, q) for x, y in zip(a, b) for p, q in zip(x, y))


def main():
    folder = pathlib.Path(sys.argv[1])
    answers = folder / "answers.txt"
    statements = [line[2:].strip() for line in answers.read_text().splitlines() if line.startswith("> ")]
    with tempfile.TemporaryDirectory() as out:
        data = pathlib.Path(out)
        dataset(folder, data)
        connection = duckdb.connect()
        for table in data.iterdir():
            connection.execute(f"CREATE VIEW {table.name} AS FROM read_parquet('{table}/*.parquet')")
        if sys.argv[2] == "--write":
            with answers.open("w", newline="") as f:
                for s in statements:
                    f.write(f"> {s}\n")
                    csv.writer(f, lineterminator="\n").writerows(duck(connection, s))
            return 0
        wrong = 0
        for s in statements:
            right, found = duck(connection, s), ema(sys.argv[2], data, s)
            if not same(right, found):
                wrong += 1
                print(f"{s}\n  DuckDB {right[:4]}\n  ema    {found[:4]}")
        print(f"{len(statements)} statements, {wrong} answered otherwise")
        return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
