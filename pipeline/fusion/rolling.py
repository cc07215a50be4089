"""Forward speed by the rotation of wheels: of the units in the rear wheels, else of speed sensors on the bus.

Both become the speed of the rear axle's middle at the radius that is stated; how far that is from the true speed
(radius, slip, the bus's own constants) is the filter's scale state, which GNSS tells and which wanders.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...sensors.manifest import Speed, Tractor
from ...sensors.streams import FieldLog, SpeedStream
from ..wheels import WheelMotion
from . import settings as physics
from .prepare import STEP

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

EVERY = 5  # nodes between measurements: wheel slip does not change faster than at 10 Hz
SLOWEST = 0.5  # m/s: a sensor that counts teeth loses them when the wheel creeps
QUIETEST = 0.005  # m/s: of a sensor whose noise nobody states; a bus tells 0.001 to 0.03 m/s apart
UNTOLD = 0.1  # m/s: the same where positions wander by metres and cannot tell how good the sensor is
GAP = 2.5  # nominal intervals of a speed sensor: what lies in a longer gap is not known


@dataclass(frozen=True)
class WheelSpeed:
    """Forward speed of the rear axle's middle by wheels at their stated radius, on the grid.

    speed, sd : (N,) m/s, NaN where unknown; fresh : (N,) nodes that may be used as measurements
    floor : m/s, least standard deviation of one; scale_sd : 1, of speed over true speed, less one, before the pass
    noise : figures and their sources by sensor, for the report
    """

    speed: Floats
    sd: Floats
    fresh: Bools
    floor: float = 0.0
    scale_sd: float = physics.RADIUS_SD
    noise: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    def measured(self, still: Bools, level: float) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Nodes (K,), speeds and variances (K,) of the measurements; level : m/s, tuned white error."""
        k = np.flatnonzero(self.fresh & ~still & np.isfinite(self.speed))
        doubt = self.sd[k] / max(float(np.median(self.sd[k])), 1e-9) if k.size else self.sd[k]
        return k, self.speed[k], (level * doubt) ** 2 + self.floor**2


def wheel_speed(
    t: Floats,
    wheels: Mapping[str, WheelMotion],
    log: FieldLog,
    yaw_rate: Floats,
    forwards: Floats,
    fixed: bool = True,
) -> WheelSpeed | None:
    """What the wheels say on the grid t (N,); None where nothing tells it.

    yaw_rate : (N,) rad/s of the tractor; forwards : (N,) 1 or -1, for sensors that tell no sign
    fixed : whether most positions are RTK fixed, and so tell a sensor's noise
    """
    tractor = log.manifest.machine.tractor
    rear = [w for w in wheels.values() if w.wheel.startswith("rear")]
    if rear:
        return by_units(t, rear, tractor, yaw_rate)
    streams = log.of_type(SpeedStream)
    sensors: dict[str, Speed] = log.manifest.of_kind("speed")
    told = [(sensors[name], stream) for name, stream in streams.items() if stream.t.size > 1]
    least = QUIETEST if fixed else UNTOLD
    return by_sensors(t, told, tractor, yaw_rate, forwards, least) if told else None


def by_units(t: Floats, rear: Sequence[WheelMotion], tractor: Tractor, yaw_rate: Floats) -> WheelSpeed:
    """The mean of the rear wheels' units; a side alone is moved to the middle by the turn."""
    total, variance = np.zeros(t.size), np.zeros(t.size)
    for w in rear:
        speed = np.interp(t, w.t, w.spin) * tractor.rear_wheel_radius
        speed += left_of_middle(w.wheel, tractor) * yaw_rate
        total += np.where((t < w.t[0]) | (t > w.t[-1]), np.nan, speed)
        variance += (np.interp(t, w.t, w.spin_sd) * tractor.rear_wheel_radius) ** 2
    fresh = np.zeros(t.size, dtype=np.bool_)
    fresh[::EVERY] = True
    return WheelSpeed(total / len(rear), np.sqrt(variance) / len(rear), fresh)


