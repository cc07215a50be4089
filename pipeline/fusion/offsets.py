"""How large the constant errors of a pass's accelerometers are: what they read along and up, where the truth is known.

Across the path an accelerometer's offset and a slope of the ground look the same on a straight row, and how much of
the reading is slope depends on how large offsets are. Data sheets differ by a factor of ten. Along the way the heights
that the receiver sees tell the offset, and upwards gravity does: units that are good in those axes are good across.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...sensors.manifest import GRAVITY
from . import settings as physics
from .epochs import Epochs
from .ground import of_the_ground

Floats = NDArray[np.float64]

FACTOR = 2.0  # one standard deviation of the lognormal prior about ACCEL_BIAS
SCALE = 0.005  # 1: MEMS scale error by data sheets; it is gravity that a vertical axis reads
LEAST_WAY = 30.0  # m from end to end that tell a mean slope
ENDS = 20  # altitudes at each end


@dataclass(frozen=True)
class Reading:
    """A body's mean reading less what it should have read (m/s²), of how many units, and its variance beside theirs."""

    value: float
    units: int
    other: float


def upwards(force: Floats, units: int) -> Reading:
    """Of the force (N, 3), m/s²: the size of its mean, which a slope leaves as it is."""
    size = float(np.linalg.norm(force.mean(axis=0)))
    return Reading(size - GRAVITY, units, (SCALE * GRAVITY) ** 2 / units)


def along(force: Floats, way: Floats, speed: Floats, rise: tuple[float, float], units: int) -> Reading | None:
    """Of the forward force (N,), m/s², over the way (N,), m: its work less that of gravity and of gathering speed.

    speed : (N,) m/s; rise : m, height gained along the way, and its deviation. None where the way is too short.
    """
    step = np.diff(way, prepend=way[:1])
    net = float(step.sum())
    if abs(net) < LEAST_WAY:
        return None
    work = float(force @ step) - 0.5 * float(speed[-1] ** 2 - speed[0] ** 2)
    other = (GRAVITY * rise[1] / net) ** 2 + (GRAVITY * physics.LEAN) ** 2
    return Reading((work - GRAVITY * rise[0]) / net, units, other + (GRAVITY * physics.MOUNT_SD) ** 2 / units)


def risen(e: Epochs) -> tuple[float, float] | None:
    """Height that the receiver gains from the start to the end of the pass, and its deviation, m; None without any."""
    ok = np.flatnonzero(of_the_ground(e) & np.isfinite(e.z))
    if ok.size < 2 * ENDS:
        return None
    first, last = ok[:ENDS], ok[-ENDS:]
    sd = 2.0 * math.hypot(float(np.median(e.sd[first])), float(np.median(e.sd[last])))
    return float(np.median(e.z[last]) - np.median(e.z[first])), sd


def offset_sd(readings: Sequence[Reading]) -> float:
    """Standard deviation of a unit's offset across, m/s², its mounting included, by what its other axes read.

    Lognormal prior of a factor FACTOR about ACCEL_BIAS, normal likelihood of the readings; the mean of the variance.
    """
    size = np.geomspace(0.02, 50.0, 80) * physics.ACCEL_BIAS
    score = -0.5 * (np.log(size / physics.ACCEL_BIAS) / math.log(FACTOR)) ** 2
    for r in readings:
        variance = size**2 / r.units + r.other
        score -= 0.5 * (np.log(variance) + r.value**2 / variance)
    weight = np.exp(score - score.max())
    mean = float(weight @ size**2 / weight.sum())
    return math.sqrt(mean + (GRAVITY * physics.MOUNT_SD) ** 2)
