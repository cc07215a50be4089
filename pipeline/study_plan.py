"""What the theoretical study assumes: the paper's three versions, the machine, the driver and the soil.

The paper states speed, l5 and tyre pressure only. Everything else here has a source or is called an
assumption.
"""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.inputs import Controls, Driver, ForceSeries, coloured_noise, straight_path
from ..model.machine import Machine, MachineError
from ..model.settings import SimulationSettings

Floats = NDArray[np.float64]


class StudyError(ValueError):
    """A study that cannot be made: one line, what and how to mend."""


@dataclass(frozen=True)
class Assumption:
    """One number that the paper does not give: dotted name, value (SI), and where it comes from."""

    name: str
    value: float
    source: str


MAKER = "MTZ-1025 (77 to 81 kW, all-wheel drive), maker's data"
D497 = "ANSI/ASAE D497"
NONE_FOUND = "assumption"

ASSUMPTIONS: tuple[Assumption, ...] = (
    Assumption("tractor.mass", 4480.0, f"{MAKER}: operating mass"),
    Assumption(
        "tractor.yaw_inertia",
        8000.0,
        f"{NONE_FOUND}: box of the maker's 4.2 m x 1.97 m, m(a²+b²)/12 = 8034",
    ),
    Assumption("tractor.front_track", 1.60, f"{MAKER}: 1.445 to 1.99 m; {NONE_FOUND} within"),
    Assumption("tractor.rear_track", 1.60, f"{MAKER}: 1.43 to 2.10 m; {NONE_FOUND} within"),
    Assumption(
        "tractor.front_axle", 1.45, f"{NONE_FOUND}: 44 % of the weight on the front axle, wheelbase 2.57 m"
    ),
    Assumption("tractor.rear_axle", 1.12, f"{NONE_FOUND}: as the line above"),
    Assumption("tractor.hitch", 1.95, f"{NONE_FOUND}: drawbar 0.83 m behind the rear axle"),
    Assumption("seeder.mass", 2000.0, f"{NONE_FOUND}: eight rows of 0.70 m, trailed, half-full hoppers"),
    Assumption(
        "seeder.yaw_inertia", 5600.0, f"{NONE_FOUND}: uniform box of 5.6 m x 1.5 m, m(a²+b²)/12 = 5602"
    ),
    Assumption("seeder.com_to_axle", 0.30, f"{NONE_FOUND}: a downward hitch load of 9 to 13 % of the weight"),
    Assumption("seeder.track", 3.0, NONE_FOUND),
    Assumption(
        "seeder.draft", 7200.0, f"{D497}: row-crop planter, drawn, seeding only, 900 N a row, eight rows"
    ),
    Assumption("tyres.front.cornering_stiffness", 40e3, f"{NONE_FOUND}: about 4.5 times the wheel's load"),
    Assumption("tyres.rear.cornering_stiffness", 65e3, f"{NONE_FOUND}: about 4.5 times the wheel's load"),
    Assumption(
        "tyres.seeder.cornering_stiffness",
        30e3,
        f"{NONE_FOUND}; both wheels' 60 kN/rad is within Pearson's (2007) 26 to 194 for an implement",
    ),
    Assumption(
        "tyres.front.pressure_exponent",
        0.4,
        f"{NONE_FOUND}: nothing published at 0.10 and 0.12 MPa was found",
    ),
    Assumption("tyres.rear.pressure_exponent", 0.4, f"{NONE_FOUND}: as the front's"),
    Assumption("tyres.front.friction", 0.6, f"{NONE_FOUND}: lateral adhesion on tilled soil"),
    Assumption("tyres.rear.friction", 0.6, f"{NONE_FOUND}: as the front's"),
    Assumption("tyres.seeder.friction", 0.6, f"{NONE_FOUND}: as the tractor's"),
    Assumption("tyres.front.rolling_resistance", 0.073, f"{D497}: 1/Bn + 0.04 with Bn = 30 (tilled soil)"),
    Assumption("tyres.rear.rolling_resistance", 0.073, f"{D497}: as the front's"),
    Assumption("tyres.seeder.rolling_resistance", 0.073, f"{D497}: as the front's"),
    Assumption(
        "tyres.front.relaxation_length",
        0.6,
        f"{NONE_FOUND}: about a tyre's radius; Pearson (2007) found it needed",
    ),
    Assumption("tyres.rear.relaxation_length", 0.6, f"{NONE_FOUND}: as the front's"),
    Assumption("tyres.seeder.relaxation_length", 0.5, f"{NONE_FOUND}: about a tyre's radius"),
)