def by_sensors(
    t: Floats,
    told: Sequence[tuple[Speed, SpeedStream]],
    tractor: Tractor,
    yaw_rate: Floats,
    forwards: Floats,
    least: float = QUIETEST,
) -> WheelSpeed:
    """The mean of all speed sensors, each brought to the scale of the first: one that drops out makes no step.

    Their errors are not taken to average out: slip is common to them. least : m/s, where no noise is stated
    """
    speeds: list[Floats] = []
    fresh = np.zeros(t.size, dtype=np.bool_)
    for sensor, stream in told:
        signed = tells_sign(stream)
        own = np.interp(t, stream.t, stream.speed)
        speed = at_middle(own if signed else own * forwards, sensor, tractor, yaw_rate)
        speed[away(t, stream, sensor.rate)] = np.nan
        fresh |= own_nodes(t, stream) & (np.abs(np.nan_to_num(speed)) > SLOWEST)
        speeds.append(speed if not speeds else speed * ratio(speeds[0], speed))
    known = np.isfinite(speeds)
    mean = np.where(known, speeds, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    noise = min(sensor.noise or least for sensor, _ in told)
    return WheelSpeed(
        np.where(known.any(axis=0), mean, np.nan), np.ones(t.size), fresh, noise, told[0][0].scale_sd,
        {stream.name: {"speed": _stated(sensor, least)} for sensor, stream in told},
    )  # fmt: skip


def _stated(sensor: Speed, least: float) -> dict[str, Any]:
    """The least noise of a sensor; what the innovations show beyond it is the level `wheel`."""
    source = "assumed, at least" if sensor.noise is None else "manifest, at least"
    return {"value": sensor.noise or least, "unit": "m/s", "source": source}


def left_of_middle(wheel: str | None, tractor: Tractor) -> float:
    """How far a wheel's hub lies to the left of the middle, m; 0 for the vehicle's own speed."""
    if wheel is None:
        return 0.0
    track = tractor.front_track if wheel.startswith("front") else tractor.rear_track
    return 0.5 * track if wheel.endswith("left") else -0.5 * track


def at_middle(speed: Floats, sensor: Speed, tractor: Tractor, yaw_rate: Floats) -> Floats:
    """Speed (N,) of the rear axle's middle from that of a wheel's hub along the wheel's heading.

    A front wheel rolls where its hub goes, (V - w·y, w·L): V - w·y = sqrt(s² - (w·L)²), so no angle is needed.
    """
    if sensor.wheel is not None and sensor.wheel.startswith("front"):
        across = yaw_rate * (tractor.front_axle + tractor.rear_axle)
        speed = np.sign(speed) * np.sqrt(np.maximum(speed**2 - across**2, 0.0))
    return np.asarray(speed + left_of_middle(sensor.wheel, tractor) * yaw_rate)


def away(t: Floats, stream: SpeedStream, rate: float) -> Bools:
    """Where no two samples are near enough to be joined by a line."""
    after = np.clip(np.searchsorted(stream.t, t), 1, stream.t.size - 1)
    outside = (t < stream.t[0]) | (t > stream.t[-1])
    return np.asarray(outside | (stream.t[after] - stream.t[after - 1] > GAP / rate))


def own_nodes(t: Floats, stream: SpeedStream) -> Bools:
    """Nodes beside a sample, none closer together than EVERY: what lies between two samples is no news."""
    node = np.rint((stream.t - t[0]) / STEP).astype(np.int64)
    node = node[(node >= 0) & (node < t.size)]
    _, first = np.unique(node // EVERY, return_index=True)
    fresh = np.zeros(t.size, dtype=np.bool_)
    fresh[node[first]] = True
    return fresh


def ratio(reference: Floats, speed: Floats) -> float:
    """By what a second sensor's speeds are to be multiplied to be the first's, where both are known and moving."""
    both = np.isfinite(reference) & np.isfinite(speed)
    both[both] = (np.abs(reference[both]) > SLOWEST) & (np.abs(speed[both]) > SLOWEST)
    if both.sum() * STEP < 1.0:
        return 1.0
    return float(np.median(reference[both] / speed[both]))


def tells_sign(stream: SpeedStream) -> bool:
    """Whether a sensor's speed is negative backwards: it was so at more than a creep; noise about rest is no sign."""
    return bool((stream.speed < -SLOWEST).any())


def forwards_of(t: Floats, spin: Floats | None, log: FieldLog) -> Floats:
    """Direction of travel (N,), 1 or -1: by the wheels' units, else by a speed sensor that tells a sign."""
    if spin is None:
        signed = [stream for stream in log.of_type(SpeedStream).values() if tells_sign(stream)]
        spin = np.interp(t, signed[0].t, signed[0].speed) if signed else np.ones(t.size)
    return np.where(spin < 0.0, -1.0, 1.0)
