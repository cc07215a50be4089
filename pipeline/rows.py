"""Rows: the straight stretches of a pass that are compared, each with its AB line."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ..sensors.geodesy import Line, to_enu
from ..sensors.manifest import Manifest
from .fusion.motion import Motion

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

HELD_SPEED = 0.9  # of the nominal speed
LARGEST_ANGLE = np.deg2rad(10.0)  # between the track and its line
LARGEST_CURVATURE = 0.02  # 1/m
SHORTEST_ROW = 60.0  # m
WORTH_MENTIONING = 15.0  # m: shorter steady stretches are turns' middles and need no word
LINE_ANGLE, LINE_OFFSET = np.deg2rad(5.0), 2.0  # how near the manifest's line must lie to serve a row
BENT_OVER = 10.0  # m: weaving averages out over so much
SMOOTHED_OVER = 1.0  # s: a sample's noise neither begins nor ends a row
COMPASS = ("east", "north-east", "north", "north-west", "west", "south-west", "south", "south-east")


@dataclass(frozen=True)
class Row:
    """One row: samples start to stop (excluded) of the motion's grid, and its line in the direction of
    travel.

    direction is the compass point of travel; source tells whether the line is the manifest's or fitted;
    length is the distance in m that the tractor's CoM covers along the line.
    """

    index: int
    line: Line
    start: int
    stop: int
    direction: str
    source: Literal["manifest", "fitted"]
    length: float

    @property
    def samples(self) -> slice:
        """The row's samples of the motion's grid."""
        return slice(self.start, self.stop)


@dataclass(frozen=True)
class PassedOver:
    """A steady stretch that is no row, and why: nothing is left out silently. start, stop : s, UTC."""

    start: float
    stop: float
    length: float
    reason: str


@dataclass(frozen=True)
class Survey:
    """The rows of a pass, and the stretches that were passed over."""

    rows: tuple[Row, ...]
    passed_over: tuple[PassedOver, ...]


def find_rows(motion: Motion, manifest: Manifest) -> tuple[Row, ...]:
    """The rows of a pass, numbered from 0 (see `survey`)."""
    return survey(motion, manifest).rows


def survey(motion: Motion, manifest: Manifest) -> Survey:
    """Rows and passed-over stretches of a pass.

    A row begins where 90 % of the nominal speed is held and the track is straight (within 10° of its line,
    curvature under 0.02 1/m), ends where that ends, and is 60 m or longer.
    """
    given = manifest_line(motion, manifest)
    rows: list[Row] = []
    passed: list[PassedOver] = []
    for start, stop in straight_stretches(motion, manifest.operating.speed):
        row = _row(len(rows), motion, start, stop, given)
        if row.length >= SHORTEST_ROW:
            rows.append(row)
        elif row.length >= WORTH_MENTIONING:
            reason = f"{row.length:.1f} m long, a row needs {SHORTEST_ROW:.0f} m"
            passed.append(PassedOver(float(motion.t[start]), float(motion.t[stop - 1]), row.length, reason))
    return Survey(tuple(rows), tuple(passed))


def manifest_line(motion: Motion, manifest: Manifest) -> Line | None:
    """The manifest's AB line in the motion's ENU plane, None where it gives none."""
    if manifest.line is None:
        return None
    lat, lon = np.array([manifest.line.a, manifest.line.b], dtype=np.float64).T
    east, north, _ = to_enu(lat, lon, np.full(2, motion.origin.alt), motion.origin)
    return Line(np.array([east[0], north[0]]), np.array([east[1], north[1]]))


def straight_stretches(motion: Motion, nominal_speed: float) -> Iterator[tuple[int, int]]:
    """(start, stop) of every stretch at speed and without a bend, cut where the track leaves its line's
    heading."""
    steady = steady_samples(motion, nominal_speed)
    for start, stop in runs(steady):
        yield from _within_heading(motion, start, stop)


def steady_samples(motion: Motion, nominal_speed: float) -> Mask:
    """(N,) whether the speed is held and the track is not bent.

    Speed is smoothed over 1 s. Curvature |yaw rate / speed| is looked at over 1 s and over 10 m, and one of
    them must be small: a machine that weaves bends sharply for a second and not over 10 m, a turn does both.
    """
    step = float(np.median(np.diff(motion.t))) if motion.t.size > 1 else 1.0
    second, stretch = (max(1, round(t / step)) for t in (SMOOTHED_OVER, BENT_OVER / nominal_speed))
    speed, yaw_rate = motion.tractor.v, motion.tractor.yaw_rate
    bent = [
        np.abs(uniform_filter1d(yaw_rate, width))
        > LARGEST_CURVATURE * np.maximum(uniform_filter1d(speed, width), 1e-9)
        for width in (second, stretch)
    ]
    fast = uniform_filter1d(speed, second) >= HELD_SPEED * nominal_speed
    return np.asarray(fast & ~(bent[0] & bent[1]))


def runs(mask: Mask) -> list[tuple[int, int]]:
    """(start, stop) of each unbroken run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _within_heading(motion: Motion, start: int, stop: int) -> list[tuple[int, int]]:
    """The parts of a stretch whose yaw stays within 10° of the part's own line.

    A stretch that does not is cut in two where its heading changes, or, when it has one heading, at the
    samples
    that stray.
    """
    pending, done = [(start, stop)], []
    while pending:
        first, last = pending.pop(0)
        if last - first < 4 or _span(motion, first, last) < WORTH_MENTIONING:
            continue
        yaw = motion.tractor.yaw[first:last]
        line = fit_line(motion.tractor.x[first:last], motion.tractor.y[first:last])
        near = np.abs(wrapped(yaw - line.heading)) <= LARGEST_ANGLE
        if near.all():
            done.append((first, last))
            continue
        place, change = change_of_heading(yaw)
        parts = [(0, place), (place, last - first)] if change > LINE_ANGLE else runs(near)
        pending.extend((first + a, first + b) for a, b in parts)
    return sorted(done)


