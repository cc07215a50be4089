"""The best estimate of the steering angle: the wheels or the sensor fast, the body's own path slow.

Only `Motion.steer` may see this; the replay is driven by `steer_input`, which knows nothing of the body.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from ...sensors.manifest import GRAVITY
from . import settings as physics
from .motion import BodyMotion, SteerInput

Floats = NDArray[np.float64]

EVERY = 25  # nodes: 2 Hz is enough for what is slow
SLOWEST = 0.7  # m/s: no kinematic angle below
FRONT_SHARE = (
    2.0  # front over rear slip angle: front tyres are about half as stiff, and it is they that steer
)
LEAST_SLIP = 0.001  # rad: of any tyre on soil
FRONT_TIME = 1.0  # s, correlation of the front wheels' slip
UNDERSTEER = 0.01  # rad/(m/s²): front over rear compliance, each 0.018 known to a factor of 1.5
FRONT_DRAG = 0.03  # rad/rad: 10 kN of draft over 2 · 60 kN/rad, times the hitch's overhang over the wheelbase
INTEGRATED_SCALE = physics.GYRO_SCALE * math.sqrt(2.0)  # rad/rad turned: the wheels' gyros less the body's
WHITE = 0.0005  # rad, of a kinematic angle at one instant beside what the fusion states
DOUBT, TIME_DOUBT = 3.0, 2.0  # factors: one standard deviation of the lognormal priors of slip and its time
LEARNT_FROM, LEARNT_FROM_MOST = 30, 600  # samples at 2 Hz that the slip is learnt from


@dataclass(frozen=True)
class Steering:
    """Best steering angle (N,) rad and its standard deviation; slip : rad, of the front wheels on a straight row,
    and whether the innovations told it (else it is the prior)."""

    angle: Floats
    sd: Floats
    slip: float
    learnt: bool


@dataclass(frozen=True)
class Errors:
    """Model of z = given − path at 2 Hz as a sum of Gauss-Markov errors: (slow error, zero, scale, slip, slip of a
    turn, slip by the ground's slope, and by its deviation).

    decay, drive : (M, 7) of the step that ends at each sample; start : (7,) variances; white : variance;
    seen : (M, 7), by how much each is in z: the scale error of integrated gyros by the angle turned, a slope's slip by
    the slope
    """

    decay: Floats
    drive: Floats
    start: Floats
    white: float
    seen: Floats


@dataclass(frozen=True)
class Difference:
    """The given series less the path's angle at samples `dt` s apart, and how large each part of it may be.

    z : (M,) rad, NaN where the path has none; slow, lateral, turn : (M,) rad, standard deviations of the given
    series' slow error, of the slip that a lateral acceleration makes, and of a turn's; path : (M,) rad², of the path;
    memory : s, of the slow error; zero : rad; fast : rad, white error of the given series
    turned : (M,) rad, by how much the body has turned; scale : deviation of the given series' error by that, rad/rad
    slope : (M, 2) m/s², gravity's part along the ground to the right, and its deviation
    """

    dt: float
    z: Floats
    slow: Floats
    lateral: Floats
    turn: Floats
    path: Floats
    memory: float
    zero: float
    fast: float
    turned: Floats
    scale: float
    slope: Floats

    def errors(self, slip: float, time: float) -> Errors:
        """The model where the front wheels slip by `slip` rad on a straight row, correlated over `time` s."""
        none = np.zeros(self.z.size)
        fast = np.sqrt((slip + self.lateral) ** 2 + self.path)
        size = np.column_stack([self.slow, none, none, fast, self.turn, none, none])
        times = np.array([self.memory, np.inf, np.inf, time, FRONT_TIME, np.inf, np.inf])
        decay = np.tile(np.exp(-self.dt / times), (self.z.size, 1))
        decay[self.turn > 0.0, 4] = np.exp(-self.dt / physics.TAU_TURN)
        start = (
            size[0] ** 2 + np.square([0.0, self.zero, self.scale, 0.0, 0.0, UNDERSTEER, UNDERSTEER]) + 1e-14
        )
        seen = np.ones((self.z.size, 7))
        seen[:, 2], seen[:, 5:] = self.turned, self.slope
        return Errors(decay, size**2 * (1.0 - decay**2) + 1e-14, start, WHITE**2 + self.fast**2, seen)

    def cut(self, first: int, last: int) -> Difference:
        """Samples first to last alone."""
        part = slice(first, last)
        return replace(
            self, z=self.z[part], slow=self.slow[part], lateral=self.lateral[part], turn=self.turn[part],
            path=self.path[part], turned=self.turned[part], slope=self.slope[part],
        )  # fmt: skip


def kinematic_angle(body: BodyMotion, front_axle: float) -> Floats:
    """Heading of the front axle's velocity against the body, rad (N,): the steering angle of wheels without slip.

    atan((v_lateral + l2·yaw_rate)/v); NaN below SLOWEST.
    """
    across = body.v_lateral + front_axle * body.yaw_rate
    usable = np.abs(body.v) > SLOWEST
    return np.where(usable, np.arctan(across / np.where(usable, body.v, 1.0)), np.nan)


def path_variance(body: BodyMotion, front_axle: float) -> Floats:
    """Variance (N,), rad², of the kinematic angle by the body's stated covariance; the rear axle's slip is in it."""
    C = body.covariance
    across = C[:, 4, 4] + front_axle**2 * C[:, 5, 5] + 2.0 * front_axle * C[:, 4, 5]
    return np.asarray(np.maximum(across, 0.0) / np.maximum(np.abs(body.v), SLOWEST) ** 2)


def slip_variance(body: BodyMotion) -> Floats:
    """Variance (N,), rad², of the kinematic angle by the lateral velocity's alone."""
    return np.asarray(body.covariance[:, 4, 4] / np.maximum(np.abs(body.v), SLOWEST) ** 2)


def turn_slip(body: BodyMotion, bend: Floats) -> Floats:
    """Size (N,), rad, of the front wheels' slip that stays as long as a turn: by its acceleration and by a draft that
    pulls aside where the combination is bent by `bend` (N,) rad. It has one sign all along, so it does not average."""
    return physics.COMPLIANCE * _beyond(body.v * body.yaw_rate, physics.TURN_FROM) + FRONT_DRAG * _beyond(
        bend, physics.BEND_FROM
    )


def _beyond(value: Floats, least: float) -> Floats:
    """Sizes of values that count from `least` on, and wholly when they are far beyond."""
    size = np.maximum(np.abs(value), least)
    return size - least**2 / size


def filtered(z: Floats, e: Errors) -> tuple[Floats, Floats, Floats, Floats, float]:
    """Kalman filter of the errors through z (M,), NaN where there is none: means and covariances, filtered and
    predicted, and the innovations' log-likelihood."""
    n, size = z.size, e.start.size
    m, P = np.zeros((n, size)), np.zeros((n, size, size))
    mp, Pp = np.zeros((n, size)), np.zeros((n, size, size))
    x, C, total = np.zeros(size), np.diag(e.start), 0.0
    for k in range(n):
        if k > 0:
            x = e.decay[k] * x
            C = C * np.outer(e.decay[k], e.decay[k]) + np.diag(e.drive[k])
        mp[k], Pp[k] = x, C
        if not math.isnan(z[k]):
            g = C @ e.seen[k]
            s, left = g @ e.seen[k] + e.white, z[k] - x @ e.seen[k]
            total -= 0.5 * (math.log(s) + left * left / s)
            x = x + g * (left / s)
            C = C - np.outer(g, g) / s
        m[k], P[k] = x, C
    return m, P, mp, Pp, float(total)


def smooth_error(z: Floats, e: Errors) -> tuple[Floats, Floats]:
    """Rauch-Tung-Striebel smoother of z = slow error + zero + scale·turned + slips + white, NaN where there is none.

    Returns the mean and variance of slow error + zero + scale·turned, (M,) each.
    """
    m, P, mp, Pp, _ = filtered(z, e)
    for k in range(z.size - 2, -1, -1):
        G = np.linalg.solve(Pp[k + 1], np.diag(e.decay[k + 1]) @ P[k]).T
        m[k] = m[k] + G @ (m[k + 1] - mp[k + 1])
        P[k] = P[k] + G @ (P[k + 1] - Pp[k + 1]) @ G.T
    given = e.seen[:, :3]
    return np.sum(m[:, :3] * given, axis=1), np.einsum("ni,nij,nj->n", given, P[:, :3, :3], given)


def learnt_slip(d: Difference, prior: float) -> tuple[float, float, bool]:
    """Slip (rad) and its correlation time (s) of the largest posterior under lognormal priors about `prior` and
    FRONT_TIME, by turns, and whether the data told them."""
    seen = np.flatnonzero(np.isfinite(d.z))
    if seen.size < LEARNT_FROM:
        return prior, FRONT_TIME, False
    part = d.cut(int(seen[0]), min(int(seen[-1]) + 1, int(seen[0]) + LEARNT_FROM_MOST))

    def loss(size: float, time: float) -> float:
        off = (size / math.log(DOUBT)) ** 2 + (time / math.log(TIME_DOUBT)) ** 2
        return (
            0.5 * off - filtered(part.z, part.errors(prior * math.exp(size), FRONT_TIME * math.exp(time)))[-1]
        )

    size, time = 0.0, 0.0
    for _ in range(2):
        size = _least(partial(loss, time=time), 3.0)
        time = _least(partial(loss, size), 1.5)
    return prior * math.exp(size), FRONT_TIME * math.exp(time), True


def _least(loss: Callable[[float], float], reach: float) -> float:
    """Where a function of one logarithm is least, within ±reach."""
    found = minimize_scalar(loss, bounds=(-reach, reach), method="bounded", options={"xatol": 0.05})
    return float(found.x)


def best_steering(
    t: Floats, body: BodyMotion, given: SteerInput | None, front_axle: float, beta: float, bend: Floats,
    slope: tuple[Floats, Floats] | None = None,
) -> Steering:  # fmt: skip
    """Steering angle and its standard deviation, rad (N,), by everything; NaN where nothing is known.

    The given series errs by a zero, a slow Gauss-Markov error and a fast rest; the kinematic angle errs by the
    front wheels' slip: a fast one, learnt from the two series' difference, one that lasts as long as a turn, and on a
    slope what front and rear tyres give way unalike under the weight's part along it.

    beta : rad, slip angle of the rear wheels; bend : (N,) rad, articulation (zeros without a seeder)
    slope : (N,) rad, of the ground across the path, and its deviation; None: level
    """
    downhill = GRAVITY * np.column_stack(slope) if slope is not None else np.zeros((t.size, 2))
    path = kinematic_angle(body, front_axle)
    lateral = physics.COMPLIANCE_FAST * np.abs(body.v * body.yaw_rate)
    stated, turn = path_variance(body, front_axle), turn_slip(body, bend)
    # in a turn the path's own doubt is of the rear wheels' slip, and lasts as long
    stays = np.where(turn > 0.0, np.minimum(slip_variance(body), stated), 0.0)
    stated, turn = stated - stays, np.sqrt(turn**2 + stays)
    prior = max(FRONT_SHARE * beta, LEAST_SLIP)
    if given is None:
        tilted = UNDERSTEER**2 * np.sum(downhill**2, axis=1)
        sd = np.sqrt((prior + lateral) ** 2 + stated + turn**2 + tilted)
        return Steering(path, np.where(np.isnan(path), np.nan, sd), prior, False)
    k = np.arange(0, t.size, EVERY)
    dt = EVERY * (t[1] - t[0]) if t.size > 1 else 1.0
    lasting = given.correlation_time > 5.0 * dt
    slow, fast = (given.sd, 0.0 * given.sd) if lasting else (0.0 * given.sd, given.sd)
    apart = Difference(
        dt, (given.angle - path)[k], slow[k], lateral[k], turn[k], stated[k], max(given.correlation_time, 1e-3),
        given.zero_sd, float(np.mean(fast[k])), (body.yaw - np.median(body.yaw))[k],
        INTEGRATED_SCALE if given.source == "wheels" else 0.0, downhill[k],
    )  # fmt: skip
    slip, time, learnt = learnt_slip(apart, prior)
    error, variance = smooth_error(apart.z, apart.errors(slip, time))
    best = given.angle - np.interp(t, t[k], error)
    constant = (physics.CRAB * slip) ** 2 + (given.scale_sd * best) ** 2
    return Steering(best, np.sqrt(np.interp(t, t[k], variance) + fast**2 + constant), slip, learnt)
