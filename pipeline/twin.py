"""A synthetic raw pass with known truth: the twin of a field experiment.

`make_pass(plan, seed)` drives a machine along its path, lets its sensors see that, and breaks what the
plan wants broken; `write_raw` leaves the files that a logger would. Every part draws from its own random
stream, named and seeded by the pass's seed, so that a fault more or a sensor less leaves all else as it was.
"""

from __future__ import annotations

import copy
import datetime as dt
import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sensors import manifest as manifests
from ..sensors.geodesy import to_geodetic
from . import twin_clocks as clocks
from . import twin_gnss as gnss
from . import twin_inertial as inertial
from . import twin_writing as writing
from .twin_dynamics import dynamic
from .twin_ground import attitudes
from .twin_motion import STEP, PlanarMotion, kinematic, planned
from .twin_path import smooth_wander
from .twin_plan import TwinPlan
from .twin_rigid import YAW, BodyPath, Feel, WheelPath, body_path, wheel_path
from .twin_tables import PlanError, as_table

Floats = NDArray[np.float64]

TRUTH_RATE = 50.0  # Hz, of truth.csv
X, Y = 0, 1


@dataclass(frozen=True)
class World:
    """What is true: the planar motion, both bodies' paths in six coordinates, the wheels, speed along
    the tractor's axis (on the motion's grid), and the logger's clock."""

    motion: PlanarMotion
    bodies: Mapping[str, BodyPath]
    wheels: Mapping[str, WheelPath]
    speed: Floats
    host: clocks.HostClock
    duration: float


@dataclass(frozen=True)
class Twin:
    """A synthetic pass. truth : (N, 9) rows of truth.csv (t, x1, y1, yaw1, v1, x2, y2, yaw2, steer);
    units, steering : records by sensor; nmea : lines by sensor; facts : constants behind it (JSON-able),
    written as twin.json."""

    plan: TwinPlan
    seed: int
    manifest_text: str
    truth: Floats
    world: World
    units: Mapping[str, clocks.ImuRecord]
    steering: Mapping[str, clocks.SteerRecord]
    nmea: Mapping[str, list[str]]
    facts: Mapping[str, Any] = field(default_factory=dict)


def make_pass(plan: TwinPlan, seed: int) -> Twin:
    """A synthetic raw pass, the same for the same plan and seed.

    Raises PlanError for a plan whose manifest would be refused, in one line.
    """
    text = manifest_text(plan)
    try:
        manifests.parse(text, "the plan's run.toml")
    except manifests.ManifestError as error:
        raise PlanError(str(error)) from None
    world = make_world(plan, seed)
    of_kind = {kind: _of_kind(plan, kind) for kind in ("imd", "wds", "gps", "steer")}
    errors = {
        name: inertial.draw_errors(plan.errors, sensor["rate"], stream(seed, f"{name} errors"))
        for name, sensor in {**of_kind["imd"], **of_kind["wds"]}.items()
    }
    units = {name: _unit(plan, world, name, plan.sensors[name], e, seed) for name, e in errors.items()}
    return Twin(
        plan, seed, text, truth_rows(plan, world), world, units,
        steering={name: _steering(plan, world, name, s, seed) for name, s in of_kind["steer"].items()},
        nmea={name: _nmea(plan, world, name, s, seed) for name, s in of_kind["gps"].items()},
        facts=_facts(plan, seed, world, errors),
    )  # fmt: skip


def write_raw(twin: Twin, folder: Path, truth: Path | None = None) -> None:
    """Write the pass into `folder`; truth.csv, truth_origin.json and twin.json into `truth` (None:
    beside the folder)."""
    plan = twin.plan
    files = {"run.toml": twin.manifest_text}
    columns = _columns(plan)
    for name, unit in twin.units.items():
        files[plan.sensors[name]["file"]] = writing.imu_text(
            unit, columns, plan.sensors[name], plan.faults.cut_last_row
        )
    for name, record in twin.steering.items():
        files[plan.sensors[name]["file"]] = writing.steer_text(record)
    for name, lines in twin.nmea.items():
        files[plan.sensors[name]["file"]] = "\n".join(lines) + "\n"
    writing.write_files(Path(folder), files)
    place = plan.place
    writing.write_files(
        Path(folder).parent if truth is None else Path(truth),
        {
            "truth.csv": writing.truth_text(twin.truth),
            "truth_origin.json": writing.origin_text(place.lat, place.lon, place.alt),
            "twin.json": json.dumps(twin.facts, indent=1) + "\n",
        },
    )


