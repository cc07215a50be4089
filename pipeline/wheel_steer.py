"""Steering angle from the front wheels' yaw rates less the body's, and from a steering sensor.

Increments over the grid: Δδ = mean of the front wheels' Δ(turned) − Δ(body's). The body's turning is the
weighted mean of its gyro's and of the rear wheels' units, which share its yaw rate and carry no bias of their
own over whole revolutions: the gyro's bias and scale error against them are estimated and taken off. The
error of the sum is a random walk (integrated gyro noise) from an unknown start. No position, yaw or
kinematics of the body enters.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..sensors.manifest import Tractor
from .fusion.motion import SteerInput
from .wheel_series import Floats, Walk, fit_walk, robust_sd, signal, slow_noise, smooth, solve
from .wheel_unit import Bools, bridged, integrate, per_second, trusted

LONGEST = 60.0  # s, correlation time of the stationary process that stands for the walk in `SteerInput`
HORIZON = 10.0  # s, lag at which a doubt of the bias counts as the walk that does the same
MEAN_SD = np.radians(
    0.5
)  # a long straight drive's own mean steering angle (slope, soil, a crabbing implement)
GYRO_BIAS_SD = 0.02  # rad/s, of the body's gyro before anything is known
GYRO_SCALE_SD = 0.014  # two gyros' scales against each other
SCALE_SD = 0.01
SINGLE_SCALE_SD = 0.03  # with one front wheel: how far the linkage departs from Ackermann's
APART, APART_RATE = 0.1, 1.0e-3  # how far the wheels turn apart: share of the turn, and rad/s
UNSEEN = 0.05  # rad²/s, walk of the steering angle where no wheel is seen
STOPS = 0.6  # rad, of the steering: before anything is known
DRIFT_ITERATIONS = 3
TURNING = (
    3.0  # robust standard deviations of the steering angle beyond which its mean is not expected to be zero
)


@dataclass(frozen=True)
class TurnedWheel:
    """What is needed of a wheel: its name, times (N,), integrated yaw rate, that integral's variance,
    standing still.
    """

    wheel: str
    t: Floats
    turned: Floats
    variance: Floats
    rest: Bools


@dataclass(frozen=True)
class WheelSteer:
    """Steering angle from the front wheels on a grid t (N,) [s, UTC].

    angle, sd : rad, mean of the front wheels' angles less its slow mean, and the standard deviation of its
    error
        without the constant zero error; its walk is replaced by a stationary process of `correlation_time`
        [s]
    rate, rate_sd : rad/s, mean of the steering rate over the step that ends at each grid point; white
    walk : rad/√s, of the angle's error; wheel_rate, wheel_rate_sd : rad/s, mean yaw rate of the front
    wheels over the
        same steps, free of the body's gyro
    zero_sd, scale_sd : of a constant offset [rad] and a scale error
    calibration : the body gyro's bias and scale error with standard deviations
    """

    t: Floats
    angle: Floats
    sd: Floats
    correlation_time: float
    rate: Floats
    rate_sd: Floats
    walk: float
    wheel_rate: Floats
    wheel_rate_sd: Floats
    zero_sd: float
    scale_sd: float
    calibration: dict[str, tuple[float, float]]

    def as_input(self) -> SteerInput:
        """The series that may drive the replay."""
        return SteerInput(self.angle, self.sd, self.correlation_time, self.zero_sd, self.scale_sd, "wheels")


@dataclass(frozen=True)
class _Increments:
    """Angle turned over each grid step (N-1,) and its variance."""

    value: Floats
    variance: Floats


def steering_angle(
    wheels: Sequence[TurnedWheel],
    body_t: Floats,
    body_yaw_rate: Floats,
    grid_t: Floats,
    tractor: Tractor | None,
) -> WheelSteer | None:
    """See `wheels.steer_from_wheels`."""
    front = [w for w in wheels if w.wheel.startswith("front")]
    if not front or grid_t.size < 2:
        return None
    rear = [_increments(w.t, w.turned, w.variance, grid_t) for w in wheels if not w.wheel.startswith("front")]
    body, calibration = _body(wheels, body_t, body_yaw_rate, grid_t, rear)
    ahead = _mean([_increments(w.t, w.turned, w.variance, grid_t) for w in front], np.diff(grid_t))
    doubt = calibration["body_gyro_bias"][1] ** 2 * HORIZON * np.diff(grid_t) if not rear else 0.0
    variance = ahead.variance + body.variance + doubt
    raw = np.append(0.0, np.cumsum(ahead.value - body.value))
    turned = np.append(0.0, np.cumsum(body.value))
    drift, drift_variance = _slow_mean(grid_t, raw, turned, variance, _standing(front, grid_t))
    angle = raw - drift
    single = len({w.wheel for w in front}) == 1
    if single and tractor is not None:
        angle = mean_angle(angle, tractor, front[0].wheel)
    dt = np.diff(grid_t)
    walk = float(np.median(variance / dt))
    correlation_time = min(LONGEST, float(grid_t[-1] - grid_t[0]) / 3.0)
    excess = _beyond_walk(np.append(0.0, np.cumsum(np.maximum(variance - walk * dt, 0.0))), drift_variance)
    return WheelSteer(
        t=grid_t,
        angle=angle,
        sd=np.sqrt(0.5 * walk * correlation_time + excess),
        correlation_time=correlation_time,
        rate=_first_too((ahead.value - body.value) / dt),
        rate_sd=_first_too(np.sqrt(variance) / dt),
        walk=float(np.sqrt(walk)),
        wheel_rate=_first_too(ahead.value / dt),
        wheel_rate_sd=_first_too(np.sqrt(ahead.variance) / dt),
        zero_sd=float(np.sqrt(np.median(drift_variance) + MEAN_SD**2)),
        scale_sd=SINGLE_SCALE_SD if single else SCALE_SD,
        calibration=calibration,
    )


def _beyond_walk(grown: Floats, doubt: Floats) -> Floats:
    """Variance that steps worse than the usual walk add between each instant and the middle of the pass.

    grown : (N,) rad², sum of what those steps add; doubt : (N,) rad², of the slow mean that takes it off
    again
    """
    between = np.minimum(np.abs(grown - np.median(grown)), 2.0 * doubt)
    return np.asarray(np.maximum(between, doubt - np.median(doubt)))


def _first_too(steps: Floats) -> Floats:
    return np.append(steps[0], steps)


def _increments(t: Floats, turned: Floats, variance: Floats, grid_t: Floats) -> _Increments:
    """A series' increments over the grid; steps outside its time are unknown."""
    unseen = (grid_t[1:] > t[-1]) | (grid_t[:-1] < t[0])
    grown = np.diff(np.interp(grid_t, t, variance)) + np.where(unseen, UNSEEN * np.diff(grid_t), 0.0)
    return _Increments(np.diff(np.interp(grid_t, t, turned)), np.maximum(grown, 1.0e-16))


