"""The path of a twin: rows joined by headland turns, the speed along it, and coloured noise for
everything that wanders."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .twin_plan import PathPlan

Floats = NDArray[np.float64]

PITCH = 0.1  # m between points of a path
OVERRUN = 30.0  # m of straight path after the last row, to look ahead at
SMOOTH = 0.6  # s over which the planned acceleration is smoothed
SETTLE = 12.0  # m after a turn before full speed is asked for


@dataclass(frozen=True)
class Path:
    """Intended line of travel. x, y, heading, curvature : (N,) every PITCH m; turning : (N,) whether in
    a headland turn; length : m, to the end of the last row."""

    x: Floats
    y: Floats
    heading: Floats
    curvature: Floats
    turning: NDArray[np.bool_]
    length: float


def make_path(plan: PathPlan, heading: float) -> Path:
    """Rows of equal length two turn radii apart, joined by half circles, turning left and right in turn.

    The path starts at the origin; its curvature is ramped over two metres at the ends of a turn, since
    no driver steps his wheel. heading : rad, ccw from East.
    """
    curvature = np.concatenate(_pieces(plan))
    turning = np.abs(curvature) > 0.0
    curvature = _ramped(curvature)
    yaw = heading + np.concatenate([[0.0], np.cumsum(0.5 * (curvature[1:] + curvature[:-1])) * PITCH])
    x, y = _integral(np.cos(yaw)), _integral(np.sin(yaw))
    return Path(x, y, yaw, curvature, turning, (curvature.size - 1) * PITCH - OVERRUN)


def _integral(slope: Floats) -> Floats:
    return np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1])) * PITCH])


def _pieces(plan: PathPlan) -> list[Floats]:
    row = np.zeros(round(plan.row_length / PITCH))
    arc = round(math.pi * plan.turn_radius / PITCH)
    pieces = [row]
    for k in range(1, plan.rows):
        # the exact half turn is kept whatever the arc's rounding to the pitch
        pieces += [np.full(arc, (-1.0) ** k * -math.pi / (arc * PITCH)), row]
    return [*pieces, np.zeros(round(OVERRUN / PITCH) + 1)]


def _ramped(curvature: Floats) -> Floats:
    window = np.full(21, 1.0 / 21.0)
    return np.convolve(np.pad(curvature, 10, mode="edge"), window, mode="valid")


def speed_limit(path: Path, plan: PathPlan) -> Floats:
    """Speed asked for at each point of the path, m/s: slower in turns, zero from the end of the last row
    on."""
    reach = round(SETTLE / PITCH)
    near_turn = np.convolve(path.turning.astype(float), np.ones(2 * reach + 1), mode="same") > 0.0
    limit = np.where(near_turn, min(plan.turn_speed, plan.speed), plan.speed)
    s = np.arange(limit.size) * PITCH
    limit = np.where(s >= path.length, 0.0, limit)
    for i in range(limit.size - 2, -1, -1):  # brake in time: v² = v_next² + 2·a·ds
        limit[i] = min(limit[i], math.sqrt(limit[i + 1] ** 2 + 2.0 * plan.acceleration * PITCH))
    return limit


def speed_profile(limit: Floats, plan: PathPlan, dt: float) -> Floats:
    """Planned speed over time, m/s, every dt: rest, bounded acceleration, the limit at the planned
    place, rest."""
    samples = _drive_ahead(limit, plan.rest, plan.rest_end, plan.acceleration, dt)
    speed = np.asarray(samples)
    if plan.duration is not None:
        count = round(plan.duration / dt) + 1
        speed = np.pad(speed, (0, max(0, count - speed.size)))[:count]
    window = np.hanning(round(SMOOTH / dt) + 2)
    return np.convolve(np.pad(speed, window.size // 2, mode="edge"), window / window.sum(), mode="same")[
        window.size // 2 : window.size // 2 + speed.size
    ]


@njit(cache=True)
def _drive_ahead(limit: Floats, rest: float, rest_end: float, acceleration: float, dt: float) -> list[float]:
    speed, s, end = 0.0, 0.0, (limit.size - 1) * PITCH
    out = [0.0] * round(rest / dt)
    while s < end:
        allowed = limit[int(s / PITCH)]
        speed = min(speed + acceleration * dt, allowed)
        if speed <= 1e-3:
            break
        s += speed * dt
        out.append(speed)
    for _ in range(round(rest_end / dt)):
        out.append(0.0)
    return out


def wander(n: int, step: float, correlation: float, rng: np.random.Generator) -> Floats:
    """Unit-variance Gauss-Markov series: x[k+1] = a·x[k] + sqrt(1−a²)·w, a = exp(−step/correlation)."""
    a = math.exp(-step / correlation)
    return _first_order(a, rng.standard_normal(n))


@njit(cache=True)
def _first_order(a: float, noise: Floats) -> Floats:
    out = np.empty_like(noise)
    gain = math.sqrt(1.0 - a * a)
    out[0] = noise[0]
    for k in range(1, noise.size):
        out[k] = a * out[k - 1] + gain * noise[k]
    return out


def smooth_wander(n: int, step: float, correlation: float, rng: np.random.Generator) -> Floats:
    """Unit-variance Gauss-Markov series of second order (two equal poles): once differentiable.

    A first-order lag of the same time constant filters the first-order series; the cascade's variance for
    equal discrete poles, (1 + a²)/(1 + a)², is undone.
    """
    a = math.exp(-step / correlation)
    once = wander(n + round(8.0 * correlation / step), step, correlation, rng)
    twice = np.empty_like(once)
    _lag(once, 1.0 - a, twice)
    variance = (1.0 + a * a) / (1.0 + a) ** 2
    return twice[-n:] / math.sqrt(variance)


@njit(cache=True)
def _lag(signal: Floats, gain: float, out: Floats) -> None:
    state = 0.0
    for k in range(signal.size):
        state += gain * (signal[k] - state)
        out[k] = state
