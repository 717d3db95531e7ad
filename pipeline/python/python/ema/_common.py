"""What the functions of the package share."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from typing import Any, Callable, Iterable, Iterator, Union

from ._ema import InputError

Path = Union[str, "os.PathLike[str]"]
Progress = Union[bool, Callable[[int, int], Any], None]


def refused(place: str, found: object, allowed: str) -> InputError:
    """A refusal of an argument."""
    error = InputError(f"arguments: {place}: found {found}; allowed: {allowed}")
    error.file, error.place, error.found, error.allowed = "arguments", place, str(found), allowed
    return error


def path_or_name(given: Path | None, default: str | None = None) -> str:
    """The text of a name or path; a default for None."""
    if given is None and default is not None:
        return default
    try:
        return os.fspath(given)  # type: ignore[arg-type]
    except TypeError:
        raise refused("path", type(given).__name__, "a name, or a path") from None


def paths_of(given: Path | Iterable[Path]) -> list[str]:
    """Paths of one or several."""
    if isinstance(given, (str, os.PathLike)):
        return [os.fspath(given)]
    return [os.fspath(one) for one in given]


def lines_of(given: Iterable[float] | float) -> list[float]:
    """Lines of a grid of one number or several."""
    if hasattr(given, "__iter__"):
        return [float(x) for x in given]  # type: ignore[union-attr]
    return [float(given)]  # type: ignore[arg-type]


@contextmanager
def teller(progress: Progress, title: str) -> Iterator[Callable[[int, int], Any] | None]:
    """What is told how far work is: the callback that was given, a line on standard error, or nothing."""
    if progress is None or progress is False:
        yield None
    elif progress is not True:
        yield progress
    else:
        wide = 0

        def line(done: int, total: int) -> None:
            nonlocal wide
            text = f"ema {title}: {done} of {total} runs"
            sys.stderr.write("\r" + text.ljust(wide))
            sys.stderr.flush()
            wide = len(text)

        try:
            yield line
        finally:
            if wide:
                sys.stderr.write("\n")
