"""From the smoothed state to the bodies' motion: centres of mass, their covariance, on the UTC grid.

The filter runs in inertial time, LAG ahead of UTC. Everything here is taken at t + LAG, and the doubt of LAG
goes into the covariance together with its correlation to position and yaw.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from . import state as s
from .motion import BodyMotion
from .prepare import STEP
from .state import KEPT

Floats = NDArray[np.float64]

RATE_WINDOW = 11  # nodes: yaw rates leave as slopes of the smoothed yaw over 0.2 s
K_X, K_Y, K_YAW1, K_V, K_SLIP1, K_ROLL, K_PITCH, K_YAW2, K_BGZ, K_BGZ2, K_LAG, K_TURN1 = range(len(KEPT))
BLOCK = 8192  # nodes worked on at a time: an hour's covariances more than once are the peak of memory
BODY = 6  # x, y, yaw, v, v_lateral, yaw_rate


@dataclass(frozen=True)
class Smooth:
    """Smoothed state on the UTC grid: x (N, SIZE), P (N, kept, kept), yaw rates (N,), seeder's tilt (N,)."""

    x: Floats
    P: Floats
    rate1: Floats
    rate2: Floats
    roll2: Floats
    pitch2: Floats


@dataclass(frozen=True)
class Unseen:
    """What moves and turns the bodies and is not in the state: d(x, y, yaw), m and rad, of tractor and seeder.

    tractor, seeder (N, K, 3) : by one standard deviation of each of K unknowns, constant all along and the same of both
    tractor_by_roll, seeder_by_roll (N, 3) : by an error of the state's roll, beside what the state itself has of it
    """

    tractor: Floats
    seeder: Floats
    tractor_by_roll: Floats
    seeder_by_roll: Floats


def utc_grid(t: Floats, lag: float) -> Floats:
    """Whole multiples of the step inside the filter's span brought to UTC."""
    first = math.ceil((t[0] - lag) / STEP + 1.0)
    last = math.floor((t[-1] - lag) / STEP - 1.0)
    return np.arange(first, last + 1, dtype=np.float64) * STEP


def at_utc(t: Floats, grid: Floats, lag: float, x: Floats, P: Floats, tilt2: tuple[Floats, Floats]) -> Smooth:
    """State, covariance, rates and tilt interpolated to `grid` (UTC) + lag."""
    place = (grid + lag - t[0]) / STEP
    i = np.clip(place.astype(np.int64), 0, t.size - 2)
    w = place - i

    def at(v: Floats) -> Floats:
        out = np.empty((grid.size, *v.shape[1:]))
        for a in range(0, grid.size, BLOCK):
            here = slice(a, a + BLOCK)
            f = w[here].reshape(-1, *([1] * (v.ndim - 1)))
            out[here] = v[i[here]] * (1.0 - f) + v[i[here] + 1] * f
        return out

    window = min(RATE_WINDOW, t.size - 1 + t.size % 2)
    rate1, rate2 = (savgol_filter(x[:, k], window, 2, deriv=1, delta=STEP) for k in (s.YAW1, s.YAW2))
    return Smooth(at(x), at(P), at(rate1), at(rate2), at(tilt2[0]), at(tilt2[1]))


def slip_velocity(m: Smooth) -> Floats:
    """Lateral velocity at the rear axle (N,), m/s."""
    return np.asarray(m.x[:, s.SLIP1] + m.x[:, s.TURN1])


