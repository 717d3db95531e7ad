"""Prognostics of electromechanical actuators with failure maps.

From one 3 s pre-flight test, two faults that act at the same time: transmission friction (FSJ, 1 = healthy) and static
rotor eccentricity (zeta, 0 = healthy), as intervals. The numbers are those of the program ``ema``, to the last bit.

>>> import ema
>>> test = ema.run(fsj=3.0, zeta=0.3, sensors="reference")
>>> found = ema.diagnose(test)
>>> found["outcome"], found["fsj"]["lo"] < 3.0 < found["fsj"]["hi"]
('located', True)

Long calls run without the interpreter's lock, on all cores (``RAYON_NUM_THREADS`` bounds them), stop at Ctrl-C, and take
``progress``: True for a line on standard error, or a function of runs done and runs of all.
"""

from __future__ import annotations

import math
import os
from typing import Any, Iterable, Mapping, Sequence

from . import _ema, unit
from ._common import Path, Progress, lines_of, path_or_name, paths_of, refused, teller
from ._ema import COMMIT, Actuator, InputError, Maps, Table, __version__

__all__ = [
    "COMMIT",
    "Actuator",
    "FaultEstimator",
    "InputError",
    "Maps",
    "Table",
    "__version__",
    "diagnose",
    "discrepancy",
    "maps",
    "prognosis",
    "run",
    "sweep",
    "unit",
]


def run(
    actuator: Actuator | None = None,
    fsj: float = 1.0,
    zeta: float = 0.0,
    *,
    sequence: Path = "preflight",
    rate_hz: float = 10_000.0,
    sensors: Path | None = None,
    rest_angle_deg: float = 0.0,
    load_n_m: float = 0.0,
    seed: int = 0,
    channels: Sequence[str] = (),
    model: str = "ntb",
    progress: Progress = None,
) -> Table:
    """Simulates one run of the numerical test bench, or of the simplified model.

    The same samples as ``ema run --out run.parquet``.

    Args:
        actuator: the reference actuator if left out.
        fsj: friction factor, 1 = healthy.
        zeta: static eccentricity, 0 = healthy, below 1.
        sequence: ``preflight``, ``ramp``, ``sine``, ``step``, ``chirp``, ``multisine``, or a TOML file.
        rate_hz: telemetry rate [Hz].
        sensors: None for true values, ``"reference"``, or a TOML file.
        rest_angle_deg: rotor angle at rest [deg].
        load_n_m: constant load torque, motor side [N m].
        seed: of the sensor noise.
        channels: beside the basic ones: ``v_a`` ``v_b`` ``v_c`` [V], ``torque_m`` [N m], ``i_q`` [A], ``i_supply`` [A],
            ``v_dc`` [V], or ``all``.
        model: ``ntb``, or ``sm``: the simplified model knows the healthy actuator only, without load and sensors.
        progress: True, or a function of runs done and runs of all.

    Returns:
        A row a sample: run, fsj, zeta, rest_angle_rad, t_ns [ns], com, theta_u, theta_m [rad], omega_m [rad/s], i_eq, i_a,
        i_b, i_c [A] and the further channels.

    Raises:
        InputError: a value that is not allowed.
    """
    with teller(progress, "run") as tell:
        return _ema.run(
            actuator,
            fsj,
            zeta,
            path_or_name(sequence),
            rate_hz,
            path_or_name(sensors, "none"),
            rest_angle_deg,
            load_n_m,
            seed,
            list(channels),
            model,
            tell,
        )


def _grid(fsj: Any, zeta: Any, grid: Path) -> tuple[list[float], list[float]]:
    if fsj is None or zeta is None:
        lines = _ema.grid(path_or_name(grid))
        fsj = lines[0] if fsj is None else fsj
        zeta = lines[1] if zeta is None else zeta
    return lines_of(fsj), lines_of(zeta)