@dataclass(frozen=True)
class Version:
    """One set of the parameters that the paper varies: speed m/s, l5 m, tractor tyre pressure MPa.

    replaced: further dotted machine parameters in place of the assumed ones.
    """

    label: str
    speed: float
    hitch_to_com: float
    tyre_pressure_mpa: float
    replaced: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("speed", "hitch_to_com", "tyre_pressure_mpa"):
            value = getattr(self, name)
            if not (value > 0.0 and np.isfinite(value)):
                raise StudyError(
                    f"version {self.label}: {name} is {value!r}; it must be a finite number above 0"
                )


VERSIONS = {
    "a": Version("a", 2.5, 2.0, 0.10),
    "b": Version("b", 2.8, 3.0, 0.10),
    "c": Version("c", 2.8, 3.0, 0.12),
}


@dataclass(frozen=True)
class Soil:
    """Disturbance from the ground: first-order coloured noise over distance, independent on each body.

    force1, force2 : N, sd of the lateral force at O1 and O2; moment1, moment2 : N·m, of the moments;
    correlation : m; level : factor of all four. All are assumptions; `level` is the study's one calibrated
    number: it was set once so that version a's median range of O1 is the paper's 0.12 m (see docs/paper.md).
    """

    force1: float = 900.0
    moment1: float = 900.0
    force2: float = 500.0
    moment2: float = 800.0
    correlation: float = 0.5
    level: float = 1.2

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            if not (value >= 0.0 and np.isfinite(value)) or (item.name == "correlation" and value == 0.0):
                raise StudyError(f"soil.{item.name} is {value!r}; it must be a finite number above 0")


@dataclass(frozen=True)
class StudyPlan:
    """Everything of a study but the versions.

    driver : assumption: preview 8 m, delay 0.5 s, lag 0.2 s; length m of the run that is judged, run_in m
    before it;
    seeds : how many soils; seed : of the first; spacing s of the output
    """

    driver: Driver = field(default_factory=lambda: Driver(preview=8.0, delay=0.5, lag=0.2))
    soil: Soil = field(default_factory=Soil)
    length: float = 120.0
    run_in: float = 20.0
    seeds: int = 200
    seed: int = 20250514
    spacing: float = 0.02
    settings: SimulationSettings = field(default_factory=lambda: SimulationSettings(step=0.005))

    def __post_init__(self) -> None:
        for name in ("length", "spacing"):
            if not (getattr(self, name) > 0.0 and np.isfinite(getattr(self, name))):
                raise StudyError(f"{name} is {getattr(self, name)!r}; it must be a finite number above 0")
        if not (self.run_in >= 0.0 and np.isfinite(self.run_in)):
            raise StudyError(f"run_in is {self.run_in!r}; it must be a finite number, 0 or above")
        if self.seeds < 2:
            raise StudyError(f"seeds is {self.seeds}; intervals over soils need 2 or more")


def assumed_machine() -> Machine:
    """The machine of ASSUMPTIONS, with version a's l5 and pressure."""
    mapping: dict[str, Any] = {"tractor": {}, "seeder": {}, "tyres": {"front": {}, "rear": {}, "seeder": {}}}
    for assumption in ASSUMPTIONS:
        *path, key = assumption.name.split(".")
        owner = mapping
        for part in path:
            owner = owner[part]
        owner[key] = assumption.value
    mapping["seeder"]["hitch_to_com"] = VERSIONS["a"].hitch_to_com
    return Machine.from_mapping(mapping, VERSIONS["a"].tyre_pressure_mpa)