def stream(seed: int, name: str) -> np.random.Generator:
    """The random stream of one part of the twin."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def true_machine(plan: TwinPlan) -> dict[str, Any]:
    """The [machine] table with the plan's factors and values. Raises PlanError for a key that it lacks."""
    machine = copy.deepcopy({k: dict(v) for k, v in plan.machine.items()})
    for key, factor in plan.truth.items():
        owner, last = _owner(machine, key)
        owner[last] = owner[last] * factor
    for key, value in plan.truth_set.items():
        owner, last = _owner(machine, key)
        owner[last] = value
    return machine


def _owner(machine: dict[str, Any], key: str) -> tuple[dict[str, Any], str]:
    """The table that holds a dotted key, and the key's last part."""
    *path, last = key.split(".")
    owner: Any = machine
    for part in path:
        owner = owner.get(part) if isinstance(owner, dict) else None
    if not isinstance(owner, dict) or not isinstance(owner.get(last), int | float):
        raise PlanError(f"truth.{key}: no number of [machine] has this name")
    return owner, last


def make_world(plan: TwinPlan, seed: int) -> World:
    """Everything true of the pass."""
    machine = true_machine(plan)
    drive = stream(seed, "drive")
    move = dynamic if plan.dynamics == "model" else kinematic
    motion = move(plan, machine, *planned(plan, drive), drive)
    first, second = attitudes(plan, machine, motion, stream(seed, "ground"))
    errors = plan.errors
    bodies = {
        "tractor": body_path(motion, first, 1, machine["tractor"]["cog_height"], errors.roll_centre_tractor)
    }
    if second is not None:
        bodies["seeder"] = body_path(
            motion, second, 2, machine["seeder"]["cog_height"], errors.roll_centre_seeder
        )
    wheels = {
        sensor["wheel"]: _wheel(plan, machine, motion, sensor["wheel"], seed)
        for sensor in _of_kind(plan, "wds").values()
    }
    start = dt.datetime.fromisoformat(plan.run.date).replace(tzinfo=dt.UTC) + dt.timedelta(
        seconds=plan.run.start
    )
    host = clocks.host_clock(plan.clocks, round(start.timestamp() * 1e3) * 10**6, stream(seed, "host clock"))
    speed = np.hypot(np.gradient(motion.x1, STEP), np.gradient(motion.y1, STEP))
    return World(motion, bodies, wheels, speed, host, float(motion.t[-1]))


def _wheel(
    plan: TwinPlan, machine: Mapping[str, Any], motion: PlanarMotion, wheel: str, seed: int
) -> WheelPath:
    """One wheel, its radius a little off the nominal, its slip wandering."""
    rng = stream(seed, f"wheel {wheel}")
    nominal = machine["tractor"][f"{wheel.split('_')[0]}_wheel_radius"]
    radius = nominal * (1.0 + plan.errors.wheel_radius * float(np.clip(rng.standard_normal(), -2.5, 2.5)))
    phase = float(rng.uniform(-math.pi, math.pi))
    slip = plan.soil.slip + plan.soil.slip_sd * smooth_wander(motion.t.size, STEP, plan.soil.slip_time, rng)
    return wheel_path(motion, machine["tractor"], wheel, radius, slip, phase)


def _of_kind(plan: TwinPlan, kind: str) -> dict[str, Mapping[str, Any]]:
    return {name: sensor for name, sensor in plan.sensors.items() if sensor.get("kind") == kind}


