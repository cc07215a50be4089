"""The logger's clock against UTC from the motion: a body's turning against its course over ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

NEAR_UTC = 120.0  # s: so far a clock that is "near UTC" may be off
SPAN = 1.0  # s, over which changes of course are compared
SLOWEST = 0.7  # m/s: below this a course over ground is noise
STEP = 0.05  # s, of the grid of the yaw rate
SMOOTHED = 0.15  # s
COARSE = 0.1  # s, between tried offsets
LEAST_SPANS = 20  # independent changes of course
LEAST_SHARE = 0.5  # of the course's variance must be explained
RIVAL = 2.0  # s: an offset further away is another answer
LEAST_ODDS = 6.0  # by which the best offset's log likelihood must exceed any other answer's
WORST_SD = 0.05  # s
MOST_COARSE = 4000  # epochs, in the first search


class AlignmentError(ValueError):
    """The motion does not tell the clocks' offset; the text says why."""


@dataclass(frozen=True)
class Offset:
    """host - UTC (s), its standard deviation (s), and the share of the course's variance that it explains."""

    value: float
    sd: float
    explained: float


@dataclass(frozen=True)
class _Track:
    """Changes of course over SPAN, (M,) rad, from `start` (M,) s, UTC; speed (M,) m/s at both ends."""

    start: Floats
    change: Floats
    speed_from: Floats
    speed_to: Floats


@dataclass(frozen=True)
class _Turning:
    """On a regular grid of the logger's time: yaw (rad), and the antenna's speed to the body's left (m/s)."""

    grid: Floats
    yaw: Floats
    leftward: Floats


def motion_offset(
    host: Floats,
    angular_velocity: Floats,
    utc: Floats,
    course: Floats,
    speed: Floats,
    lever: tuple[float, float],
) -> Offset:
    """The offset host - UTC at which the body's turning best explains the antenna's course over ground.

    A point `ahead` of an axle that rolls without slip, and `above` the axis of roll, moves sideways at
    ahead·ω_z - above·ω_x, so course = yaw + (ahead·ω_z - above·ω_x)/speed + constant. Changes of it over SPAN
    are compared, which needs neither yaw nor the gyros' biases.

    Parameters
    ----------
    host, angular_velocity : (N,) s by the logger's clock, (N, 3) rad/s, along the body's axes
    utc, course, speed : (M,) s, rad (NaN where absent), m/s
    lever : (ahead, above) of the antenna, m

    Raises
    ------
    AlignmentError : too little turning, too little in common, or more than one answer.
    """
    track = _changes(utc, course, speed)
    independent = min(track.change.size, round(np.ptp(track.start) / SPAN) if track.start.size else 0)
    if independent < LEAST_SPANS:
        raise AlignmentError("too little motion with a known course")
    turning = _turning(host, angular_velocity, lever)
    lags = _candidates(host, utc)
    few = _thin(track, MOST_COARSE)
    costs = np.array([_cost(lag, few, turning) for lag in lags])
    best = int(np.argmin(costs))
    _only_answer(lags, costs, best, independent)
    value = _refined(float(lags[best]), track, turning)
    cost = _cost(value, track, turning)
    explained = 1.0 - cost / float(track.change.var())
    if not explained > LEAST_SHARE:
        raise AlignmentError(
            f"turning explains only {100.0 * max(explained, 0.0):.0f} % of the changes of course"
        )
    sd = _deviation(value, cost, track, turning, independent)
    if not sd < WORST_SD:
        raise AlignmentError(f"the offset is known to {sd:.2f} s only")
    return Offset(value, sd, explained)


def _turning(host: Floats, angular_velocity: Floats, lever: tuple[float, float]) -> _Turning:
    grid = np.arange(host[0], host[-1], STEP)
    width = max(round(SMOOTHED / STEP), 1)
    roll_rate, yaw_rate = (_smooth(np.interp(grid, host, angular_velocity[:, k]), width) for k in (0, 2))
    yaw = np.concatenate([[0.0], np.cumsum(0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * STEP)])
    return _Turning(grid, yaw, lever[0] * yaw_rate - lever[1] * roll_rate)