def _mean(parts: Sequence[_Increments], dt: Floats) -> _Increments:
    """Plain mean, since the steering angle is the mean of both wheels' angles; where one wheel is known far
    worse, the other's alone, with the doubt that they turn by different angles in a curve.
    """
    value, variance = (np.array([getattr(p, name) for p in parts]) for name in ("value", "variance"))
    best = np.argmin(variance, axis=0)[None]
    alone = np.take_along_axis(value, best, 0)[0]
    alone_variance = np.take_along_axis(variance, best, 0)[0] + (APART * alone) ** 2 + (APART_RATE * dt) ** 2
    plain = variance.mean(axis=0) / len(parts)
    worse = plain > alone_variance
    return _Increments(np.where(worse, alone, value.mean(axis=0)), np.where(worse, alone_variance, plain))


def _body(
    wheels: Sequence[TurnedWheel], t: Floats, rate: Floats, grid_t: Floats, rear: Sequence[_Increments]
) -> tuple[_Increments, dict[str, tuple[float, float]]]:
    """The body's turning by its gyro and the rear wheels, and what the gyro's errors were found to be."""
    noise, walk = fit_walk(t, rate)
    seen = np.ones(t.size, dtype=bool)
    grown = np.append(0.0, np.cumsum(np.diff(t) * noise / per_second(t) + bridged(t, seen, walk)))
    gyro = _increments(t, integrate(t, rate), grown, grid_t)
    rest = _standing(wheels, t)
    value, covariance = _gyro_errors(gyro, grid_t, rear, rate[rest], noise)
    clean = gyro.value - value[0] * np.diff(grid_t) - value[1] * gyro.value
    sd = np.sqrt(np.diag(covariance))
    found = {
        "body_gyro_bias": (float(value[0]), float(sd[0])),
        "body_gyro_scale": (float(value[1]), float(sd[1])),
    }
    return _weighted([_Increments(clean, gyro.variance), *rear], grid_t), found


