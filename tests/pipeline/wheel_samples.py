"""Wheel-mounted units made from first principles: axes and a position 500 times a second, differentiated.

Nothing of the project's own kinematics is used: the unit's position in space is differenced twice for its
specific force, its axes once for its angular velocity.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from smts_validate.pipeline.wheels import Carrier
from smts_validate.sensors.manifest import Manifest, Wds, parse
from smts_validate.sensors.streams import WheelStream

Floats = NDArray[np.float64]

FINE = 500  # Hz
RATE = 100  # Hz
G = 9.80665
START = 1.7473e9  # s, UTC
RADIUS = {"front": 0.62, "rear": 0.80}

MANIFEST = """
schema = 1
[run]
id = "wheels"
date = 2025-05-15
[operating]
speed = 2.6
tyre_pressure_mpa = 0.11
[machine.tractor]
mass = 4800.0
yaw_inertia = 8600.0
front_track = 1.9
rear_track = 1.8
front_axle = 1.38
rear_axle = 1.17
hitch = 1.98
cog_height = 1.0
front_wheel_radius = 0.62
rear_wheel_radius = 0.8
[machine.tyres.front]
cornering_stiffness = 55000.0
friction = 0.6
rolling_resistance = 0.08
[machine.tyres.rear]
cornering_stiffness = 90000.0
friction = 0.6
rolling_resistance = 0.08
[sensors.imd1]
kind = "imd"
body = "tractor"
file = "imd1.csv"
position = [0.0, 0.0, 0.0]
rate = 100.0
[sensors.wds1]
kind = "wds"
wheel = "front_right"
file = "wds1.csv"
offset = [0.05, 0.02, 0.10]
rate = 100.0
[sensors.wds2]
kind = "wds"
wheel = "front_left"
file = "wds2.csv"
offset = [-0.08, 0.03, 0.04]
rotation_deg = [0.0, 0.0, 180.0]
rate = 100.0
[sensors.wds3]
kind = "wds"
wheel = "rear_right"
file = "wds3.csv"
offset = [0.1, -0.02, 0.06]
rotation_deg = [0.0, 45.0, 0.0]
rate = 100.0
[sensors.gps]
kind = "gps"
body = "tractor"
file = "gps.nmea"
position = [0.0, 0.0, 2.1]
rate = 10.0
"""


def manifest(extra: str = "") -> Manifest:
    return parse(MANIFEST + extra)


@dataclass(frozen=True)
class Drive:
    """A tractor's motion on a grid of 1/FINE s: speed of every hub [m/s]; heading and the rest in rad."""

    t: Floats
    speed: Floats
    yaw: Floats
    steer: Floats
    roll: Floats
    pitch: Floats

    @property
    def mirrored(self) -> Drive:
        return replace(self, yaw=-self.yaw, steer=-self.steer, roll=-self.roll)


def weaving(seconds: float = 40.0, speed: float = 2.6, rest: float = 4.0, swing: float = 0.012) -> Drive:
    """Rest, start, weave on rough ground at a speed that varies, rest again."""
    t = np.arange(int(seconds * FINE)) / FINE
    ramp = np.clip((t - rest) / 4.0, 0.0, 1.0) * np.clip((seconds - rest - t) / 4.0, 0.0, 1.0)
    ramp = ramp * ramp * (3.0 - 2.0 * ramp)
    steer = ramp * (0.02 * np.sin(0.9 * t) + 0.01 * np.sin(2.3 * t + 1.0))
    yaw = 0.4 + integral(speed * ramp * np.tan(steer) / 2.55)
    roll = swing * ramp * (np.sin(7.1 * t) + 0.6 * np.sin(11.3 * t + 0.5) + 0.8 * np.sin(1.9 * t)) + 0.01
    pitch = swing * ramp * (np.sin(8.3 * t + 1.0) + 0.7 * np.sin(14.9 * t)) - 0.005
    return Drive(t, speed * ramp * (1.0 + 0.03 * np.sin(0.5 * t)), yaw, steer, roll, pitch)


def integral(rate: Floats) -> Floats:
    return np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]))) / FINE


@dataclass(frozen=True)
class Flaws:
    """What is wrong with a unit; noise is a sample's sigma, tilt_deg turns the unit against its statement."""

    gyro_noise: float = 0.0
    accel_noise: float = 0.0
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    accel_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_scale: float = 0.0
    tilt_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    displaced: tuple[float, float, float] = (0.0, 0.0, 0.0)


FLAWLESS = Flaws()


def ordinary(rng: np.random.Generator, level: float = 1.0) -> Flaws:
    """A random unit of ordinary quality (level 1) or of bad."""
    return Flaws(
        gyro_noise=0.0013,
        accel_noise=0.3,
        gyro_bias=tuple(0.004 * level * rng.standard_normal(3)),
        accel_bias=tuple(0.06 * level * rng.standard_normal(3)),
        gyro_scale=0.003 * level * float(rng.standard_normal()),
        tilt_deg=tuple(0.25 * level * rng.standard_normal(3)),
        displaced=tuple(0.005 * level * rng.standard_normal(3)),
    )