def sweep(
    actuator: Actuator | None = None,
    fsj: Iterable[float] | float | None = None,
    zeta: Iterable[float] | float | None = None,
    *,
    grid: Path = "standard",
    sequence: Path = "preflight",
    rate_hz: float = 10_000.0,
    sensors: Path | None = None,
    rest_angle_deg: float = 0.0,
    load_n_m: float = 0.0,
    seed: int = 0,
    telemetry: bool | Sequence[str] = False,
    progress: Progress = None,
) -> Any:
    """Simulates every pair of a grid of faults, sixteen runs side by side on each core.

    The same features as ``ema simulate``; with sensors they are means over 16 seeds of the noise, and ``..._sd`` columns are
    the standard deviations.

    Args:
        actuator: the reference actuator if left out.
        fsj: friction factors, rising, 0 to 100; the grid's if left out.
        zeta: eccentricities, rising, 0 to below 1; the grid's if left out.
        grid: ``standard`` (17 x 11), ``fine`` (33 x 21), ``coarse`` (5 x 3), or a TOML file.
        sequence, rate_hz, sensors, rest_angle_deg, load_n_m: as in `run`; the rate is 1000 Hz or more.
        seed: of the sensor noise of all runs.
        telemetry: True, or names of further channels: the samples of all runs, too. A run of 3 s at 10 kHz takes 3.4 MB,
            half of it with sensors.
        progress: True, or a function of runs done and runs of all.

    Returns:
        A row a run, zeta outer, FSJ inner: run, fsj, zeta, rest_angle_rad, p1_rad_per_s, p3, speed_loss_rad_per_s (over the
        healthy run), then what was measured (p2_a, p3_rad, rise_s ...), then the standard deviations. With `telemetry` a
        pair: this table, and one of samples as `run` gives it.

    Raises:
        InputError: a value that is not allowed.
    """
    kept = None if telemetry is False else [] if telemetry is True else list(telemetry)
    lines = _grid(fsj, zeta, grid)
    with teller(progress, "sweep") as tell:
        features, samples = _ema.sweep(
            actuator,
            *lines,
            path_or_name(sequence),
            rate_hz,
            path_or_name(sensors, "none"),
            rest_angle_deg,
            load_n_m,
            seed,
            kept,
            tell,
        )
    return features if samples is None else (features, samples)


def maps(
    actuator: Actuator | None = None,
    fsj: Iterable[float] | float | None = None,
    zeta: Iterable[float] | float | None = None,
    *,
    grid: Path = "fine",
    sequence: Path = "preflight",
    rate_hz: float = 10_000.0,
    sensors: Path | None = "reference",
    rest_angle_deg: float = 0.0,
    spread: Path = "own",
    progress: Progress = None,
) -> Maps:
    """Makes failure maps and calibrates them; made once, they are kept in the program's cache (``EMA_CACHE_DIR``).

    Args:
        actuator: the reference actuator if left out.
        fsj, zeta, grid: fault pairs that are simulated, as in `sweep`; the healthy pair (1, 0) is one of them.
        sequence, rate_hz, sensors, rest_angle_deg: as in `run`.
        spread: from unit to unit that the calibration allows for: ``none``, ``fleet`` (all values assumed), a TOML file, or
            ``own``: as well as the actuator's file says that it was identified by a study, else none.
        progress: True, or a function of runs done and runs of all.

    Returns:
        Maps, for `diagnose`.
    """
    lines = _grid(fsj, zeta, grid)
    with teller(progress, "maps") as tell:
        return _ema.maps(
            actuator,
            *lines,
            path_or_name(sequence),
            rate_hz,
            path_or_name(sensors, "none"),
            rest_angle_deg,
            path_or_name(spread),
            tell,
        )


def diagnose(
    recording: Any,
    actuator: Actuator | None = None,
    maps: Maps | Path | None = None,
    unit: Path | None = None,
    *,
    coverage: float = 0.95,
    spread: Path = "own",
    known: Mapping[str, float] | None = None,
    run: int | None = None,
    sequence: Path | None = None,
    sensors: Path = "auto",
    grid: Path = "fine",
    method: str = "joint",
    refine: bool = False,
    progress: Progress = None,
) -> dict[str, Any]:
    """Diagnoses one recorded test: intervals of both faults, or why there are none.

    Args:
        recording: a path (the project's Parquet, a table in CSV or Parquet, a dataset), or a table: what `run` gives, a
            DataFrame of polars or pandas, a pyarrow table, a dict of arrays. A table without ``ema.*`` metadata says nothing
            of itself: sequence and sensors are then recognised, as of a CSV file. Needed are t [s] or t_ns [ns], com, theta_m
            [rad], omega_m [rad/s], i_eq [A].
        actuator: the one that the recording is taken for; the reference if left out.
        maps: `Maps` or their path; made on first use (some seconds) and kept if left out.
        unit: file of the unit that was tested (`ema.unit`): faults are then relative to the healthy unit.
        coverage: share of tests whose true pair the intervals hold, above 0 and below 1.
        spread: as in `maps`.
        known: what is known of the unit, such as ``{"supply_voltage_v": 47.5}``; it narrows a spread.
        run: number of the run, of a recording that holds several.
        sequence: by name or TOML file; recognised from the command if left out.
        sensors: ``auto``, ``none``, ``reference``, or a TOML file.
        grid: of maps that are made on first use.
        method: ``joint``, or ``paper``: the paper's own construction, which states no coverage.
        refine: also fit the faults by running the test bench itself: some seconds.
        progress: True, or a function of runs done and runs of all, while maps are made.

    Returns:
        The keys of ``ema diagnose --json``: outcome (``located``, ``unexplained``, ``out_of_range``, ``incomplete``), fsj and
        zeta (lo, hi, estimate), area, misfit, coverage, features, reason and others.

    Raises:
        InputError: a recording or a value that is not allowed.
    """
    if method not in ("joint", "paper"):
        raise refused("method", method, "joint, paper")
    if unit is not None and (actuator is not None or maps is not None or spread != "own" or refine):
        raise refused("unit", "with actuator, maps, spread or refine", "unit alone: it knows them")
    with teller(progress, "diagnose") as tell:
        return _ema.diagnose(
            recording,
            actuator,
            maps,
            None if unit is None else os.fspath(unit),
            coverage,
            path_or_name(spread),
            [f"{key}={value!r}" for key, value in (known or {}).items()],
            run,
            None if sequence is None else path_or_name(sequence),
            path_or_name(sensors),
            path_or_name(grid),
            method,
            refine,
            tell,
        )


