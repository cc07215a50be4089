"""A body's gyro against the course over ground: rotations in the wrong unit are 57 times too large or too small."""

from __future__ import annotations

import numpy as np

from .streams import Floats, GnssStream
from .utc import over_ground

WINDOW = 2.0  # s, over which both turn: long against the noise of a course
DRIVING = 0.5  # m/s: below it a course is noise
REVERSED = 1.0  # rad/s: a course that turns faster is that of a machine which began to reverse
LEAST_PAIRS = 50
ALIKE = 0.8  # correlation from which a ratio means something
DEGREES = 180.0 / np.pi
FACTOR = (
    2.0  # so near must a ratio be to that of the two units: a seeder turns less than the tractor ahead of it
)
WILD = 1.2  # rad/s rms: no body rocks and turns so for a whole pass
CALM = 0.005  # rad/s rms: any machine that drives rocks more
TO_DEGREES = 'rotations look like deg/s: set units = { gyro = "deg/s" }'
TO_RADIANS = 'rotations look like rad/s: remove gyro = "deg/s" from units'


def course_turning(gnss: GnssStream) -> tuple[Floats, Floats, Floats]:
    """Start and length (s) of windows in which the receiver drove, and the course's mean turn rate there, rad/s."""
    values = {key: getattr(gnss, key) for key in ("course", "speed", "lat", "lon", "alt")}
    course, speed = over_ground(gnss.t, values)
    with np.errstate(invalid="ignore"):
        known = np.isfinite(course) & (speed > DRIVING)
    t, course = gnss.t[known], course[known]
    stop = np.searchsorted(t, t + WINDOW)
    start = np.flatnonzero(stop < t.size)
    stop = stop[start]
    span = t[stop] - t[start]
    rate = ((course[stop] - course[start] + np.pi) % (2.0 * np.pi) - np.pi) / span
    sound = (span < 1.5 * WINDOW) & (np.abs(rate) < REVERSED)
    return t[start][sound], span[sound], rate[sound]


def turning_ratio(
    t: Floats, yaw_rate: Floats, gnss: GnssStream, late: float = 0.0
) -> tuple[bool, float | None]:
    """Whether the machine drove, and how many times as much a gyro turned as the course.

    t, yaw_rate : (N,) s and rad/s, about the body's vertical
    late : s, by which the body turns after the receiver's

    The ratio is None where the two have too little in common: on a straight row a course is mostly noise.
    """
    start, span, rate = course_turning(gnss)
    inside = (start + late >= t[0]) & (start + span + late <= t[-1])
    start, span, rate = start[inside] + late, span[inside], rate[inside]
    if start.size < LEAST_PAIRS:
        return False, None
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * np.diff(t))])
    mine = (np.interp(start + span, t, angle) - np.interp(start, t, angle)) / span
    sizes = float(mine.std()), float(rate.std())
    if min(sizes) <= 0.0 or np.corrcoef(mine, rate)[0, 1] < ALIKE:
        return True, None
    return True, sizes[0] / sizes[1]


def unit_hints(drove: bool, ratio: float | None, rotation: Floats, in_degrees: bool) -> tuple[str, ...]:
    """The unit of the gyro that would fit.

    drove, ratio : see `turning_ratio`; without a ratio the size of all rotation must tell
    rotation : (N, 3) rad/s as read; in_degrees : whether run.toml says that its values are deg/s
    """
    size = float(np.sqrt(np.sum(np.var(rotation, axis=0))))
    if ratio is None:
        large, small = size > WILD, drove and in_degrees and size < CALM
    else:
        large, small = (1.0 / FACTOR < share < FACTOR for share in (ratio / DEGREES, ratio * DEGREES))
    if large:
        return (TO_DEGREES,)
    return (TO_RADIANS,) if small else ()
