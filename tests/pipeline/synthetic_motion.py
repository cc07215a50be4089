"""Motions with known truth: the model's own run, and smoothed motions drawn about it from a stated
covariance.

The "field" is a simulation with a driver and random soil forces; a `Motion` is the truth plus errors whose
covariance is known, with draws from that same covariance. Nothing of the fusion is involved.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from smts_validate.model.inputs import Controls, Driver, ForceSeries, coloured_noise, straight_path
from smts_validate.model.machine import Machine
from smts_validate.model.simulate import SimulatedRun, initial_state, simulate
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion, Origin, SteerInput
from smts_validate.sensors.draft_text import MACHINE, SEEDER
from smts_validate.sensors.manifest import Manifest, parse

Floats = NDArray[np.float64]

T0 = 1_747_216_800.0
STEP = 0.02
DRAW_EVERY = 12  # samples of 1/50 s between the draws' times

RUN_TOML = (
    """schema = 1
[run]
id = "synthetic-1"
field = "field1"
direction = "east"
repeat = 1
variant = "b"
date = 2025-05-14
[operating]
speed = 2.8
tyre_pressure_mpa = 0.10
"""
    + MACHINE
    + SEEDER
    + """[sensors.imd1]
kind = "imd"
body = "tractor"
file = "imd1.csv"
position = [0.3, 0.0, -0.2]
rate = 100.0
[sensors.imd2]
kind = "imd"
body = "seeder"
file = "imd2.csv"
position = [0.0, 0.0, 0.1]
rate = 100.0
[sensors.gps]
kind = "gps"
file = "gps.nmea"
position = [0.0, 0.0, 2.1]
rate = 10.0
"""
)


@dataclass(frozen=True)
class Errors:
    """Stated standard deviations (m, rad, m/s, rad/s) and correlation times (s) of a smoothed motion's
    errors."""

    slow: float = 0.008
    slow_time: float = 30.0
    fast: float = 0.004
    fast_time: float = 1.0
    yaw1: float = float(np.deg2rad(0.05))
    yaw2: float = float(np.deg2rad(0.08))
    yaw_time: float = 3.0
    speed: float = 0.005
    rate: float = 0.001
    steer: float = float(np.deg2rad(0.1))
    steer_time: float = 2.0
    steer_zero: float = float(np.deg2rad(0.1))
    steer_scale: float = 0.005
    misstated: float = 1.0  # factor on the variances stated, of the true ones


@dataclass(frozen=True)
class Field:
    """What the ground and the driver do in the truth."""

    heading: float = 0.02
    length: float = 130.0
    swing: float = 0.055  # m, amplitude of the wish to weave
    wavelength: float = 15.0
    soil_force: float = 0.0  # N, lateral
    soil_moment: float = 0.0
    soil_length: float = 3.0
    driver: Driver = field(default_factory=lambda: Driver(preview=6.0))


def manifest_of(**run: object) -> Manifest:
    """The manifest of the synthetic machine, with keys of [run] replaced."""
    manifest = parse(RUN_TOML)
    return manifest.model_copy(update={"run": manifest.run.model_copy(update=run)})


def alone(manifest: Manifest) -> Manifest:
    """The same tractor without its seeder."""
    text = RUN_TOML
    for table in ("[machine.seeder]", "[machine.tyres.seeder]", "[sensors.imd2]"):
        start = text.index(table)
        stop = text.find("\n[", start + 1)
        text = text[:start] + text[stop + 1 :]
    return parse(text).model_copy(update={"run": manifest.run})


def machine_of(manifest: Manifest) -> Machine:
    """The model's machine of a manifest."""
    return Machine.from_mapping(manifest.machine.model_dump(), manifest.operating.tyre_pressure_mpa)


def truth_of(machine: Machine, field_: Field, speed: float, seed: int) -> SimulatedRun:
    """A pass as it truly went: driver, weave and soil, from 4 s before the row on."""
    generator = np.random.default_rng(seed)
    seconds = field_.length / speed + 10.0
    t = np.arange(0.0, seconds, STEP)
    phase = generator.uniform(0.0, 2.0 * np.pi)
    size = field_.swing * (2.0 * np.pi / field_.wavelength) ** 2
    wobble = coloured_noise(generator, t.size, STEP, 0.3, 4.0)
    steer = 2.6 * size * (np.sin(2.0 * np.pi * speed * t / field_.wavelength + phase) + wobble)
    spacing = 0.25
    count = int(seconds * speed / spacing) + 10
    forces = np.zeros((count, 6))
    for column, sd in (
        (1, field_.soil_force),
        (2, field_.soil_moment),
        (4, field_.soil_force),
        (5, field_.soil_moment),
    ):
        forces[:, column] = coloured_noise(generator, count, spacing, 1.0, field_.soil_length) * sd
    controls = Controls(
        t=t,
        speed=speed * (1.0 + 0.01 * coloured_noise(generator, t.size, STEP, 1.0, 5.0)),
        steer=steer,
        driver=field_.driver,
        path=straight_path(0.0, 0.0, field_.heading, 500.0),
        over_distance=ForceSeries(spacing, forces),
    )
    initial = initial_state(
        0.0, 0.0, field_.heading, None if machine.seeder is None else field_.heading, speed
    )
    return simulate(machine, controls, initial, t)