def _unit(
    plan: TwinPlan, world: World, name: str, sensor: Mapping[str, Any], errors: inertial.UnitErrors, seed: int
) -> clocks.ImuRecord:
    """Rows of one IMD or WDS."""
    rate, kind = float(sensor["rate"]), str(sensor["kind"])
    samples = clocks.sample_times(plan.clocks, rate, world.duration, stream(seed, f"{name} clock"))
    feel, body = _feel(world, sensor, place(plan, name, seed), samples.t)
    true_mount = inertial.mounting(sensor.get("rotation_deg", (0.0, 0.0, 0.0)), errors)
    speed = np.interp(samples.t, world.motion.t, world.speed)
    shaken = inertial.shaken(
        feel.mounted(true_mount),
        samples.t,
        speed,
        body,
        plan.errors.vibration,
        stream(seed, f"{name} vibration"),
    )
    force, rate_seen = inertial.measured(shaken, errors, rate, kind, stream(seed, f"{name} noise"))
    values = [force, rate_seen]
    if plan.errors.magnetometers:
        drawn = stream(seed, f"{name} magnetometer")
        values.append(inertial.magnetic(shaken, errors, plan.place.lat, drawn, plan.errors, rate))
    table = np.column_stack(values)
    arrival = clocks.arrivals(plan.clocks, samples.t, stream(seed, f"{name} arrivals"))
    record = clocks.ImuRecord(
        samples.t,
        world.host.reading(arrival),
        samples.t_dev_us,
        samples.seq,
        table,
        np.zeros(table.shape, bool),
    )
    rng = stream(seed, f"{name} faults")
    record = clocks.restarted(plan.faults, name, record)
    return clocks.with_empty_cells(plan.faults, clocks.faulty(plan.faults, name, record, rng), rng)


def place(plan: TwinPlan, name: str, seed: int) -> Floats:
    """Where a sensor really sits: its stated position or offset, and the plan's doubt of it, (3,) m."""
    sensor = plan.sensors[name]
    stated = np.asarray(sensor.get("position", sensor.get("offset", (0.0, 0.0, 0.0))), dtype=float)
    return stated + plan.errors.lever_arm * stream(seed, f"{name} place").standard_normal(3)


def _feel(world: World, sensor: Mapping[str, Any], at: Floats, t: Floats) -> tuple[Feel, str]:
    """What an ideal unit at the sensor's place feels, in the axes of its body or wheel; and the body it
    rides on."""
    if sensor["kind"] == "wds":
        wheel = world.wheels[sensor["wheel"]]
        return wheel.feel(world.bodies["tractor"], t).at(at), "tractor"
    return world.bodies[sensor["body"]].feel(t).at(at), sensor["body"]


def _steering(
    plan: TwinPlan, world: World, name: str, sensor: Mapping[str, Any], seed: int
) -> clocks.SteerRecord:
    """Rows of the steering sensor: zero, scale and noise on the true mean angle."""
    errors, rng = plan.errors, stream(seed, f"{name} errors")
    zero, scale = rng.standard_normal(2) * (math.radians(errors.steer_zero_deg), errors.steer_scale)
    samples = clocks.sample_times(
        plan.clocks, float(sensor["rate"]), world.duration, stream(seed, f"{name} clock")
    )
    angle = (1.0 + scale) * np.interp(samples.t, world.motion.t, world.motion.steer) + zero
    angle = angle + math.radians(errors.steer_noise_deg) * rng.standard_normal(samples.t.size)
    arrival = clocks.arrivals(plan.clocks, samples.t, stream(seed, f"{name} arrivals"))
    record = clocks.SteerRecord(samples.t, world.host.reading(arrival), angle)
    return clocks.faulty(plan.faults, name, record, stream(seed, f"{name} faults"))


