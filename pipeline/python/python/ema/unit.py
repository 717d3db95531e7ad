"""The file of one unit: what its own tests say of its constants.

>>> ema.unit.new("tail7.json", actuator)                            # doctest: +SKIP
>>> ema.unit.update("tail7.json", "acceptance.csv", healthy=True)   # doctest: +SKIP
>>> ema.diagnose("today.csv", unit="tail7.json")                    # doctest: +SKIP
"""

from __future__ import annotations

import os
from typing import Any, Iterable

from . import _ema
from ._common import Path, Progress, path_or_name, paths_of, teller
from ._ema import Actuator

__all__ = ["new", "show", "update"]


def new(
    unit: Path,
    actuator: Actuator | None = None,
    *,
    study: Path | None = None,
    spread: Path = "unit",
    name: str | None = None,
) -> dict[str, Any]:
    """Begins a unit: a model, and how well its constants are known.

    Args:
        unit: file to be written; it must not be there.
        actuator: its type; the reference if left out.
        study: folder of a study of this unit (`ema.discrepancy` with ``out``): the model is the one that it wrote.
        spread: how units of the type and their tests differ where no study says it: ``unit`` (all values assumed), or a TOML
            file.
        name: what the unit is called; the name of the file if left out.

    Returns:
        The keys of ``ema unit show --json``.
    """
    study = None if study is None else os.fspath(study)
    return _ema.unit_new(os.fspath(unit), actuator, study, path_or_name(spread), name)


def update(
    unit: Path,
    recordings: Path | Iterable[Path],
    *,
    healthy: bool = False,
    sequence: Path | None = None,
    sensors: Path = "auto",
    grid: Path = "fine",
    progress: Progress = None,
) -> dict[str, Any]:
    """Shows recordings of whole pre-flight tests to a unit, in order; what they say is kept in its file.

    Args:
        unit: its file.
        recordings: one path or several: the unit's history names them.
        healthy: the unit was healthy in them: faults are relative to what it was then.
        sequence, sensors, grid: as in `ema.diagnose`.
        progress: True, or a function of recordings done and recordings of all.

    Returns:
        The keys of ``ema unit show --json``; a recording that changed nothing has ``taken`` False and a reason in ``history``.
    """
    sequence = None if sequence is None else path_or_name(sequence)
    with teller(progress, "unit") as tell:
        return _ema.unit_update(
            os.fspath(unit), paths_of(recordings), healthy, sequence, path_or_name(sensors), path_or_name(grid), tell
        )


def show(unit: Path) -> dict[str, Any]:
    """What is known of a unit, and by which tests: the keys of ``ema unit show --json``."""
    return _ema.unit_show(os.fspath(unit))