def discrepancy(
    *bench: Path,
    model: Actuator | Path | None = None,
    healthy: bool = False,
    verify: bool = False,
    out: Path | None = None,
    diagnose: Path | Sequence[Path] = (),
    progress: Progress = None,
) -> dict[str, Any]:
    """Finds what a model misses against measured data, and names it.

    Args:
        bench: a bench file, or one or more recordings of telemetry.
        model: an actuator, its file, or ``reference``; a bench file does without for a rig that is no actuator of ours.
        healthy: the machine was healthy in all that was recorded: what is proven may be written into its model.
        verify: run the simulators under the recorded command of a bench file, too.
        out: folder for report.html, report.json and actuator.toml; nothing is written if left out.
        diagnose: pre-flight tests that are then diagnosed with the model that was written; needs `out`.
        progress: True, or a function of runs done and runs of all, while something is simulated.

    Returns:
        The keys of ``ema discrepancy --json``: verdict, sentence, effects, retuned and others.

    Raises:
        InputError: measurements that no study can be made of.
    """
    if not bench:
        raise refused("bench", "nothing", "at least one path")
    tests = paths_of(diagnose)
    if tests and out is None:
        raise refused("diagnose", "without out", "with out: a folder for the model")
    with teller(progress, "discrepancy") as tell:
        return _ema.discrepancy(
            [os.fspath(b) for b in bench],
            model if model is None or isinstance(model, Actuator) else path_or_name(model),
            healthy,
            verify,
            None if out is None else os.fspath(out),
            tests,
            tell,
        )


def prognosis(
    history: Any,
    thresholds: Mapping[str, float | str] | None = None,
    *,
    fleet: Path | None = None,
    risk: float = 0.01,
    horizon: float | None = None,
    clock: str | None = None,
    events: Path | None = None,
    column: str | None = None,
    healthy: float | None = None,
    actuator: Actuator | None = None,
    out: Path | None = None,
    samples: bool = False,
    progress: Progress = None,
) -> list[dict[str, Any]]:
    """From diagnoses over time to trend, rate, law of growth, remaining life and when to look again.

    Args:
        history: a path (a log of ``ema live``, a dataset that wears and was diagnosed, a table in CSV or Parquet), or a table
            with the columns actuator, time (ISO, or a number) or cycle, outcome, fsj_lo, fsj_hi, fsj_estimate, zeta_lo ...,
            coverage.
        thresholds: levels that end the life, such as ``{"fsj": 4, "zeta": 0.4}``, or ``{"stall": "0.4Nm"}``: a load torque at
            the motor that is no longer moved in time. Left out: fsj 4 and zeta 0.4 where the history has them (assumed).
        fleet: what a fleet has taught, a file of ``ema prognosis learn``.
        risk: probability of having passed the threshold that is taken.
        horizon: one more time ahead at which the probability of failure is told [units of the clock].
        clock: ``flight``, ``cycle``, ``hour`` or ``day``; the one in which laws fit better if left out.
        events: repairs and other interventions, a CSV file.
        column: another health indicator in place of FSJ and zeta.
        healthy: its level in a healthy unit.
        actuator: for ``stall``; the reference if left out.
        out: folder for tables, figures and report.html.
        samples: also give ``samples``, the time left as ascending samples of equal weight [units of the clock]; infinite where
            the threshold is not passed within the horizon.
        progress: True, or a function of runs done and runs of all, while something is simulated.

    Returns:
        For each actuator and threshold the keys of ``ema prognosis --json``: level, rate, law, rul (median, lo, hi), p_fail,
        next_test, status, reason and others. Times are in units of ``clock``.

    Raises:
        InputError: a history or a threshold that is not allowed.
    """
    named = [f"{fault}={level}" for fault, level in (thresholds or {}).items()]
    with teller(progress, "prognosis") as tell:
        told = _ema.prognosis(
            history,
            named,
            actuator,
            None if fleet is None else os.fspath(fleet),
            risk,
            horizon,
            clock,
            None if events is None else os.fspath(events),
            column,
            healthy,
            None if out is None else os.fspath(out),
            samples,
            tell,
        )
    for one in told:
        if samples:
            one["samples"] = [math.inf if x is None else x for x in one["samples"]]
    return told


def __getattr__(name: str) -> Any:
    # the estimator alone needs numpy
    if name == "FaultEstimator":
        from .estimator import FaultEstimator

        return FaultEstimator
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