def _nmea(plan: TwinPlan, world: World, name: str, sensor: Mapping[str, Any], seed: int) -> list[str]:
    """Lines of one GNSS receiver, at whole multiples of its period in UTC."""
    rng, rate = stream(seed, f"{name} errors"), float(sensor["rate"])
    t = np.arange(1, int(world.duration * rate)) / rate
    found = gnss.fixes(plan.gnss, rate, t, rng)
    body = world.bodies[sensor.get("body", "tractor")]
    headings = None
    if name in plan.gnss.heading:
        bias, white = plan.gnss.heading_bias_deg * rng.standard_normal(), rng.standard_normal(t.size)
        headings = body.place(t)[:, YAW] + np.radians(bias + plan.gnss.heading_noise_deg * white)
    antenna = place(plan, name, seed)
    lines = gnss.sentences(plan.gnss, plan.place, antenna, body, found, world.host, headings, rng)
    return gnss.corrupted(lines, plan.faults.bad_checksums, stream(seed, f"{name} faults"))


def truth_rows(plan: TwinPlan, world: World) -> Floats:
    """Rows of truth.csv at TRUTH_RATE: the centres of mass as they really move, sway included."""
    t = np.arange(int(world.duration * TRUTH_RATE) + 1) / TRUTH_RATE
    blank = np.full(t.size, np.nan)
    tractor, seeder = world.bodies["tractor"].place(t), None
    if "seeder" in world.bodies:
        seeder = world.bodies["seeder"].place(t)
    velocity = world.bodies["tractor"].velocity(t)
    along = velocity[:, X] * np.cos(tractor[:, YAW]) + velocity[:, Y] * np.sin(tractor[:, YAW])
    second = [blank] * 3 if seeder is None else [seeder[:, X], seeder[:, Y], seeder[:, YAW]]
    steer = np.interp(t, world.motion.t, world.motion.steer)
    seconds = world.host.start_ns / 1e9 + t
    return np.column_stack([seconds, tractor[:, X], tractor[:, Y], tractor[:, YAW], along, *second, steer])


def manifest_text(plan: TwinPlan) -> str:
    """run.toml of the planned pass, as the researcher would have written it."""
    run = plan.run
    table: dict[str, Any] = {"schema": 1}
    keys = ("id", "field", "direction", "repeat", "variant")
    table["run"] = {key: getattr(run, key) for key in keys} | {"date": dt.date.fromisoformat(run.date)}
    if plan.path.line:
        table["line"] = _line(plan)
    table["operating"] = {"speed": plan.path.speed, "tyre_pressure_mpa": run.tyre_pressure_mpa}
    table |= {"machine": plan.machine, "sensors": plan.sensors}
    if plan.conditions:
        table["conditions"] = plan.conditions
    return writing.toml_text(table)


def _line(plan: TwinPlan) -> dict[str, list[float]]:
    """The AB line of the first row, degrees."""
    heading, length = math.radians(plan.place.heading_deg), plan.path.row_length
    east, north = np.array([0.0, length]) * math.cos(heading), np.array([0.0, length]) * math.sin(heading)
    lat, lon, _ = to_geodetic(east, north, np.zeros(2), plan.place)
    return {key: [round(float(lat[k]), 9), round(float(lon[k]), 9)] for k, key in enumerate("ab")}


def _columns(plan: TwinPlan) -> tuple[str, ...]:
    """Columns of the unit's files that the planned logger writes."""
    gone = {"t_dev_us"} if plan.clocks.no_device_time else set()
    gone |= {"seq"} if plan.clocks.no_seq else set()
    gone |= set() if plan.errors.magnetometers else {"mx", "my", "mz"}
    return tuple(name for name in writing.IMU_COLUMNS if name not in gone)


def _facts(
    plan: TwinPlan, seed: int, world: World, errors: Mapping[str, inertial.UnitErrors]
) -> dict[str, Any]:
    """Constants of the twin for whoever checks estimates against them."""
    units = {
        name: {key: np.asarray(value).tolist() for key, value in vars(e).items()}
        for name, e in errors.items()
    }
    wheels = {name: {"radius": wheel.radius} for name, wheel in world.wheels.items()}
    host = {"start_ns": world.host.start_ns, "offset": world.host.offset, "drift": world.host.drift}
    return {"seed": seed, "plan": json.loads(json.dumps(as_table(plan), default=dict)),
            "host": host, "units": units, "wheels": wheels}  # fmt: skip