def _gyro_errors(
    gyro: _Increments, grid_t: Floats, rear: Sequence[_Increments], at_rest: Floats, noise: float
) -> tuple[Floats, Floats]:
    """Bias [rad/s] and scale error of the body's gyro: against the rear wheels, and at rest."""
    information = np.diag([GYRO_BIAS_SD**-2.0, GYRO_SCALE_SD**-2.0])
    vector = np.zeros(2)
    columns = np.column_stack([np.diff(grid_t), gyro.value])
    if rear:
        reference = _weighted(rear, grid_t)
        weight = 1.0 / (gyro.variance + reference.variance)
        information = information + columns.T @ (columns * weight[:, None])
        vector = vector + columns.T @ (weight * (gyro.value - reference.value))
    if at_rest.size > 10:
        weight_at_rest = at_rest.size / (1.57 * max(noise, robust_sd(at_rest) ** 2, 1.0e-10))
        information[0, 0] += weight_at_rest
        vector[0] += weight_at_rest * float(np.median(at_rest))
    covariance = np.linalg.inv(information)
    return covariance @ vector, covariance


def _weighted(parts: Sequence[_Increments], grid_t: Floats) -> _Increments:
    """Mean of several measurements of one angle, weighted by their variances; its variance widened when
    they disagree.
    """
    weights = np.array([1.0 / p.variance for p in parts])
    value = np.sum(weights * np.array([p.value for p in parts]), axis=0) / weights.sum(axis=0)
    return _Increments(value, _disagreement(parts, value, grid_t) / weights.sum(axis=0))


def _disagreement(parts: Sequence[_Increments], value: Floats, grid_t: Floats) -> float:
    """Reduced χ² of one-second sums about the weighted mean, robust, at least 1."""
    size = per_second(grid_t)
    count = value.size // size
    if len(parts) < 2 or count < 5:
        return 1.0
    ratios = []
    for part in parts:
        apart = (part.value - value)[: count * size].reshape(count, size).sum(axis=1)
        allowed = part.variance[: count * size].reshape(count, size).sum(axis=1)
        ratios.append(robust_sd(apart / np.sqrt(allowed)) ** 2)
    return max(1.0, float(np.sum(ratios)) / (len(parts) - 1))


def _standing(wheels: Sequence[TurnedWheel], t: Floats) -> Bools:
    """Where every given wheel stands."""
    still = [np.interp(t, w.t, w.rest.astype(np.float64), left=0.0, right=0.0) > 0.99 for w in wheels]
    return np.asarray(np.all(still, axis=0))


