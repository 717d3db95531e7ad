# The compiled half of the package. Its functions take what `ema` has put into plain form; use those of `ema`.

from os import PathLike
from typing import Any, Callable

__version__: str
COMMIT: str

_Path = str | PathLike[str]
_Tell = Callable[[int, int], Any] | None

class InputError(ValueError):
    """Something from outside is not allowed."""

    file: str
    """File, object, or ``arguments``."""
    place: str
    """Key, column, line or argument in it."""
    found: str
    """What is there."""
    allowed: str
    """What may be there, in words."""

class Actuator:
    """Parameters of one actuator; SI units, motor side unless a name says otherwise. It does not change."""

    # Each parameter is an attribute.
    supply_voltage_v: float
    """Supply voltage [V]."""
    phase_resistance_ohm: float
    """Resistance of one phase of the star [ohm]."""
    phase_inductance_h: float
    """Inductance of one phase of the star [H]."""
    back_emf_v_s_per_rad: float
    """Back-EMF coefficient of one phase [V s/rad]."""
    pole_pairs: float
    """Pole pairs [-]."""
    inertia_kg_m2: float
    """Inertia [kg m2]."""
    viscous_n_m_s_per_rad: float
    """Viscous friction [N m s/rad]."""
    torque_limit_n_m: float
    """Greatest motor torque [N m]."""
    static_friction_n_m: float
    """Nominal static dry friction [N m]; the fault FSJ multiplies it."""
    dynamic_friction_ratio: float
    """Dynamic over static dry friction [-]."""
    gear_ratio: float
    """Motor to user [-]."""
    backlash_half_width_rad: float
    """At the user shaft [rad]."""
    end_stop_rad: float
    """End stops at plus and minus this, at the user shaft [rad]."""
    opposing_efficiency: float
    """Of the transmission where the load opposes the motion [-]."""
    aiding_efficiency: float
    """Where the load aids it [-]."""
    position_gain_per_s: float
    """Gain of the position loop [(rad/s motor)/(rad user)]."""
    speed_reference_limit_rad_per_s: float
    """Greatest speed reference [rad/s]."""
    speed_proportional_n_m_s_per_rad: float
    """Proportional gain of the speed loop [N m s/rad]."""
    speed_integral_n_m_per_rad: float
    """Integral gain of the speed loop [N m/rad]."""
    integrator_limit_n_m: float
    """Limit of the speed loop's integrator [N m]."""
    current_limit_a: float
    """Greatest current reference [A]."""
    drive_constant_n_m_per_a: float
    """Torque of an ampere that the drive reckons with [N m/A]; 0: that of the motor."""
    hysteresis_half_band_a: float
    """Half-band of the current control [A]."""
    step_s: float
    """Step of the test bench [s]."""
    temperature_degc: float
    """Of friction and surroundings [degC]."""

    def __init__(self) -> None: ...
    @staticmethod
    def from_toml(path_or_text: _Path) -> Actuator: ...
    def to_toml(self) -> str: ...
    def with_(self, *, name: str = ..., **changes: float) -> Actuator: ...
    @property
    def name(self) -> str: ...
    @property
    def fingerprint(self) -> str: ...
    @property
    def parameters(self) -> dict[str, float]: ...
    @property
    def units(self) -> dict[str, str]: ...
    @property
    def effects(self) -> list[str]: ...
    def __hash__(self) -> int: ...

class Column:
    """The values of a column, as a buffer."""

    def __len__(self) -> int: ...
    def __buffer__(self, flags: int, /) -> memoryview: ...

