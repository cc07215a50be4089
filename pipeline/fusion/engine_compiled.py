"""The default engine: the compiled filter and smoother of `filtering`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import filtering
from .prepare import STEP
from .problem import Problem
from .state import KEPT, P_ACTIVE, SIZE

Floats = NDArray[np.float64]
TRIANGLE = SIZE * (SIZE + 1) // 2


@dataclass(frozen=True)
class Filtered:
    """Forward pass: x (N, SIZE), P (N, n(n+1)/2) the packed covariance of the n active components, and for each
    scalar measurement its row H, gain K, innovation variance S, innovation nu, and whether it was used.
    """

    x: Floats
    P: Floats
    H: Floats
    K: Floats
    S: Floats
    nu: Floats
    used: NDArray[np.bool_]
    log_likelihood: float


@dataclass(frozen=True)
class Smoothed:
    """Backward pass: x (N, SIZE), covariance of the KEPT components (N, k, k)."""

    x: Floats
    P: Floats


def run_filter(problem: Problem, lin: Floats | None, store: bool = True) -> Filtered:
    """Filter forward; `lin` (N, SIZE): path to linearise about, None: about the filter's own estimate."""
    n, m = problem.t.size, problem.measurements.kind.size
    rows, keep = (m, n) if store else (1, 1)
    count = int(problem.parameters[P_ACTIVE])
    out_x, out_P = np.empty((keep, SIZE)), np.empty((keep, count * (count + 1) // 2))
    H, K = np.zeros((rows, SIZE)), np.zeros((rows, SIZE))
    S, nu, used = np.zeros(rows), np.zeros(rows), np.zeros(rows, dtype=np.bool_)
    q = problem.measurements
    value = filtering.forward(
        problem.x0, problem.P0, problem.step_inputs, problem.node_inputs, STEP, q.kind, q.starts(n), q.z, q.var,
        q.ahead, problem.inject, problem.parameters, np.zeros((1, SIZE)) if lin is None else lin, lin is not None,
        out_x, out_P, H, K, S, nu, used, store,
    )  # fmt: skip
    return Filtered(out_x, out_P, H, K, S, nu, used, float(value))


def run_smoother(problem: Problem, f: Filtered, lin: Floats | None) -> Smoothed:
    """Smooth backward over a stored forward pass with the same `lin`."""
    n = problem.t.size
    x, P = np.empty((n, SIZE)), np.empty((n, len(KEPT), len(KEPT)))
    filtering.backward(
        problem.step_inputs, STEP, problem.measurements.starts(n), problem.parameters,
        f.x if lin is None else lin, f.x, f.P, f.H, f.K, f.S, f.nu, f.used, x, P,
    )  # fmt: skip
    return Smoothed(x, P)
