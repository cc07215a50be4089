"""The reference engine: filterpy's extended Kalman filter forward, Rauch-Tung-Striebel backward, readable.

filterpy's own smoother predicts again with F·x, which is wrong for a nonlinear process; this one keeps each
step's predicted state and covariance and smooths with those. Uncompiled functions of the same model throughout.
"""

from __future__ import annotations

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter
from numpy.typing import NDArray

from .engine_compiled import TRIANGLE, Filtered, Smoothed
from .filtering import is_given, is_pair, pack, unpack
from .kernels import GATE_1, GATE_2, predict, process_noise, transition
from .prepare import STEP
from .problem import Problem
from .state import EX, EY, FX, FY, KEPT, P_ACTIVE, SIZE

Floats = NDArray[np.float64]


def _advance(task: Problem, k: int, point: Floats, x: Floats) -> tuple[Floats, Floats, Floats]:
    """Predicted state, F and diagonal of Q of the step from node k - 1 to k, linearised at `point`."""
    F, q = np.eye(SIZE), np.empty(SIZE)
    there = transition(point, task.step_inputs[k - 1], STEP, task.parameters, F)
    process_noise(point, task.step_inputs[k - 1], STEP, task.parameters, q)
    q[[EX, EY]] += task.inject[k, 0]
    q[[FX, FY]] += task.inject[k, 1]
    return there + F @ (x - point), F, q


def run_filter(task: Problem, lin: Floats | None, store: bool = True) -> Filtered:
    """Filter forward with filterpy; the same contract as the compiled engine's."""
    n, m = task.t.size, task.measurements.kind.size
    out = Filtered(
        np.empty((n, SIZE)), np.empty((n, TRIANGLE)), np.zeros((m, SIZE)), np.zeros((m, SIZE)), np.zeros(m),
        np.zeros(m), np.zeros(m, dtype=np.bool_), 0.0,
    )  # fmt: skip
    starts = task.measurements.starts(n)
    ekf = ExtendedKalmanFilter(dim_x=SIZE, dim_z=1)
    ekf.x, ekf.P = task.x0.copy(), task.P0.copy()
    total = 0.0
    for k in range(n):
        if k > 0:
            point = ekf.x if lin is None else lin[k - 1]
            ekf.x, ekf.F, q = _advance(task, k, point, ekf.x)
            ekf.P = ekf.F @ ekf.P @ ekf.F.T + np.diag(q)
        row = int(starts[k])
        while row < starts[k + 1]:
            row, gained = _update(ekf, task, row, task.node_inputs[k], None if lin is None else lin[k], out)
            total += gained
        out.x[k] = ekf.x
        pack(ekf.P, out.P[k], int(task.parameters[P_ACTIVE]))
    return Filtered(out.x, out.P, out.H, out.K, out.S, out.nu, out.used, total)


def _update(
    ekf: ExtendedKalmanFilter, task: Problem, row: int, node: Floats, point: Floats | None, out: Filtered
) -> tuple[int, float]:
    """One measurement (a pair together) through the gate and filterpy's update; next row and log-likelihood."""
    q = task.measurements
    rows = [row, row + 1] if is_pair(q.kind[row]) else [row]
    about = ekf.x.copy() if point is None else point
    H, h = np.zeros((len(rows), SIZE)), np.zeros(len(rows))
    for i, r in enumerate(rows):
        h[i] = predict(q.kind[r], about, node, q.ahead[r], task.parameters, H[i])
    expected = h + H @ (ekf.x - about)
    R = np.diag(q.var[rows])
    S = H @ ekf.P @ H.T + R
    nu = q.z[rows] - expected
    gate = GATE_2 if len(rows) == 2 else GATE_1
    passes = is_given(q.kind[row]) or float(nu @ np.linalg.solve(S, nu)) <= gate
    _record(out, rows, H, ekf.P, q.var[rows], nu, passes)
    if passes:
        ekf.R = R
        ekf.update(q.z[rows], lambda _: H, lambda _: expected, R=R)
        gained = -0.5 * sum(out.nu[r] ** 2 / out.S[r] + np.log(out.S[r]) for r in rows)
    else:
        gained = -0.5 * (gate + sum(np.log(out.S[r]) for r in rows))
    return rows[-1] + 1, float(gained)


def _record(
    out: Filtered, rows: list[int], H: Floats, P: Floats, var: Floats, nu: Floats, passes: bool
) -> None:
    """Gains and innovations of the equal sequence of scalar updates, for the draws and the statistics."""
    P, shift = P.copy(), np.zeros(SIZE)
    for i, r in enumerate(rows):
        S = float(H[i] @ P @ H[i]) + var[i]
        K = P @ H[i] / S
        left = nu[i] - float(H[i] @ shift)
        out.H[r], out.K[r], out.S[r], out.nu[r], out.used[r] = H[i], K, S, left, passes
        if passes:
            shift = shift + K * left
            P = P - np.outer(K, K) * S


def run_smoother(task: Problem, f: Filtered, lin: Floats | None) -> Smoothed:
    """Rauch-Tung-Striebel: x_s = x + G(x_s' − x'), G = P·Fᵀ·P'⁻¹ with the stored filter's predictions."""
    n = task.t.size
    x, P = f.x.copy(), np.empty((n, len(KEPT), len(KEPT)))
    now, later = np.zeros((SIZE, SIZE)), np.zeros((SIZE, SIZE))
    count = int(task.parameters[P_ACTIVE])
    unpack(f.P[n - 1], later, count)
    P[n - 1] = later[np.ix_(KEPT, KEPT)]
    for k in range(n - 2, -1, -1):
        unpack(f.P[k], now, count)
        predicted, F, q = _advance(task, k + 1, f.x[k] if lin is None else lin[k], f.x[k])
        ahead = F @ now @ F.T + np.diag(q)
        live = np.diag(ahead) > 0.0
        G = np.zeros((SIZE, SIZE))
        G[:, live] = np.linalg.solve(ahead[np.ix_(live, live)], (F @ now)[live]).T
        x[k] = f.x[k] + G @ (x[k + 1] - predicted)
        later = now + G @ (later - ahead) @ G.T
        later = 0.5 * (later + later.T)
        P[k] = later[np.ix_(KEPT, KEPT)]
    return Smoothed(x, P)