def tractor_jacobian(m: Smooth, p: Floats, unseen: Unseen) -> Floats:
    """d(x1, y1, yaw1, v1, v_lateral1, yaw_rate1)/d(kept state), (N, 6, kept)."""
    c, sn = np.cos(m.x[:, s.YAW1]), np.sin(m.x[:, s.YAW1])
    J = np.zeros((m.x.shape[0], BODY, len(KEPT)))
    J[:, 0, K_X] = J[:, 1, K_Y] = J[:, 2, K_YAW1] = J[:, 3, K_V] = 1.0
    J[:, 4, K_SLIP1] = J[:, 4, K_TURN1] = 1.0
    J[:, 0, K_YAW1], J[:, 1, K_YAW1] = -p[s.P_REAR] * sn, p[s.P_REAR] * c
    J[:, 0, K_ROLL], J[:, 1, K_ROLL] = p[s.P_SWAY] * sn, -p[s.P_SWAY] * c
    J[:, 0, K_PITCH], J[:, 1, K_PITCH] = p[s.P_SWAY] * c, p[s.P_SWAY] * sn
    J[:, 4, K_BGZ], J[:, 5, K_BGZ] = -p[s.P_REAR], -1.0
    across = slip_velocity(m) + p[s.P_REAR] * m.rate1
    J[:, 0, K_LAG] = m.x[:, s.V] * c - across * sn
    J[:, 1, K_LAG] = m.x[:, s.V] * sn + across * c
    J[:, 2, K_LAG] = m.rate1
    J[:, :3, K_ROLL] += unseen.tractor_by_roll
    return J


def seeder_jacobian(m: Smooth, p: Floats, unseen: Unseen) -> Floats:
    """d(x2, y2, yaw2, v2, v_lateral2, yaw_rate2)/d(kept state), (N, 6, kept)."""
    c1, s1 = np.cos(m.x[:, s.YAW1]), np.sin(m.x[:, s.YAW1])
    c2, s2 = np.cos(m.x[:, s.YAW2]), np.sin(m.x[:, s.YAW2])
    d, l5 = p[s.P_HITCH], p[s.P_COM2]
    bend = m.x[:, s.YAW1] - m.x[:, s.YAW2]
    across = slip_velocity(m) - d * m.rate1
    J = np.zeros((m.x.shape[0], BODY, len(KEPT)))
    J[:, 0, K_X] = J[:, 1, K_Y] = J[:, 2, K_YAW2] = 1.0
    J[:, 0, K_YAW1], J[:, 1, K_YAW1] = d * s1, -d * c1
    J[:, 0, K_YAW2], J[:, 1, K_YAW2] = l5 * s2, -l5 * c2
    J[:, 3, K_V], J[:, 4, K_V] = np.cos(bend), np.sin(bend)
    for slip in (K_SLIP1, K_TURN1):
        J[:, 3, slip], J[:, 4, slip] = -np.sin(bend), np.cos(bend)
    J[:, 3, K_YAW1] = -m.x[:, s.V] * np.sin(bend) - across * np.cos(bend)
    J[:, 4, K_YAW1] = m.x[:, s.V] * np.cos(bend) - across * np.sin(bend)
    J[:, 3, K_YAW2], J[:, 4, K_YAW2] = -J[:, 3, K_YAW1], -J[:, 4, K_YAW1]
    J[:, 3, K_BGZ], J[:, 4, K_BGZ] = -d * np.sin(bend), d * np.cos(bend)
    J[:, 4, K_BGZ2], J[:, 5, K_BGZ2] = l5, -1.0
    J[:, 0, K_LAG] = m.x[:, s.V] * c1 - across * s1 + l5 * m.rate2 * s2
    J[:, 1, K_LAG] = m.x[:, s.V] * s1 + across * c1 - l5 * m.rate2 * c2
    J[:, 2, K_LAG] = m.rate2
    J[:, :3, K_ROLL] += unseen.seeder_by_roll
    return J


def _covariance(J: Floats, P: Floats, rate_variance: float, modes: Floats) -> Floats:
    """J·P·Jᵀ with what the state does not hold: the rates' own noise and modes (N, K, 3) of x, y and yaw."""
    C = np.empty((J.shape[0], BODY, BODY))
    for a in range(0, J.shape[0], BLOCK):
        here = slice(a, a + BLOCK)
        C[here] = J[here] @ P[here] @ J[here].transpose(0, 2, 1)
        C[here, :3, :3] += modes[here].transpose(0, 2, 1) @ modes[here]
    C[:, 4, 4] += rate_variance
    C[:, 5, 5] += rate_variance
    return np.asarray(0.5 * (C + C.transpose(0, 2, 1)))