def change_of_heading(yaw: Floats) -> tuple[int, float]:
    """Where two constant headings describe a yaw (N,) best, and by how much they differ, rad.

    Two means that leave the least sum of squares are those with the most k·(N − k)/N·(difference)².
    """
    count = np.arange(1, yaw.size)
    sums = np.cumsum(yaw - yaw[0])
    difference = sums[:-1] / count - (sums[-1] - sums[:-1]) / (yaw.size - count)
    best = int(np.argmax(count * (yaw.size - count) * difference**2))
    return best + 1, float(abs(difference[best]))


def _span(motion: Motion, start: int, stop: int) -> float:
    """Diagonal of the stretch's extent, m: an outward and a return leg are not short for ending where they began."""
    x, y = motion.tractor.x[start:stop], motion.tractor.y[start:stop]
    return float(np.hypot(np.ptp(x), np.ptp(y)))


def fit_line(x: Floats, y: Floats) -> Line:
    """Orthogonal least squares line through a track (N,), from its first point's foot to its last's.

    The direction is the eigenvector of the larger eigenvalue of the points' scatter matrix, turned to the
    direction of travel.
    """
    points = np.column_stack((x, y))
    centre = points.mean(axis=0)
    _, vectors = np.linalg.eigh(np.cov((points - centre).T))
    along = vectors[:, -1]
    if (points[-1] - points[0]) @ along < 0.0:
        along = -along
    first, last = (points[[0, -1]] - centre) @ along
    return Line(centre + first * along, centre + last * along)


def wrapped(angle: Floats) -> Floats:
    """The angle in [−π, π)."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _row(index: int, motion: Motion, start: int, stop: int, given: Line | None) -> Row:
    x, y = motion.tractor.x[start:stop], motion.tractor.y[start:stop]
    fitted = fit_line(x, y)
    line = fitted if given is None else serving_line(given, fitted, x, y)
    s, _ = line.project(x, y)
    point = COMPASS[round(line.heading / (np.pi / 4.0)) % len(COMPASS)]
    source: Literal["manifest", "fitted"] = "fitted" if line is fitted else "manifest"
    return Row(index, line, start, stop, point, source, float(s[-1] - s[0]))


def serving_line(given: Line, fitted: Line, x: Floats, y: Floats) -> Line:
    """The manifest's line in the direction of travel where it fits the row (within 5° and 2 m), else the
    fitted."""
    turn = float(wrapped(np.array(fitted.heading - given.heading)))
    line = given if abs(turn) <= np.pi / 2.0 else Line(given.b, given.a)
    angle = abs(float(wrapped(np.array(fitted.heading - line.heading))))
    _, n = line.project(x, y)
    return line if angle <= LINE_ANGLE and abs(float(np.mean(n))) <= LINE_OFFSET else fitted