@dataclass(frozen=True)
class Truth:
    """True at the unit's samples: phase against the body, spin, the wheel's rate about the body's z axis."""

    phase: Floats
    spin: Floats
    yaw_rate: Floats
    steer: Floats


def body_rate(drive: Drive) -> Floats:
    """Angular velocity of the body in its axes, (N, 3), on the fine grid."""
    return _angular(_body(drive))


def carrier(drive: Drive, rng: np.random.Generator | None = None, bias: Floats | float = 0.0) -> Carrier:
    rate = body_rate(drive)[:: FINE // RATE]
    noise = 0.0 if rng is None else 0.0013 * rng.standard_normal(rate.shape)
    return Carrier(START + drive.t[:: FINE // RATE], rate + noise + bias)


def unit(
    drive: Drive,
    sensor: Wds,
    flaws: Flaws = FLAWLESS,
    rng: np.random.Generator | None = None,
    phase0: float = 1.0,
) -> tuple[WheelStream, Truth]:
    """Stream of a unit on one wheel and the truth at its samples."""
    front = sensor.wheel.startswith("front")
    steer = drive.steer if front else np.zeros_like(drive.t)
    spin = drive.speed / RADIUS[sensor.wheel.split("_")[0]]
    phase = phase0 + integral(spin)
    course = drive.yaw + steer
    hub = np.column_stack(
        [integral(drive.speed * np.cos(course)), integral(drive.speed * np.sin(course)), 0.0 * steer]
    )
    hub_axes = _body(drive) * Rotation.from_rotvec(np.outer(steer, [0.0, 0.0, 1.0]))
    wheel = hub_axes * Rotation.from_rotvec(np.outer(phase, [0.0, 1.0, 0.0]))
    place = hub + wheel.apply(np.asarray(sensor.offset) + flaws.displaced)
    mounted = wheel * _zyx(sensor.rotation_deg) * _zyx(flaws.tilt_deg)
    pull = np.gradient(np.gradient(place, 1.0 / FINE, axis=0), 1.0 / FINE, axis=0) + np.array([0.0, 0.0, G])
    every = slice(None, None, FINE // RATE)
    force, rate = mounted.inv().apply(pull)[every], _angular(mounted)[every]
    rng = np.random.default_rng(0) if rng is None else rng
    force = force + flaws.accel_bias + flaws.accel_noise * rng.standard_normal(force.shape)
    rate = (
        rate * (1.0 + flaws.gyro_scale) + flaws.gyro_bias + flaws.gyro_noise * rng.standard_normal(rate.shape)
    )
    t = START + drive.t[every]
    about_z = body_rate(drive)[every, 2] + np.gradient(steer, 1.0 / FINE)[every]
    return WheelStream("wds", t, t + 0.01, force, rate), Truth(
        phase[every], spin[every], about_z, steer[every]
    )


def thinned(stream: WheelStream, keep: NDArray[np.bool_]) -> WheelStream:
    """The stream without some of its samples."""
    force, rate = stream.specific_force[keep], stream.angular_velocity[keep]
    return WheelStream(stream.name, stream.t[keep], stream.t_arrival[keep], force, rate)


@dataclass(frozen=True)
class Scene:
    """All the wheel units of a manifest on one drive."""

    drive: Drive
    manifest: Manifest
    streams: dict[str, WheelStream]
    truths: dict[str, Truth]
    carrier: Carrier = field(repr=False)


def scene(drive: Drive, seed: int | None = None, level: float = 1.0, extra: str = "") -> Scene:
    """A drive seen by flawless units (seed None) or by random ones."""
    read = manifest(extra)
    streams, truths = {}, {}
    for index, (name, sensor) in enumerate(read.of_kind("wds").items()):
        rng = np.random.default_rng([0 if seed is None else seed, index])
        flaws = Flaws() if seed is None else ordinary(rng, level)
        streams[name], truths[name] = unit(drive, sensor, flaws, rng, phase0=float(index))
    if seed is None:
        return Scene(drive, read, streams, truths, carrier(drive))
    rng = np.random.default_rng([seed, 99])
    return Scene(drive, read, streams, truths, carrier(drive, rng, 0.004 * level * rng.standard_normal(3)))


def _body(drive: Drive) -> Rotation:
    return Rotation.from_euler("ZYX", np.column_stack([drive.yaw, drive.pitch, drive.roll]))


def _zyx(rotation_deg: tuple[float, float, float]) -> Rotation:
    return Rotation.from_euler("ZYX", rotation_deg[::-1], degrees=True)


def _angular(axes: Rotation) -> Floats:
    """Angular velocity in the frame's own axes, by central differences."""
    step = (axes[:-1].inv() * axes[1:]).as_rotvec() * FINE
    return np.vstack([step[:1], 0.5 * (step[1:] + step[:-1]), step[-1:]])