def machine_of(version: Version) -> Machine:
    """The assumed machine with a version's parameters."""
    values = {"seeder.hitch_to_com": version.hitch_to_com, "tyre_pressure_mpa": version.tyre_pressure_mpa}
    return assumed_machine().replace_parameters(values | dict(version.replaced))


def soil_series(soil: Soil, seeds: int, seed: int, length: float, spacing: float = 0.1) -> ForceSeries:
    """Disturbance of `seeds` soils over `length` m; soil k is made from seed + k alone, so it can be made
    again."""
    count = int(np.ceil(length / spacing)) + 2
    sizes = (0.0, soil.force1, soil.moment1, 0.0, soil.force2, soil.moment2)
    rows = np.zeros((seeds, count, len(sizes)))
    for row in range(seeds):
        generator = np.random.default_rng(seed + row)
        for column, size in enumerate(sizes):
            if size > 0.0:
                sd = soil.level * size
                rows[row, :, column] = coloured_noise(generator, count, spacing, sd, soil.correlation)
    return ForceSeries(spacing, rows)


def straight_controls(plan: StudyPlan, speed: float, seconds: float, ground: ForceSeries | None) -> Controls:
    """A driver who follows the x axis at constant speed over given ground."""
    return Controls(
        t=np.array([0.0, seconds]),
        speed=np.full(2, speed),
        driver=plan.driver,
        path=straight_path(),
        over_distance=ground,
    )


def read_version(path: Path) -> Version:
    """A version from a TOML file: a manifest (its [operating] and [machine]), or keys label, speed,
    hitch_to_com, tyre_pressure_mpa and a table [replaced] of dotted machine parameters; what is absent is
    version b's.

    Raises StudyError that names the file and the key.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StudyError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{path}: not valid TOML: {error}") from None
    if "machine" in values:
        values = _from_manifest(values, path)
    return _version(values, path)


def _version(values: Mapping[str, Any], path: Path) -> Version:
    known = [item.name for item in dataclasses.fields(Version)]
    for key in values:
        if key not in known:
            raise StudyError(f"{path}: {key}: unknown key; known are {', '.join(known)}")
    base = dataclasses.replace(VERSIONS["b"], label=path.stem)
    try:
        version = dataclasses.replace(base, **values)
        machine_of(version)
    except (StudyError, MachineError) as error:
        raise StudyError(f"{path}: {error}") from None
    except TypeError:
        raise StudyError(f"{path}: speed, hitch_to_com and tyre_pressure_mpa must be numbers") from None
    return version


def _from_manifest(values: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """A manifest's machine as a version: every number of its tables replaces the assumed one."""
    machine, operating = values["machine"], values.get("operating", {})
    if "seeder" not in machine:
        raise StudyError(
            f"{path}: machine.seeder: the study is of a tractor with a seeder; this machine has none"
        )
    replaced = {
        f"{part}.{key}": value
        for part in ("tractor", "seeder")
        for key, value in machine.get(part, {}).items()
        if key != "hitch_to_com"
    }
    for axle, tyre in machine.get("tyres", {}).items():
        replaced |= {f"tyres.{axle}.{key}": value for key, value in tyre.items()}
    return {
        "label": str(values.get("run", {}).get("variant") or path.stem),
        "speed": operating.get("speed", VERSIONS["b"].speed),
        "hitch_to_com": machine["seeder"].get("hitch_to_com", VERSIONS["b"].hitch_to_com),
        "tyre_pressure_mpa": operating.get("tyre_pressure_mpa", VERSIONS["b"].tyre_pressure_mpa),
        "replaced": replaced,
    }
