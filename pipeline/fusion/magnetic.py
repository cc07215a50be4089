"""Magnetometers: whether they prove consistent, and what may then be taken from them.

A unit's magnetometer feels the earth's field, the iron it sits in (constant in the body), iron that moves with the
ground and currents that switch. It proves consistent when the levelled field keeps its strength and inclination, when
its azimuth agrees with the smoothed yaw but for a constant (on passes that turn, but for the hard iron too), and when
what is left is noise about that constant: short-lived, without drift, the same standing and driving. Only then its
azimuth is taken, as few readings as are independent, each with a constant error that is free: declination, mounting and
hard iron cannot bias the yaw, only its changes count.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...sensors.mounting import mounting_matrix, turned
from ...sensors.streams import ImuStream
from . import state as s
from .known import Known
from .prepare import STEP

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SHORTEST = 30  # s of readings, below which nothing is proven
TURNING = 0.9  # mean resultant length of the headings below which a pass turns enough to tell hard iron from the field
EARTH = (20e-6, 70e-6)  # T: the earth's field is 22 to 67 µT everywhere
STEADY = 0.03  # relative scatter of the field's strength; a cable with 10 A half a metre away makes 4 µT, ten percent
UPRIGHT = math.radians(2.0)  # scatter of the field's inclination
LARGEST = math.radians(2.0)  # of the error of a reading
LEAST_SPACING = 5.0  # s between readings
LEAST_READINGS = 6
CORRELATED = 0.4  # of neighbouring readings
AGREE = 3.0  # standard deviations
COMMON = math.radians(0.5)  # soft iron and tilt leave an error that does not average out over a pass


@dataclass(frozen=True)
class Magnetometer:
    """What was found of one unit: reason : why it is not used, "" where it is; node, offset (rad): its readings, by how
    much they differ from the smoothed yaw; sd : rad, of a reading."""

    name: str
    body: str
    reason: str
    node: Ints
    offset: Floats
    sd: float

    @property
    def used(self) -> bool:
        return self.reason == ""


@dataclass(frozen=True)
class Seconds:
    """Means over whole seconds with readings: instants t (M,), levelled field ahead, left, up (M, 3) in T, the smoothed
    yaw (M,) rad, and whether the machine stood."""

    t: Floats
    field: Floats
    yaw: Floats
    still: NDArray[np.bool_]


def examined(known: Known, path: Floats) -> tuple[Magnetometer, ...]:
    """Every inertial unit's magnetometer against the smoothed path (N, SIZE); on each body the best alone is used."""
    found = []
    for name, stream in known.log.of_type(ImuStream).items():
        unit = known.log.manifest.of_kind("imd")[name]
        if stream.magnetic_field is None or (unit.body == "seeder" and known.two is None):
            continue
        if any(e.body == unit.body and np.isfinite(e.heading).any() for e in known.epochs):
            found.append(unused(name, unit.body, "a dual antenna tells more"))
            continue
        seconds = seconds_of(known, path, stream, unit.body, mounting_matrix(unit.rotation_deg))
        found.append(judged(name, unit.body, seconds, known.t))
    best = {m.body: m.name for m in sorted(found, key=lambda m: -m.sd) if m.used}
    return tuple(
        m if not m.used or best[m.body] == m.name else unused(m.name, m.body, f"{best[m.body]}'s is better")
        for m in found
    )


def unused(name: str, body: str, reason: str) -> Magnetometer:
    """A magnetometer that is left alone."""
    return Magnetometer(name, body, reason, np.empty(0, dtype=np.int64), np.empty(0), math.inf)


def seconds_of(known: Known, path: Floats, stream: ImuStream, body: str, mounting: Floats) -> Seconds:
    """A unit's field, levelled by the body's smoothed tilt, and the yaw there, by seconds."""
    field = stream.magnetic_field
    ok = np.zeros(stream.t.size, dtype=bool) if field is None else np.isfinite(field).all(axis=1)
    ok &= (stream.t >= known.t[0]) & (stream.t <= known.t[-1])
    if field is None or not ok.any():
        return Seconds(np.empty(0), np.empty((0, 3)), np.empty(0), np.empty(0, dtype=bool))
    t = stream.t[ok]
    columns = (
        (path[:, s.ROLL], path[:, s.PITCH], path[:, s.YAW1])
        if body == "tractor"
        else (known.nodes[:, s.N_ROLL2], known.nodes[:, s.N_PITCH2], path[:, s.YAW2])
    )
    roll, pitch, yaw = (np.interp(t, known.t, column) for column in columns)
    level = levelled(turned(field[ok], mounting), roll, pitch)
    still = np.interp(t, known.t, known.still.astype(np.float64))
    index = (t - t[0]).astype(np.int64)
    count = np.bincount(index)
    means = [np.bincount(index, v)[count > 0] / count[count > 0] for v in (t, *level.T, yaw, still)]
    return Seconds(means[0], np.column_stack(means[1:4]), means[4], means[5] > 0.5)


def levelled(field: Floats, roll: Floats, pitch: Floats) -> Floats:
    """Ry(pitch)·Rx(roll)·field, (N, 3): ahead, left, up of a body without its tilt."""
    left = np.cos(roll) * field[:, 1] - np.sin(roll) * field[:, 2]
    up = np.sin(roll) * field[:, 1] + np.cos(roll) * field[:, 2]
    ahead = np.cos(pitch) * field[:, 0] + np.sin(pitch) * up
    return np.column_stack([ahead, left, np.cos(pitch) * up - np.sin(pitch) * field[:, 0]])


