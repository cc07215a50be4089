"""The line below a one-sided scatter: two clocks related by stamps that are late, never early."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

DEVICE_DRIFT_SD = 2.0e-4  # rates of IMU crystals against the host
CORRELATED_LATENCIES = 10.0  # so many neighbouring latencies tell as much as one independent one
MAX_HULL_INPUT = 4096
STRAY_SHARE = 0.05  # at most, of the points
MIN_POINTS = 40
COMPANY = 3.0
LEAST_GAP = 1.0e-4  # s


@dataclass(frozen=True)
class ClockLine:
    """y = level + slope·(x - origin): a line below all points of a one-sided scatter.

    spread is the mean height of the points above it (s).
    """

    origin: float
    level: float
    slope: float
    spread: float

    def __call__(self, x: Floats) -> Floats:
        return self.level + self.slope * (x - self.origin)


def lower_hull(x: Floats, y: Floats) -> Ints:
    """Indices of the lower convex hull's vertices, left to right; x increasing (Andrew's monotone chain)."""
    hull: list[int] = []
    xs, ys = x.tolist(), y.tolist()
    for i in range(len(xs)):
        while len(hull) >= 2:
            a, b = hull[-2], hull[-1]
            if (xs[b] - xs[a]) * (ys[i] - ys[a]) - (ys[b] - ys[a]) * (xs[i] - xs[a]) > 0.0:
                break
            hull.pop()
        hull.append(i)
    return np.array(hull, dtype=np.int64)


def _thinned(x: Floats, y: Floats) -> tuple[Floats, Floats]:
    """At most MAX_HULL_INPUT points that can touch a line from above: the lowest of each block of x."""
    order = np.argsort(x, kind="stable")
    x, y = x[order], y[order]
    if x.size <= MAX_HULL_INPUT:
        return x, y
    starts = np.linspace(0, x.size, MAX_HULL_INPUT // 2, endpoint=False).astype(np.int64)
    trend = _coarse_slope(x, y, starts)
    height = y - trend * x
    lowest = np.minimum.reduceat(height, starts)
    block = np.repeat(np.arange(starts.size), np.diff(np.append(starts, x.size)))
    first = np.flatnonzero(height == lowest[block])
    return x[first], y[first]


def _coarse_slope(x: Floats, y: Floats, starts: Ints) -> float:
    """Slope between the lowest points of the first and the last quarter of the blocks' minima."""
    low, at = np.minimum.reduceat(y, starts), x[starts]
    slope = np.polyfit(at - at.mean(), low, 1)[0] if at[-1] > at[0] else 0.0
    return float(slope)


def early(x: Floats, y: Floats) -> Bools:
    """Points far below all others: a broken digit made a stamp early, which no latency does; (N,).

    Sorted by height, the lowest of many sound points stand close together. A gap that is wider than COMPANY times
    the room that the ten points above it take parts strays from them.
    """
    most = max(10, round(STRAY_SHARE * x.size))
    if x.size < MIN_POINTS:
        return np.zeros(x.size, dtype=np.bool_)
    order = np.argsort(x, kind="stable")
    blocks = np.array_split(order, 20)
    middle_x = np.array([np.median(x[block]) for block in blocks])
    middle_y = np.array([np.median(y[block]) for block in blocks])
    height = y - _steady_slope(middle_x, middle_y) * (x - middle_x[0])
    low = np.sort(np.partition(height, most + 11)[: most + 12])
    gaps = np.diff(low)[:most]
    room = low[11 : most + 11] - low[1 : most + 1]
    parting = np.flatnonzero((gaps > COMPANY * room) & (gaps > LEAST_GAP))
    if parting.size == 0:
        return np.zeros(x.size, dtype=np.bool_)
    return np.asarray(height <= low[parting[-1]])


def _steady_slope(x: Floats, y: Floats) -> float:
    """Median of the slopes between all pairs of points (Theil and Sen); 0 where all x are one."""
    first, second = np.triu_indices(x.size, 1)
    apart = x[second] - x[first]
    slopes = (y[second] - y[first])[apart > 0.0] / apart[apart > 0.0]
    return float(np.median(slopes)) if slopes.size else 0.0


def one_sided_line(x: Floats, y: Floats, slope: float = 0.0, slope_sd: float = DEVICE_DRIFT_SD) -> ClockLine:
    """The most probable line below points whose height above it is a never-negative latency.

    With exponential latencies of mean m the likelihood of a line under all points is exp(-Σ height / m), and
    for a given slope b the level is min(y - b·x); a normal prior on the slope keeps short scatters sane:
    minimise -N·min(y - b·(x - x̄))/m + (b - slope)²/(2·slope_sd²), convex in b. Only the lower hull matters.

    Parameters
    ----------
    x, y : (N,) s, N ≥ 1; y measured on the clock whose stamps are late. Strays far below (`early`) are left out
    slope, slope_sd : prior of the slope, 1
    """
    sound = ~early(x, y)
    x, y = x[sound], y[sound]
    centre = float(x.mean())
    px, py = _thinned(x - centre, y)
    vertices = lower_hull(px, py)
    hx, hy = px[vertices], py[vertices]
    mean = float(y.mean())
    spread = max(mean - float((hy - slope * hx).min()), 1.0e-6)
    for _ in range(3):
        weight = x.size / CORRELATED_LATENCIES / spread
        best = _most_probable_slope(hx, hy, weight, slope, slope_sd)
        level = float((hy - best * hx).min())
        spread = max(mean - level, 1.0e-6)
    return ClockLine(centre, level, best, spread)


def _most_probable_slope(hx: Floats, hy: Floats, weight: float, slope: float, slope_sd: float) -> float:
    """Golden-section search of the convex cost over ± 10 prior standard deviations."""
    ratio = (5.0**0.5 - 1.0) / 2.0

    def cost(b: float) -> float:
        return -weight * float((hy - b * hx).min()) + 0.5 * ((b - slope) / slope_sd) ** 2

    low, high = slope - 10.0 * slope_sd, slope + 10.0 * slope_sd
    a, b = high - ratio * (high - low), low + ratio * (high - low)
    cost_a, cost_b = cost(a), cost(b)
    while high - low > 1.0e-10:
        if cost_a < cost_b:
            high, b, cost_b = b, a, cost_a
            a = high - ratio * (high - low)
            cost_a = cost(a)
        else:
            low, a, cost_a = a, b, cost_b
            b = low + ratio * (high - low)
            cost_b = cost(b)
    return 0.5 * (low + high)
