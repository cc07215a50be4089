"""What a synthetic pass shall be: the plan of a twin, its named presets and its TOML form.

A plan is a tree of small frozen dataclasses; a TOML file names the same keys, starts from a preset when it
says `preset = "..."`, and changes only what it names. All values are SI unless a key carries its unit.
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from .twin_machine import MACHINE, SENSORS
from .twin_tables import PlanError, near, read_toml, with_table

Spans = tuple[tuple[float, float], ...]
Jumps = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class RunPlan:
    """The `[run]` table: id names the pass and its folder; start is the UTC second of the day of t = 0."""

    id: str = "twin"
    field: str = "twin-field"
    direction: str = "east"
    repeat: int = 1
    variant: str = "b"
    date: str = "2025-05-14"
    start: float = 36000.0
    tyre_pressure_mpa: float = 0.12


@dataclass(frozen=True)
class PlacePlan:
    """Origin of the local plane (the start of the first row) and the heading of travel, ccw from East."""

    lat: float = 50.041266
    lon: float = 36.485128
    alt: float = 148.5
    heading_deg: float = 5.0


@dataclass(frozen=True)
class PathPlan:
    """Rows, headland turns of 180° between them, and the speed along them.

    duration: s of the whole recording; None: as long as the rows take, with a stop at the end.
    line: whether run.toml states the intended AB line.
    """

    rows: int = 1
    row_length: float = 120.0
    turn_radius: float = 9.0
    rest: float = 5.0
    rest_end: float = 3.0
    speed: float = 2.8
    turn_speed: float = 1.6
    acceleration: float = 0.6
    duration: float | None = None
    line: bool = True
    start_offset: float = 0.0


@dataclass(frozen=True)
class DriverPlan:
    """A path-following driver, and the weave that excites the machine.

    Preview steering delta = L·2·sin(bearing of the point `preview` s ahead)/distance, seen `delay` s late,
    through a steering actuator of time constant `lag`; `noise_deg` (1 sigma) with correlation time
    `noise_time` is his hand; weave is a sine of steering angle over time, whose period goes from
    weave_period to weave_period_end over the pass where that is given (a sweep).
    """

    preview: float = 2.2
    delay: float = 0.35
    lag: float = 0.15
    noise_deg: float = 0.6
    noise_time: float = 0.8
    weave_deg: float = 0.0
    weave_period: float = 5.0
    weave_period_end: float | None = None
    limit_deg: float = 38.0
    speed_sd: float = 0.03
    speed_time: float = 4.0


@dataclass(frozen=True)
class SoilPlan:
    """Ground under the machine.

    side_force_*, yaw_moment_*: 1 sigma of the disturbance at each body (N, N·m), Gauss-Markov over distance
    with `correlation_length` m. roughness: displacement spectral density at 0.1 cycles/m, m³ (ISO 8608:
    class C 256e-6, D 1024e-6, E 4096e-6). slope_*: grade of the terrain; weight_pulls: whether the weight's part
    along it pulls both bodies aside (it tilts them in any case). slip: mean longitudinal slip of
    the tractor's wheels, slip_sd its scatter. crab_*_deg: about the constant angle between a body's axis
    and its course.
    """

    side_force_tractor: float = 600.0
    side_force_seeder: float = 600.0
    yaw_moment_tractor: float = 300.0
    yaw_moment_seeder: float = 400.0
    correlation_length: float = 1.5
    roughness: float = 1500e-6
    slope_east: float = 0.004
    slope_north: float = -0.006
    slip: float = 0.06
    slip_sd: float = 0.008
    slip_time: float = 1.5
    crab_tractor_deg: float = 0.0
    crab_seeder_deg: float = 0.0
    weight_pulls: bool = False


@dataclass(frozen=True)
class GnssPlan:
    """Errors of the GNSS receivers. Spans are (start, length) in s after t = 0, spikes (start, length,
    size m).

    kind: quality where no span says otherwise. latency: least delay from validity to arrival; None draws
    it from 20 to 150 ms. latency_jitter: mean of the exponential rest. white_scale: of the white part of
    the error. heading_noise_deg: of HDT, which the receivers in `heading` have. gst, rmc, host_time:
    whether the log has GST, has RMC and VTG, and has the logger's time before each sentence.
    """

    kind: Literal["rtk_fixed", "rtk_float", "dgps", "single"] = "rtk_fixed"
    outages: Spans = ()
    floats: Spans = ()
    singles: Spans = ()
    spikes: Jumps = ()
    latency: float | None = None
    latency_jitter: float = 0.01
    white_scale: float = 1.0
    heading: tuple[str, ...] = ()
    heading_noise_deg: float = 0.15
    heading_bias_deg: float = 0.1
    gst: bool = True
    rmc: bool = True
    host_time: bool = True


@dataclass(frozen=True)
class ErrorPlan:
    """How good the sensors are: 1 sigma of what is constant in a pass, and the level of the rest.

    misalignment_deg: of a unit against its stated mounting, about each axis. bias_scale, noise_scale:
    multiply the data-sheet figures of `twin_inertial`; accel_bias: accelerometers' offset instead of that figure's
    multiple, m/s². wheel_radius: relative doubt of each wheel's
    radius. lever_arm: doubt of each coordinate of a unit's stated place, m. roll_centre_*: height above
    ground of the axis a body rolls about; None: through its CoM. steer_*: the steering sensor's zero and
    noise. soft_iron: share of the field that iron near a magnetometer bends aside; current_field: T, of motors
    and lights that switch.
    """

    misalignment_deg: float = 0.2
    bias_scale: float = 1.0
    accel_bias: float | None = None
    noise_scale: float = 1.0
    vibration: float = 1.0
    wheel_radius: float = 0.012
    lever_arm: float = 0.0
    roll_centre_tractor: float | None = None
    roll_centre_seeder: float | None = None
    steer_zero_deg: float = 0.25
    steer_scale: float = 0.007
    steer_noise_deg: float = 0.08
    magnetometers: bool = True
    soft_iron: float = 0.0
    current_field: float = 0.0


@dataclass(frozen=True)
class ClockPlan:
    """Clocks: the logger's offset from UTC (s; None draws within ±5 s) and its drift, the units' drift
    (1 sigma), and whether counters start just below their wrap, so that they wrap within the pass."""

    host_offset: float | None = None
    host_drift_ppm: float = 0.0
    drift_ppm: float = 60.0
    latency: float = 0.001
    latency_jitter: float = 0.003
    wrap: bool = False
    no_device_time: bool = False
    no_seq: bool = False


@dataclass(frozen=True)
class FaultPlan:
    """What goes wrong in the files: shares of rows, and spans (sensor, start, length) without any.

    restarts: (sensor, time) at which a unit starts anew: silent for 1.5 s, then its counters begin at
    zero."""

    lost: float = 0.001
    doubled: float = 0.0003
    disordered: float = 0.0
    empty: float = 0.0
    bad_checksums: float = 0.0
    cut_last_row: bool = False
    gaps: tuple[tuple[str, float, float], ...] = ()
    restarts: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class TwinPlan:
    """A synthetic pass: what is driven, by which machine, over which ground, seen by which sensors.

    machine, sensors, conditions: the tables of run.toml, as the researcher believes them. truth: factors on
    dotted keys of [machine] by which the true machine differs ("tyres.front.cornering_stiffness" = 0.35);
    truth_set: values that it has instead ("tyres.front.relaxation_length" = 0.6, where the stated one is 0).
    dynamics: "model" integrates the two-mass equations; "kinematic" rolls with side slip, independent of
    `model`.
    """

    run: RunPlan = RunPlan()
    place: PlacePlan = PlacePlan()
    path: PathPlan = PathPlan()
    driver: DriverPlan = DriverPlan()
    soil: SoilPlan = SoilPlan()
    gnss: GnssPlan = GnssPlan()
    errors: ErrorPlan = ErrorPlan()
    clocks: ClockPlan = ClockPlan()
    faults: FaultPlan = FaultPlan()
    machine: Mapping[str, Any] = field(default_factory=lambda: MACHINE)
    sensors: Mapping[str, Any] = field(default_factory=lambda: SENSORS)
    truth: Mapping[str, float] = field(default_factory=dict)
    truth_set: Mapping[str, float] = field(default_factory=dict)
    conditions: Mapping[str, Any] = field(default_factory=dict)
    dynamics: Literal["model", "kinematic"] = "model"


BAD_SENSORS = ErrorPlan(misalignment_deg=0.7, bias_scale=3.0, wheel_radius=0.02)
METRE_LEVEL = GnssPlan(kind="single")
WRONG_MACHINE = {
    "tyres.front.cornering_stiffness": 0.35,
    "tyres.rear.cornering_stiffness": 0.35,
    "tyres.seeder.cornering_stiffness": 0.35,
    "seeder.hitch_to_com": 1.4,
}

LONG_ROW = PathPlan(duration=60.0, row_length=200.0)
OUTAGE = GnssPlan(outages=((25.0, 8.0),), floats=((33.0, 10.0),))
EVERYTHING = FaultPlan(
    lost=0.03, doubled=0.01, disordered=0.01, empty=0.001, bad_checksums=0.02, cut_last_row=True,
    gaps=(("imd2", 30.0, 2.0),), restarts=(("wds3", 40.0),),
)  # fmt: skip


def _presets() -> Mapping[str, TwinPlan]:
    """The named plans; each is its own run.id."""
    plain = TwinPlan(path=LONG_ROW)
    alone = with_table(
        plain,
        {
            "machine": {"seeder": False, "tyres": {"seeder": False}},
            "sensors": {"imd2": False, "imd3": False},
        },
    )
    plans = {
        "benign": plain,
        "bad_sensors": replace(plain, errors=BAD_SENSORS, faults=FaultPlan(lost=0.02)),
        "outage": replace(plain, gnss=OUTAGE),
        "headland": TwinPlan(path=PathPlan(rows=2, row_length=90.0)),
        "metre_gps": replace(plain, gnss=METRE_LEVEL),
        "wrong_machine": replace(plain, truth=WRONG_MACHINE),
        "faulty": replace(plain, faults=EVERYTHING, clocks=ClockPlan(wrap=True, host_drift_ppm=15.0)),
        "tractor_alone": alone,
    }
    named = {name: replace(plan, run=RunPlan(id=name, field=name)) for name, plan in plans.items()}
    return types.MappingProxyType(named)


PRESETS = _presets()


def preset(name: str) -> TwinPlan:
    """The named plan. Raises PlanError with the nearest name."""
    if name not in PRESETS:
        raise PlanError(f"no preset {name!r}{near(name, PRESETS)}; there are {', '.join(sorted(PRESETS))}")
    return PRESETS[name]


def read_plan(path: Path) -> TwinPlan:
    """The plan of a TOML file. Raises PlanError: what, where, how to mend."""
    return plan_from(read_toml(path), str(path))


def plan_from(table: Mapping[str, Any], where: str = "plan") -> TwinPlan:
    """A plan from its TOML form: `preset` (default "benign") changed by the tables that are named."""
    rest = dict(table)
    try:
        start = preset(str(rest.pop("preset", "benign")))
        return changed(start, rest)
    except PlanError as error:
        raise PlanError(f"{where}: {error}") from None


def with_value(plan: TwinPlan, key: str, value: Any) -> TwinPlan:
    """The plan with one dotted key changed: with_value(plan, "soil.roughness", 1e-3)."""
    nested: Any = value
    for part in reversed(key.split(".")):
        nested = {part: nested}
    return changed(plan, nested)


def changed(plan: TwinPlan, table: Mapping[str, Any]) -> TwinPlan:
    """The plan with what a nested table names. Raises PlanError for an unknown key or a wrong type."""
    new: TwinPlan = with_table(plan, table)
    return new
