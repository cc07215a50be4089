"""First guesses that the filter starts from: speed, rest, heading by course, and the clocks' lag."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from .epochs import Epochs
from .prepare import STEP

Floats = NDArray[np.float64]

BASELINE = 4.0  # m of travel over which a course is taken
LONGEST = 15.0  # s for it: a machine that creeps at 0.3 m/s has its course then, and a gyro's bias has not spoilt it
ROUGH = 0.1  # m, of positions: differences over 1 s then err by what a machine creeps
LAGS = np.arange(-5, 4) * 0.05  # s: latencies of 20 to 350 ms where 100 ms was assumed


def ground_speed(t: Floats, e: Epochs) -> Floats:
    """Speed over ground on the grid (N,), m/s, by differences of positions over 1 s; NaN beyond 1 s from any."""
    if e.t.size < 4:
        return np.full(t.size, np.nan)
    uniform = np.arange(e.t[0], e.t[-1], 0.1)
    x, y = np.interp(uniform, e.t, e.x), np.interp(uniform, e.t, e.y)
    window = min(11, (uniform.size - 1) // 2 * 2 + 1)
    if window < 5:
        return np.full(t.size, np.nan)
    vx = savgol_filter(x, window, 1, deriv=1, delta=0.1)
    vy = savgol_filter(y, window, 1, deriv=1, delta=0.1)
    speed = np.interp(t, uniform, np.hypot(vx, vy))
    nearest = np.clip(np.searchsorted(e.t, t), 1, e.t.size - 1)
    away = np.minimum(np.abs(t - e.t[nearest - 1]), np.abs(t - e.t[nearest]))
    speed[away > 1.0] = np.nan
    return np.asarray(speed)


def resting_speed(t: Floats, e: Epochs, speed: Floats) -> Floats:
    """Speed (N,), m/s, that tells rest: `speed` of differenced positions, but where these are ROUGH, and at rest wander
    by more than a creeping machine, the receiver's own over 1 s (Doppler); NaN where it states none."""
    rough = (np.interp(t, e.t, e.sd) > ROUGH) & np.isfinite(speed)
    if not rough.any():
        return speed
    known = np.isfinite(e.speed) if e.speed is not None else np.zeros(e.t.size, dtype=bool)
    if e.speed is None or known.sum() < 4:
        return np.where(rough, np.nan, speed)
    size = max(round(1.0 / max(float(np.median(np.diff(e.t[known]))), 1e-3)), 1)
    mean = np.convolve(
        np.pad(e.speed[known], (size // 2, size - 1 - size // 2), mode="edge"), np.ones(size) / size, "valid"
    )
    return np.where(rough, np.interp(t, e.t[known], mean), speed)


def heading_offset(t: Floats, turned: Floats, e: Epochs, forwards: Floats) -> float:
    """Yaw at the first node, rad: the circular mean of course over ground less the turn since then.

    turned : (N,) rad, integral of the yaw rate from the first node
    forwards : (N,) +1 or -1, direction of travel
    """
    good = e.fixed if e.fixed.sum() > 20 else np.ones(e.t.size, dtype=bool)
    et, ex, ey = e.t[good], e.x[good], e.y[good]
    if et.size < 3:
        return 0.0
    travelled = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(ex), np.diff(ey)))])
    sums = 0.0 + 0.0j
    reach = max(BASELINE, 4.0 * float(np.median(e.sd[good])))
    least = 0.5 * min(reach, max(travelled[-1] / 4.0, 0.5))
    for i in range(0, et.size, 5):
        first, last = np.searchsorted(et, (et[i] + 2.0, et[i] + LONGEST))
        far = np.flatnonzero(np.hypot(ex[first:last] - ex[i], ey[first:last] - ey[i]) >= least)
        if far.size == 0:
            continue
        j = int(first + far[0])
        dx, dy = ex[j] - ex[i], ey[j] - ey[i]
        distance = math.hypot(dx, dy)
        middle = 0.5 * (et[i] + et[j])
        k = min(max(round((middle - t[0]) / STEP), 0), t.size - 1)
        course = math.atan2(dy, dx) + (0.0 if forwards[k] > 0 else math.pi)
        sums += distance * np.exp(1j * (course - turned[k]))
    return float(np.angle(sums)) if abs(sums) > 0.0 else 0.0


def first_position(epochs: Sequence[Epochs], t0: float) -> tuple[float, float]:
    """Median position of the main receiver over its first second after t0 (fixed epochs preferred)."""
    e = next(item for item in epochs if item.first)
    use = np.flatnonzero(e.t >= t0 - 0.2)
    use = use if use.size else np.arange(e.t.size)
    use = use[e.t[use] <= e.t[use[0]] + 1.0]
    fixed = use[e.fixed[use]]
    chosen = fixed if fixed.size else use
    return float(np.median(e.x[chosen])), float(np.median(e.y[chosen]))