def fitted(x: Seconds) -> tuple[Floats, Floats, int]:
    """Field less hard iron (M, 3), its azimuth's error against the yaw (M,) rad, and how many constants were fitted.

    (ahead, left) = Rz(−yaw)·earth + iron, by least squares; iron only where the pass turns.
    """
    c, sn, one, none = np.cos(x.yaw), np.sin(x.yaw), np.ones(x.yaw.size), np.zeros(x.yaw.size)
    turns = abs(np.mean(np.exp(1j * x.yaw))) < TURNING
    rows = np.concatenate([np.column_stack([c, sn, one, none]), np.column_stack([-sn, c, none, one])])
    count = 4 if turns else 2
    fit = np.linalg.lstsq(rows[:, :count], np.concatenate([x.field[:, 0], x.field[:, 1]]), rcond=None)[0]
    iron = fit[2:] if turns else np.zeros(2)
    field = x.field - np.append(iron, 0.0)
    error = math.atan2(fit[1], fit[0]) - np.arctan2(field[:, 1], field[:, 0]) - x.yaw
    return field, np.angle(np.exp(1j * error)), count


def lasting(error: Floats) -> float:
    """Time (s) over which the errors of successive seconds stay alike: first lag with a correlation under 1/e."""
    z = error - error.mean()
    power = float(z @ z)
    for lag in range(1, z.size // 2):
        if float(z[lag:] @ z[:-lag]) < power / math.e:
            return float(lag)
    return float(z.size // 2)


def judged(name: str, body: str, x: Seconds, t: Floats) -> Magnetometer:
    """A magnetometer's readings, or why there are none. t : (N,) nodes, s."""
    if x.t.size < SHORTEST:
        return unused(name, body, f"{x.t.size} s of readings are too few")
    field, error, constants = fitted(x)
    reason = unsteady(field, constants > 2)
    if reason:
        return unused(name, body, reason)
    spacing = max(LEAST_SPACING, 2.0 * lasting(error))
    block = ((x.t - x.t[0]) / spacing).astype(np.int64)
    count = np.bincount(block)
    full = count >= 0.5 * spacing
    at, offset = (np.bincount(block, v)[full] / count[full] for v in (x.t, error))
    if offset.size < LEAST_READINGS:
        return unused(
            name, body, f"its error lasts {0.5 * spacing:.0f} s of {x.t[-1] - x.t[0]:.0f} s: no noise"
        )
    reason = not_noise(x, error, offset)
    if reason:
        return unused(name, body, reason)
    n = offset.size
    variance = max(float(np.var(offset)) * n / (n - constants), n * COMMON**2)
    node = np.clip(np.rint((at - t[0]) / STEP), 0, t.size - 1).astype(np.int64)
    return Magnetometer(name, body, "", node, offset, math.sqrt(variance))


def unsteady(field: Floats, whole: bool) -> str:
    """Why a field (M, 3) without its hard iron is not the earth's; `whole`: hard iron was found and is off it."""
    strength = np.sqrt(np.sum(field**2, axis=1))
    mean = float(strength.mean())
    if whole and not EARTH[0] <= mean <= EARTH[1]:
        return f"its field of {mean * 1e6:.0f} µT is not the earth's"
    if float(strength.std()) > STEADY * mean:
        return f"its field's strength varies by {100.0 * float(strength.std()) / mean:.0f} %"
    dip = np.arctan2(field[:, 2], np.hypot(field[:, 0], field[:, 1]))
    if float(dip.std()) > UPRIGHT:
        return f"its field's inclination varies by {math.degrees(float(dip.std())):.1f}°"
    return ""


def not_noise(x: Seconds, error: Floats, offset: Floats) -> str:
    """Why the readings' errors (n,) are not noise about a constant; error : (M,) by seconds."""
    size, n = float(offset.std()), offset.size
    if size > LARGEST:
        return f"it errs by {math.degrees(size):.1f}°"
    z = offset - offset.mean()
    alike = float(z[1:] @ z[:-1]) / max(float(z @ z), 1e-30)
    if alike > max(CORRELATED, 1.6 / math.sqrt(n)):
        return f"neighbouring errors are alike ({alike:.1f})"
    drift = float(offset[n // 2 :].mean() - offset[: n // 2].mean())
    if abs(drift) > AGREE * size * 2.0 / math.sqrt(n):
        return f"it drifts by {math.degrees(drift):.1f}°"
    if x.still.any() and not x.still.all():
        apart = float(error[x.still].mean() - error[~x.still].mean())
        if abs(apart) > AGREE * size:
            return f"standing and driving it differs by {math.degrees(apart):.1f}°"
    return ""


def readings(
    found: Sequence[Magnetometer], yaw: tuple[Floats, Floats]
) -> list[tuple[int, Ints, Floats, float]]:
    """Measurements of the magnetometers that are used: kind, nodes, azimuths (rad), variance.

    yaw : the paths' yaws that the offsets were taken from, on the grid
    """
    out = []
    for m in found:
        if m.used:
            kind, own = (s.MAGNETIC1, yaw[0]) if m.body == "tractor" else (s.MAGNETIC2, yaw[1])
            out.append((kind, m.node, own[m.node] + m.offset, m.sd**2))
    return out


def with_magnetometers(known: Known, path: Floats) -> Known:
    """What is known, with the magnetometers' findings and readings beside it."""
    found = examined(known, path)
    own = readings(found, (path[:, s.YAW1], path[:, s.YAW2]))
    return replace(known, azimuths=tuple(own), magnetic={m.name: (m.reason, m.sd) for m in found})
