"""The common grid of a row: measured and simulated deviation and yaw at equal chainages, gaps masked in
both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.simulate import BatchRun
from .bounds import DEVIATION1, DEVIATION2, YAW1, YAW2
from .fusion.motion import Motion
from .replay import Window
from .rows import Row

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

NAMES = {1: (DEVIATION1, YAW1), 2: (DEVIATION2, YAW2)}
DRAW_COLUMNS = {1: slice(0, 3), 2: slice(3, 6)}  # of Motion.draws: x, y, yaw of each body


@dataclass(frozen=True)
class BodyGrid:
    """One body's measured motion on its grid of chainages; all (N,).

    s : m, multiples of the grid's step; t : s, UTC, when the CoM was there; deviation : m, left of the line
    yaw : rad, relative to the line; valid : outside GNSS gaps; yaw_reference : rad, what was taken off
    the yaw
    """

    body: int
    s: Floats
    t: Floats
    deviation: Floats
    yaw: Floats
    valid: Mask
    yaw_reference: float

    @property
    def channels(self) -> tuple[tuple[str, Floats], ...]:
        """The two responses by name, with their measured values."""
        deviation, yaw = NAMES[self.body]
        return ((deviation, self.deviation), (yaw, self.yaw))


@dataclass(frozen=True)
class RowGrid:
    """One row's grids, of the bodies that are compared."""

    row: Row
    step: float
    bodies: tuple[BodyGrid, ...]

    @property
    def coverage(self) -> float:
        """Share of the grid's points outside GNSS gaps."""
        return float(np.mean(np.concatenate([b.valid for b in self.bodies])))

    @property
    def responses(self) -> tuple[str, ...]:
        """Names of the responses, body by body."""
        return tuple(name for body in self.bodies for name, _ in body.channels)


def longest_gap(rates: Sequence[float], limit: float) -> float:
    """What counts as a GNSS gap, s: `limit`, or one and a half epochs of a receiver slower than that."""
    return max(limit, 1.5 / max(rates)) if rates else limit


def outside_gaps(t: Floats, gnss_t: Floats, gap: float) -> Mask:
    """Whether each instant lies between two accepted GNSS positions that are at most `gap` s apart."""
    if gnss_t.size < 2:
        return np.zeros(t.shape, dtype=bool)
    after = np.searchsorted(gnss_t, t, side="left")
    inside = (after > 0) & (after < gnss_t.size)
    place = np.clip(after, 1, gnss_t.size - 1)
    short = gnss_t[place] - gnss_t[place - 1] <= gap
    near_end = np.minimum(np.abs(t - gnss_t[0]), np.abs(t - gnss_t[-1])) <= gap
    return np.asarray((inside & short) | (~inside & near_end))


def body_grid(motion: Motion, row: Row, body: int, step: float, gap: float) -> BodyGrid:
    """One body's measured deviation and yaw at every multiple of `step` of its own chainage over the row."""
    moving = motion.bodies[body - 1]
    part = row.samples
    s, n = row.line.project(moving.x[part], moving.y[part])
    s = np.maximum.accumulate(s)
    points = step * np.arange(np.ceil(s[0] / step), np.floor(s[-1] / step) + 1.0)
    t = np.interp(points, s, motion.t[part])
    reference = turns_near(float(np.median(moving.yaw[part])), row.line.heading)
    return BodyGrid(
        body=body,
        s=points,
        t=t,
        deviation=np.interp(points, s, n),
        yaw=np.interp(points, s, moving.yaw[part]) - reference,
        valid=outside_gaps(t, motion.gnss_t, gap),
        yaw_reference=reference,
    )


def turns_near(yaw: float, heading: float) -> float:
    """The heading plus whole turns that lies nearest to an unwrapped yaw, rad."""
    return heading + 2.0 * np.pi * round((yaw - heading) / (2.0 * np.pi))


def row_grid(motion: Motion, row: Row, bodies: Sequence[int], step: float, gap: float) -> RowGrid:
    """The row's grids for the bodies that are compared."""
    return RowGrid(row, step, tuple(body_grid(motion, row, b, step, gap) for b in bodies))


