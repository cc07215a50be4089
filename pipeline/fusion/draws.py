"""Posterior draws of the smoother's error across time (simulation smoother of Durbin and Koopman 2002).

A path simulated from the prior and the noises, less its own smoothed estimate, is a draw from the posterior of
the error. The gains do not depend on data, so all draws share the stored forward pass.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .draws_kernels import simulate, smooth
from .engine_compiled import Filtered
from .filtering import KEEP
from .prepare import STEP
from .problem import Problem

Floats = NDArray[np.float64]

EVERY = 5  # nodes between draws' instants: 10 Hz


def posterior_errors(
    problem: Problem, f: Filtered, lin: Floats, draws: int, seed: int
) -> tuple[Floats, Floats]:
    """Instants (M,), every 0.1 s, and draws (M, kept, K) of the KEPT components' error, estimate minus truth."""
    n = problem.t.size
    q = problem.measurements
    starts = q.starts(n)
    error = np.empty(((n - 1) // EVERY + 1, KEEP.size, draws))
    nu = np.zeros((q.kind.size, draws))
    simulate(
        problem.P0, problem.step_inputs, STEP, starts, q.var, problem.inject, problem.parameters, lin, f.H, f.K,
        f.used, np.random.default_rng(seed), EVERY, error, nu,
    )  # fmt: skip
    smooth(
        problem.step_inputs,
        STEP,
        starts,
        problem.parameters,
        lin,
        f.P,
        f.H,
        f.K,
        f.S,
        f.used,
        EVERY,
        error,
        nu,
    )
    return problem.t[::EVERY], np.negative(error, out=error)