def _slope_variance(noise: float) -> float:
    """Variance of a slope over RATE_WINDOW nodes of an angle that walks by gyro noise (rad/s/sqrt(Hz))."""
    return 1.2 * noise**2 / (RATE_WINDOW * STEP)


def tractor_motion(m: Smooth, p: Floats, unseen: Unseen, lateral: Floats | None) -> BodyMotion:
    """The tractor's motion at its centre of mass."""
    x = m.x
    c, sn = np.cos(x[:, s.YAW1]), np.sin(x[:, s.YAW1])
    forward = p[s.P_REAR] + p[s.P_SWAY] * np.sin(x[:, s.PITCH]) * np.cos(x[:, s.ROLL])
    left = -p[s.P_SWAY] * np.sin(x[:, s.ROLL])
    C = _covariance(tractor_jacobian(m, p, unseen), m.P, _slope_variance(p[s.P_GYRO1]), unseen.tractor)
    return BodyMotion(
        x=x[:, s.X] + forward * c - left * sn,
        y=x[:, s.Y] + forward * sn + left * c,
        yaw=x[:, s.YAW1].copy(),
        v=x[:, s.V].copy(),
        v_lateral=slip_velocity(m) + p[s.P_REAR] * m.rate1,
        yaw_rate=m.rate1,
        covariance=C,
        roll=x[:, s.ROLL].copy(),
        pitch=x[:, s.PITCH].copy(),
        lateral_acceleration=lateral,
    )


def seeder_motion(m: Smooth, p: Floats, unseen: Unseen, lateral: Floats | None) -> BodyMotion:
    """The seeder's motion at its centre of mass, behind the hitch by l5."""
    x = m.x
    c1, s1 = np.cos(x[:, s.YAW1]), np.sin(x[:, s.YAW1])
    c2, s2 = np.cos(x[:, s.YAW2]), np.sin(x[:, s.YAW2])
    forward = -p[s.P_COM2] + p[s.P_SWAY2] * np.sin(m.pitch2) * np.cos(m.roll2)
    left = -p[s.P_SWAY2] * np.sin(m.roll2)
    bend = x[:, s.YAW1] - x[:, s.YAW2]
    across = slip_velocity(m) - p[s.P_HITCH] * m.rate1
    C = _covariance(seeder_jacobian(m, p, unseen), m.P, _slope_variance(p[s.P_GYRO2]), unseen.seeder)
    return BodyMotion(
        x=x[:, s.X] - p[s.P_HITCH] * c1 + forward * c2 - left * s2,
        y=x[:, s.Y] - p[s.P_HITCH] * s1 + forward * s2 + left * c2,
        yaw=x[:, s.YAW2].copy(),
        v=x[:, s.V] * np.cos(bend) - across * np.sin(bend),
        v_lateral=x[:, s.V] * np.sin(bend) + across * np.cos(bend) - p[s.P_COM2] * m.rate2,
        yaw_rate=m.rate2,
        covariance=C,
        roll=m.roll2,
        pitch=m.pitch2,
        lateral_acceleration=lateral,
    )


def body_draws(
    error: Floats, at: Smooth, p: Floats, seeder: bool, unseen: Unseen, rng: np.random.Generator
) -> Floats:
    """Draws of the error of (x1, y1, yaw1, x2, y2, yaw2), (K, M, 6 or 3), from draws of the KEPT state (M, kept, K).

    at : the smoothed state at the draws' instants, and what is unseen there: one value of each mode a draw
    """
    size = rng.standard_normal((error.shape[2], unseen.tractor.shape[1]))
    bodies = [(tractor_jacobian(at, p, unseen), unseen.tractor)]
    if seeder:
        bodies.append((seeder_jacobian(at, p, unseen), unseen.seeder))
    found = [
        np.einsum("nik,nkd->dni", J[:, :3], error, optimize=True)
        + np.einsum("dk,nki->dni", size, modes, optimize=True)
        for J, modes in bodies
    ]
    return np.ascontiguousarray(np.concatenate(found, axis=2))
