"""The best estimate of the steering angle: the wheels or the sensor fast, the body's own path slow.

Only `Motion.steer` may see this; the replay is driven by `steer_input`, which knows nothing of the body.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import settings as physics
from .motion import BodyMotion, SteerInput

Floats = NDArray[np.float64]

EVERY = 25  # nodes: 2 Hz is enough for what is slow
SLOWEST = 0.7  # m/s: no kinematic angle below
FRONT_SLIP = 0.003  # rad: least standard deviation of the front wheels' slip angle
FRONT_TIME = 1.0  # s, correlation of the front wheels' slip
WHITE = 0.003  # rad, of a kinematic angle at one instant


def kinematic_angle(body: BodyMotion, front_axle: float) -> Floats:
    """Heading of the front axle's velocity against the body, rad (N,): the steering angle of wheels without slip.

    atan((v_lateral + l2·yaw_rate)/v); NaN below SLOWEST.
    """
    across = body.v_lateral + front_axle * body.yaw_rate
    usable = np.abs(body.v) > SLOWEST
    return np.where(usable, np.arctan(across / np.where(usable, body.v, 1.0)), np.nan)


def smooth_error(z: Floats, var: float, decay: Floats, drive: Floats, P0: Floats) -> tuple[Floats, Floats]:
    """Rauch-Tung-Striebel smoother of (slow error, zero, slip) with z = slow error + zero + slip + white.

    decay, drive : (N, 3) of the step that ends at each sample; z NaN where there is none.
    Returns the mean and variance of slow error + zero, (N,) each.
    """
    n = z.size
    m, P = np.zeros((n, 3)), np.zeros((n, 3, 3))
    mp, Pp = np.zeros((n, 3)), np.zeros((n, 3, 3))
    x, C = np.zeros(3), P0.copy()
    for k in range(n):
        if k > 0:
            x = decay[k] * x
            C = C * np.outer(decay[k], decay[k]) + np.diag(drive[k])
        mp[k], Pp[k] = x, C
        if not np.isnan(z[k]):
            g = C.sum(axis=1)
            s = g.sum() + var
            x = x + g * ((z[k] - x.sum()) / s)
            C = C - np.outer(g, g) / s
        m[k], P[k] = x, C
    for k in range(n - 2, -1, -1):
        G = np.linalg.solve(Pp[k + 1], np.diag(decay[k + 1]) @ P[k]).T
        m[k] = m[k] + G @ (m[k + 1] - mp[k + 1])
        P[k] = P[k] + G @ (P[k + 1] - Pp[k + 1]) @ G.T
    return m[:, 0] + m[:, 1], P[:, 0, 0] + P[:, 1, 1] + 2.0 * P[:, 0, 1]


def best_steering(
    t: Floats, body: BodyMotion, given: SteerInput | None, front_axle: float, beta: float
) -> tuple[Floats, Floats]:
    """Steering angle and its standard deviation, rad (N,), by everything; NaN where nothing is known.

    The given series errs by a zero, a slow Gauss-Markov error and a fast rest; the kinematic angle errs by the
    front wheels' slip (a Gauss-Markov process of FRONT_TIME that grows with lateral acceleration).
    """
    path = kinematic_angle(body, front_axle)
    slip = max(beta, FRONT_SLIP) + physics.COMPLIANCE * np.abs(body.v * body.yaw_rate)
    if given is None:
        return path, np.where(np.isnan(path), np.nan, slip)
    k = np.arange(0, t.size, EVERY)
    dt = EVERY * (t[1] - t[0]) if t.size > 1 else 1.0
    tau = max(given.correlation_time, 1e-3)
    slow = given.sd[k] if given.correlation_time > 5.0 * dt else np.zeros(k.size)
    fast = np.zeros(t.size) if given.correlation_time > 5.0 * dt else given.sd
    keep = np.array([np.exp(-dt / tau), 1.0, np.exp(-dt / FRONT_TIME)])
    decay = np.tile(keep, (k.size, 1))
    drive = np.column_stack(
        [slow**2 * (1 - keep[0] ** 2) + 1e-14, np.full(k.size, 1e-14), slip[k] ** 2 * (1 - keep[2] ** 2)]
    )
    start = np.diag([max(slow[0], 1e-6) ** 2, given.zero_sd**2, slip[0] ** 2])
    error, variance = smooth_error(
        (given.angle - path)[k], WHITE**2 + float(np.mean(fast[k])) ** 2, decay, drive, start
    )
    best = given.angle - np.interp(t, t[k], error)
    sd = np.sqrt(np.interp(t, t[k], variance) + fast**2 + (given.scale_sd * best) ** 2)
    return best, sd