def motion_of(run: SimulatedRun, machine: Machine, errors: Errors, seed: int, draws: int = 100) -> Motion:
    """A smoothed motion about the truth, with `draws` posterior draws from the stated covariance."""
    generator = np.random.default_rng(seed)
    t = run.t - run.t[0]
    made = body_errors(run, machine, errors, generator)
    stated = replace(
        errors,
        **{n: getattr(errors, n) * np.sqrt(errors.misstated) for n in ("slow", "fast", "yaw1", "yaw2")},
    )
    some = np.stack([body_errors(run, machine, stated, generator)[::DRAW_EVERY] for _ in range(draws)])
    bodies = [
        _body(run, b, made, stated, machine, generator)
        for b in ("1", "2")
        if getattr(run, "x" + b) is not None
    ]
    steer_error = coloured_noise(generator, t.size, STEP, errors.steer, errors.steer_time)
    angle = run.steer * (1.0 + errors.steer_scale * generator.standard_normal())
    angle = angle + steer_error + errors.steer_zero * generator.standard_normal()
    series = SteerInput(
        angle,
        np.full(t.size, errors.steer),
        errors.steer_time,
        errors.steer_zero,
        errors.steer_scale,
        "sensor",
    )
    return Motion(
        t=T0 + t, origin=Origin(50.04, 36.48, 150.0), tractor=bodies[0],
        seeder=bodies[1] if len(bodies) > 1 else None,
        steer=angle, sd_steer=np.full(t.size, errors.steer), steer_input=series,
        draw_t=T0 + t[::DRAW_EVERY], draws=some if len(bodies) > 1 else some[:, :, :3],
        gnss_t=T0 + t[::5],
    )  # fmt: skip


def body_errors(
    run: SimulatedRun, machine: Machine, errors: Errors, generator: np.random.Generator
) -> Floats:
    """(N, 6) errors of x1, y1, yaw1, x2, y2, yaw2 at 1/50 s: position shared, the seeder's place by its
    yaws."""
    size = run.t.size

    def noise(sd: float, time: float) -> Floats:
        return coloured_noise(generator, size, STEP, sd, time)

    found = np.zeros((size, 6))
    for column in (0, 1):
        found[:, column] = noise(errors.slow, errors.slow_time) + noise(errors.fast, errors.fast_time)
    found[:, 2] = noise(errors.yaw1, errors.yaw_time)
    if run.yaw2 is None or machine.seeder is None:
        return found
    found[:, 5] = noise(errors.yaw2, errors.yaw_time)
    l4, l5 = machine.tractor.hitch, machine.seeder.hitch_to_com
    found[:, 3] = found[:, 0] + l4 * np.sin(run.yaw1) * found[:, 2] + l5 * np.sin(run.yaw2) * found[:, 5]
    found[:, 4] = found[:, 1] - l4 * np.cos(run.yaw1) * found[:, 2] - l5 * np.cos(run.yaw2) * found[:, 5]
    return found


def _body(
    run: SimulatedRun, b: str, made: Floats, stated: Errors, machine: Machine, generator: np.random.Generator
) -> BodyMotion:
    first = 0 if b == "1" else 3
    size = run.t.size
    covariance = np.zeros((size, 6, 6))
    place = stated.slow**2 + stated.fast**2
    lever = 0.0 if b == "1" or machine.seeder is None else (
        (machine.tractor.hitch * stated.yaw1) ** 2 + (machine.seeder.hitch_to_com * stated.yaw2) ** 2
    )  # fmt: skip
    yaw = stated.yaw1 if b == "1" else stated.yaw2
    diagonal = (place, place + lever, yaw**2, stated.speed**2, stated.speed**2, stated.rate**2)
    for i, value in enumerate(diagonal):
        covariance[:, i, i] = value

    def values(name: str) -> Floats:
        return np.asarray(getattr(run, name + b), dtype=np.float64)

    def noisy(name: str, sd: float) -> Floats:
        return values(name) + coloured_noise(generator, size, STEP, sd, 1.0)

    nan = np.full(size, np.nan)
    return BodyMotion(
        x=values("x") + made[:, first], y=values("y") + made[:, first + 1],
        yaw=values("yaw") + made[:, first + 2],
        v=noisy("v", stated.speed), v_lateral=noisy("v_lateral", stated.speed),
        yaw_rate=noisy("yaw_rate", stated.rate),
        covariance=covariance, roll=nan, pitch=nan, lateral_acceleration=values("ay"),
    )  # fmt: skip