def _slow_mean(
    grid_t: Floats, raw: Floats, turned: Floats, variance: Floats, standing: Bools
) -> tuple[Floats, Floats]:
    """The error under the steering angle (a random walk, and the gyros' scales against each other times the
    angle `turned`), and its variance.

    Steering is taken as noise with the slow scatter it shows; parts where it is turned far are left out, and
    standstill.
    """
    size = int(5.0 * per_second(grid_t))
    seen = raw[~standing] if not standing.all() else raw
    error, doubt = np.full(raw.size, np.median(seen)), np.zeros(raw.size)
    columns = np.column_stack([raw - raw[0], turned - turned.mean()])
    for _ in range(DRIFT_ITERATIONS):
        swing = raw - error
        spread = max(robust_sd(swing[~standing]), float(MEAN_SD))
        straight = ~standing & (np.abs(swing) < TURNING * spread)
        slow = max(slow_noise(swing[straight], size), float(MEAN_SD) ** 2)
        walked = smooth(columns, Walk(variance, np.where(straight, slow, np.inf), STOPS**2), 2 * size)
        scale = solve([walked.products], np.array([GYRO_SCALE_SD]))
        error, doubt = signal(walked, scale, columns[:, 1:])
        error = error + raw[0]
    return error, doubt


def mean_angle(angle: Floats, tractor: Tractor, wheel: str) -> Floats:
    """Mean of both front wheels' angles when one wheel's is known and the linkage is Ackermann's.

    cot δ_left,right = cot δ ∓ track / (2·wheelbase); the mean of both angles is δ up to third order.
    """
    side = -1.0 if wheel.endswith("left") else 1.0
    ratio = 0.5 * tractor.front_track / (tractor.front_axle + tractor.rear_axle)
    return np.asarray(np.arctan(np.tan(angle) / (1.0 - side * ratio * np.tan(angle))))


def sensor_angle(t: Floats, angle: Floats, noise_sd: float, grid_t: Floats) -> tuple[Floats, Floats, float]:
    """A steering sensor's angle smoothed onto a grid: angle [rad], sd [rad], correlation time of its error
    [s].

    noise_sd : rad, stated for a sample; the series' own noise is used where it shows more

    A random walk's smoother with memory s weighs samples by exp(−|t|/s): it leaves noise/(4·rate·s) of the noise. Its
    own variance is twice that, for it expects the angle to walk at random; a steered wheel turns smoothly, so in place
    of the other half stands what the kernel rounds off.
    """
    good = trusted(angle, np.array([np.inf]))
    fitted, walk = fit_walk(t[good], angle[good])
    noise = max(fitted, noise_sd**2)
    walk = max(walk, 1.0e-12)
    model = Walk(walk * np.diff(t), np.where(good, noise, np.inf))
    seen = smooth((angle - angle[0])[:, None], model)
    smoothed = seen.columns[:, 0] + angle[0]
    memory = float(np.sqrt(noise / per_second(t) / walk))
    left = noise / (4.0 * per_second(t) * max(memory, 0.25 / per_second(t)))
    after = np.clip(np.searchsorted(t, grid_t), 1, t.size - 1)
    away = np.minimum(np.abs(t[after] - grid_t), np.abs(grid_t - t[after - 1]))
    lost = walk * np.maximum(away - 1.0 / per_second(t), 0.0)
    variance = left + _rounding(smoothed[good], 1.0 / per_second(t), memory, left) ** 2 + lost
    return np.interp(grid_t, t, smoothed), np.sqrt(variance), memory


def _rounding(angle: Floats, dt: float, memory: float, noise: float) -> float:
    """How much smoothing rounds off an angle, rad: a kernel exp(−|t|/memory) errs by memory² times the curvature.

    noise : rad², left in the angle: its share of the second differences (six times it) is none of the curvature's
    """
    size = max(round(0.1 / dt), 1)
    if angle.size <= 2 * size:
        return 0.0
    curvature = (angle[2 * size :] - 2.0 * angle[size:-size] + angle[: -2 * size]) / (size * dt) ** 2
    own = float(np.mean(curvature**2)) - 6.0 * noise / (size * dt) ** 4
    return memory**2 * math.sqrt(max(own, 0.0))