class Table:
    """Columns of equal length, with metadata. polars and pyarrow read it as it is."""

    def __init__(self, data: Any) -> None: ...
    @property
    def columns(self) -> list[str]: ...
    @property
    def metadata(self) -> dict[str, str]: ...
    @property
    def units(self) -> dict[str, str]: ...
    def __len__(self) -> int: ...
    def column(self, name: str) -> Any: ...
    def __getitem__(self, name: str) -> Any: ...
    def keys(self) -> list[str]: ...
    def to_dict(self) -> dict[str, Any]: ...
    def save(self, path: _Path) -> None: ...
    def __arrow_c_stream__(self, requested_schema: object | None = None) -> Any: ...
    def __arrow_c_schema__(self) -> Any: ...

class Maps:
    """Failure maps of one actuator, sequence, rate, sensor model and rest angle, in a file."""

    @staticmethod
    def load(path: _Path) -> Maps: ...
    def save(self, path: _Path) -> None: ...
    def table(self) -> Table: ...
    @property
    def path(self) -> str: ...
    @property
    def features(self) -> list[str]: ...
    @property
    def left_out(self) -> list[str]: ...
    @property
    def header(self) -> dict[str, Any]: ...

class FittedMaps:
    """Maps of rows of features."""

    def __init__(
        self,
        fsj: list[float],
        zeta: list[float],
        names: list[str],
        rows: list[list[float]],
        deviations: list[list[float]] | None,
        sequence: str,
        rate_hz: float,
    ) -> None: ...
    @property
    def features(self) -> list[str]: ...
    def calibrate(self, rows: list[list[float]], fsj: list[float], zeta: list[float]) -> None: ...
    def diagnose(
        self, rows: list[list[float]], coverage: float
    ) -> list[tuple[str, tuple[float, float, float, float, float, float] | None, str]]: ...

def grid(name: str) -> tuple[list[float], list[float]]: ...
def run(
    actuator: Actuator | None,
    fsj: float,
    zeta: float,
    sequence: str,
    rate_hz: float,
    sensors: str,
    rest_angle_deg: float,
    load_n_m: float,
    seed: int,
    channels: list[str],
    model: str,
    progress: _Tell = None,
) -> Table: ...
def sweep(
    actuator: Actuator | None,
    fsj: list[float],
    zeta: list[float],
    sequence: str,
    rate_hz: float,
    sensors: str,
    rest_angle_deg: float,
    load_n_m: float,
    seed: int,
    telemetry: list[str] | None,
    progress: _Tell = None,
) -> tuple[Table, Table | None]: ...
def maps(
    actuator: Actuator | None,
    fsj: list[float],
    zeta: list[float],
    sequence: str,
    rate_hz: float,
    sensors: str,
    rest_angle_deg: float,
    spread: str,
    progress: _Tell = None,
) -> Maps: ...
def diagnose(
    recording: Any,
    actuator: Actuator | None,
    maps: Maps | _Path | None,
    unit: str | None,
    coverage: float,
    spread: str,
    known: list[str],
    run: int | None,
    sequence: str | None,
    sensors: str,
    grid: str,
    method: str,
    refine: bool,
    progress: _Tell = None,
) -> dict[str, Any]: ...
def discrepancy(
    bench: list[str],
    model: Actuator | str | None,
    healthy: bool,
    verify: bool,
    out: str | None,
    diagnose: list[str],
    progress: _Tell = None,
) -> dict[str, Any]: ...
def unit_new(unit: str, actuator: Actuator | None, study: str | None, spread: str, name: str | None) -> dict[str, Any]: ...
def unit_update(
    unit: str,
    recordings: list[str],
    healthy: bool,
    sequence: str | None,
    sensors: str,
    grid: str,
    progress: _Tell = None,
) -> dict[str, Any]: ...
def unit_show(unit: str) -> dict[str, Any]: ...
def prognosis(
    history: Any,
    thresholds: list[str],
    actuator: Actuator | None,
    fleet: str | None,
    risk: float,
    horizon: float | None,
    clock: str | None,
    events: str | None,
    column: str | None,
    healthy: float | None,
    out: str | None,
    samples: bool,
    progress: _Tell = None,
) -> list[dict[str, Any]]: ...