def _changes(utc: Floats, course: Floats, speed: Floats) -> _Track:
    """Pairs of epochs SPAN apart, both moving and with a course."""
    known = np.isfinite(course) & (speed > SLOWEST)
    utc, course, speed = utc[known], course[known], speed[known]
    later = np.searchsorted(utc, utc + SPAN - 1.0e-3)
    first = np.flatnonzero(later < utc.size)
    later = later[first]
    close = np.abs(utc[later] - utc[first] - SPAN) < 1.0e-2
    first, later = first[close], later[close]
    change = (course[later] - course[first] + np.pi) % (2.0 * np.pi) - np.pi
    return _Track(utc[first], change, speed[first], speed[later])


def _thin(track: _Track, most: int) -> _Track:
    every = slice(None, None, -(-track.start.size // most))
    return _Track(track.start[every], track.change[every], track.speed_from[every], track.speed_to[every])


def _smooth(values: Floats, width: int) -> Floats:
    return np.convolve(values, np.full(width, 1.0 / width), mode="same")


def _candidates(host: Floats, utc: Floats) -> Floats:
    """Offsets to try: near zero for a clock near UTC, else all at which both recordings overlap."""
    between = 0.5 * (host[0] + host[-1]) - 0.5 * (utc[0] + utc[-1])
    reach = 0.5 * (np.ptp(host) + np.ptp(utc))
    if abs(between) < reach + NEAR_UTC:
        return np.arange(-NEAR_UTC, NEAR_UTC, COARSE)
    return np.asarray(np.arange(between - reach, between + reach, COARSE))


def _predicted(lag: float, track: _Track, turning: _Turning) -> tuple[Floats, Bools]:
    """Changes of course that the body's turning makes expect, and where it was recorded."""
    start, stop = track.start + lag, track.start + lag + SPAN
    inside = (start >= turning.grid[0]) & (stop <= turning.grid[-1])
    ends = ((stop, track.speed_to), (start, track.speed_from))
    after, before = (
        np.interp(at, turning.grid, turning.yaw) + np.interp(at, turning.grid, turning.leftward) / speed
        for at, speed in ends
    )
    return after - before, inside


def _cost(lag: float, track: _Track, turning: _Turning) -> float:
    """Variance of what the turning leaves unexplained; all of it where too little was recorded."""
    predicted, inside = _predicted(lag, track, turning)
    whole = float(track.change.var())
    if inside.mean() < 0.5:
        return whole
    left = (track.change - predicted)[inside]
    return float(left.var()) * whole / max(float(track.change[inside].var()), 1.0e-12)


def _only_answer(lags: Floats, costs: Floats, best: int, independent: int) -> None:
    rivals = costs[np.abs(lags - lags[best]) > RIVAL]
    odds = 0.5 * independent * np.log(rivals.min() / max(costs[best], 1.0e-12)) if rivals.size else np.inf
    if not odds > LEAST_ODDS:
        raise AlignmentError("turning and course agree at more than one offset, or at none")


def _refined(lag: float, track: _Track, turning: _Turning) -> float:
    """The least cost near a coarse offset: a parabola through three costs, three times closer each."""
    step = COARSE
    for _ in range(6):
        low, mid, high = (_cost(lag + k * step, track, turning) for k in (-1, 0, 1))
        bend = low - 2.0 * mid + high
        move = 0.5 * (low - high) / bend * step if bend > 0.0 else 0.0
        lag += float(np.clip(move, -step, step))
        step /= 3.0
    return lag


def _deviation(lag: float, cost: float, track: _Track, turning: _Turning, independent: int) -> float:
    """Standard deviation of the offset: unexplained noise over the prediction's change with the offset."""
    earlier, _ = _predicted(lag - STEP, track, turning)
    later, _ = _predicted(lag + STEP, track, turning)
    steep = float(((later - earlier) / (2.0 * STEP)).var())
    return float(np.sqrt(cost / (independent * max(steep, 1.0e-12))))