@dataclass(frozen=True)
class Part:
    """A window's share of one body's grid: points first to last (excluded)."""

    grid: BodyGrid
    first: int
    last: int

    @property
    def s(self) -> Floats:
        """Chainages of the points, m."""
        return self.grid.s[self.first : self.last]

    @property
    def t(self) -> Floats:
        """Times at the points, s, UTC."""
        return self.grid.t[self.first : self.last]

    @property
    def valid(self) -> Mask:
        """Which points lie outside GNSS gaps."""
        return self.grid.valid[self.first : self.last]


def parts_of(grid: RowGrid, window: Window, motion: Motion) -> tuple[Part, ...]:
    """Each body's points that it passes during a window."""
    begin = motion.t[window.start]
    end = motion.t[window.stop] if window.stop < min(grid.row.stop, motion.t.size) else np.inf
    found = []
    for body in grid.bodies:
        first, last = np.searchsorted(body.t, [begin, end])
        found.append(Part(body, int(first), int(last)))
    return tuple(found)


def stacked_measured(parts: Sequence[Part]) -> Floats:
    """(N,) measured deviation and yaw of each body in turn, over a window's points."""
    return np.concatenate([values[p.first : p.last] for p in parts for _, values in p.grid.channels])


def stacked_valid(parts: Sequence[Part]) -> Mask:
    """(N,) the mask that belongs to `stacked_measured`."""
    return np.concatenate([p.valid for p in parts for _ in p.grid.channels])


def stacked_simulated(parts: Sequence[Part], row: Row, run: BatchRun, index: int) -> Floats:
    """(N,) the same of one run of a batch, read at the points' chainages.

    A run that diverged keeps its last finite place: its error stays and grows, it is not masked.
    """
    columns = []
    for part in parts:
        x, y, yaw = body_track(run, part.grid.body, index)
        s, n = row.line.project(x, y)
        s = np.maximum.accumulate(s)
        columns += [np.interp(part.s, s, n), np.interp(part.s, s, yaw) - part.grid.yaw_reference]
    return np.concatenate(columns)


def body_track(run: BatchRun, body: int, index: int) -> tuple[Floats, Floats, Floats]:
    """x, y, yaw of one body in one run, held at the last finite sample."""
    arrays = (run.x1, run.y1, run.yaw1) if body == 1 else (run.x2, run.y2, run.yaw2)
    track = [np.asarray(a)[index] for a in arrays]
    good = int(np.isfinite(track[0]).sum())
    if good == track[0].size:
        return track[0], track[1], track[2]
    held = [np.concatenate((a[:good], np.full(a.size - good, a[max(good - 1, 0)]))) for a in track]
    return held[0], held[1], held[2]


def stacked_draws(parts: Sequence[Part], row: Row, motion: Motion) -> Floats:
    """(N, K) posterior draws of the error of `stacked_measured`, at the points' times.

    The error along the track is left out: at a fixed chainage it acts through the track's slope, under 0.1.
    """
    columns = []
    for part in parts:
        draws = draws_at(motion, part.t)[:, :, DRAW_COLUMNS[part.grid.body]]
        columns += [across_line(draws, row.line.heading).T, draws[:, :, 2].T]
    return np.concatenate(columns)


def across_line(draws: Floats, heading: float) -> Floats:
    """The component to the line's left of errors (..., (x, y, ...))."""
    return np.asarray(np.cos(heading) * draws[..., 1] - np.sin(heading) * draws[..., 0])


def draws_at(motion: Motion, t: Floats) -> Floats:
    """(K, len(t), 6) the posterior draws, linear between their own times."""
    last = motion.draw_t.size - 1
    if last < 1:
        return np.zeros((0, t.size, 6))
    place = np.clip(np.searchsorted(motion.draw_t, t) - 1, 0, last - 1)
    share = (t - motion.draw_t[place]) / (motion.draw_t[place + 1] - motion.draw_t[place])
    share = np.clip(share, 0.0, 1.0)[np.newaxis, :, np.newaxis]
    return np.asarray(motion.draws[:, place] * (1.0 - share) + motion.draws[:, place + 1] * share)


def slices(parts: Sequence[Part]) -> Iterator[tuple[str, slice]]:
    """Where each response lies in a stacked array, by name."""
    start = 0
    for part in parts:
        for name, _ in part.grid.channels:
            size = part.last - part.first
            yield name, slice(start, start + size)
            start += size
