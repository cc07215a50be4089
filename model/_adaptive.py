"""Compiled runs by the paper's adaptive Runge–Kutta 4–5 (Dormand–Prince)."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from . import _layout as at
from ._integrators import FULL_SIZE, SLIP, begin, has_diverged, write_sample
from ._kernels import derivative
from ._layout import Floats, Options, Tables
from ._steering import inputs_at, tick
from .parts import part

MOST_TRIALS = 200_000  # of the adaptive integrator between two samples; beyond, the run counts as diverged

# Dormand and Prince (1980), RK5(4)7M: nodes, stages, and the difference of the two solutions.
NODES = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0, 1.0])
STAGES = np.array(
    [
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1 / 5, 0.0, 0.0, 0.0, 0.0, 0.0],
        [3 / 40, 9 / 40, 0.0, 0.0, 0.0, 0.0],
        [44 / 45, -56 / 15, 32 / 9, 0.0, 0.0, 0.0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0.0, 0.0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656, 0.0],
        [35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84],
    ]
)
ERROR = np.array([71 / 57600, 0.0, -71 / 16695, 71 / 1920, -17253 / 339200, 22 / 525, -1 / 40])


@part
def trial_step(
    t: float, h: float, s: Floats, size: int, p: Floats, driver: Floats, memory: Floats, change: Floats,
    tables: Tables, options: Options, step: float, u: Floats, k: Floats, trial: Floats,
) -> float:  # fmt: skip
    """One Dormand–Prince step into trial, its first slope k[0] being known; gives its error over the
    tolerance."""
    ground = tables.distance_force[int(change[at.FORCE_ROW])]
    for stage in range(1, 7):
        for i in range(size):
            slope = 0.0
            for j in range(stage):
                slope += STAGES[stage, j] * k[j, i]
            trial[i] = s[i] + h * slope
        now = t + NODES[stage] * h
        inputs_at(now, memory, driver, change, tables, step, p, u)
        derivative(trial, p, u, ground, tables.spacing, options, k[stage])
    worst = 0.0
    for i in range(size):
        error = 0.0
        for j in range(7):
            error += ERROR[j] * k[j, i]
        allowed = options.absolute_tolerance + options.relative_tolerance * max(abs(s[i]), abs(trial[i]))
        worst = max(worst, abs(h * error) / allowed)
    return worst


@part
def adaptive_span(
    t: float, span: float, guess: float, s: Floats, size: int, p: Floats, driver: Floats, memory: Floats,
    change: Floats, tables: Tables, options: Options, step: float, u: Floats, k: Floats, trial: Floats,
) -> float:  # fmt: skip
    """Dormand–Prince from t to t + span, its first slope k[0] being known; gives the next step to try, 0 if
    lost."""
    done, h = 0.0, guess
    for _ in range(MOST_TRIALS):
        last = done + h >= span * (1.0 - 1e-12)
        now = span - done if last else h
        error = trial_step(
            t + done, now, s, size, p, driver, memory, change, tables, options, step, u, k, trial
        )
        factor = 0.2 if not math.isfinite(error) else min(max(0.9 * max(error, 1e-10) ** -0.2, 0.2), 5.0)
        if error <= 1.0:
            for i in range(size):
                s[i], k[0, i] = trial[i], k[6, i]
            done += now
            if last:
                return max(h, now * factor)
        h = now * factor
    return 0.0


@part
def run_adaptive(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, options: Options,
    h: float, every: int, memory: Floats, out: Floats,
) -> int:  # fmt: skip
    """One run with samples each `every` spans of h, in which steps adapt; gives how many samples are good."""
    size = SLIP + at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS])
    s, u, trial, k = (
        np.zeros(FULL_SIZE),
        np.zeros(at.INPUT_SIZE),
        np.zeros(FULL_SIZE),
        np.zeros((7, FULL_SIZE)),
    )
    ground, period, guess = tables.distance_force[int(change[at.FORCE_ROW])], int(driver[at.PERIOD_STEPS]), h
    begin(initial, p, driver, change, tables, h, memory, s, u)
    for span in range((out.shape[0] - 1) * every + 1):
        t = change[at.START] + span * h
        if driver[at.ACTIVE] > 0.0 and span % period == 0:
            tick(t, s, p, driver, memory, tables, h)
        mean = inputs_at(t, memory, driver, change, tables, h, p, u)
        derivative(s, p, u, ground, tables.spacing, options, k[0])
        if span % every == 0:
            if guess == 0.0 or has_diverged(s):
                return span // every
            write_sample(s, k[0], mean, out[span // every])
        guess = adaptive_span(
            t, h, guess, s, size, p, driver, memory, change, tables, options, h, u, k, trial
        )
    return int(out.shape[0])


@njit(cache=True, error_model="numpy", nogil=True)
def run_adaptive_batch(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, options: Options,
    h: float, every: int, memory: Floats, out: Floats, good: Floats,
) -> None:  # fmt: skip
    """`run_adaptive` for every row of initial; p, driver may hold one row for all."""
    for b in range(initial.shape[0]):
        good[b] = run_adaptive(
            initial[b], p[b % p.shape[0]], driver[b % driver.shape[0]], change[b], tables, options,
            h, every, memory[b], out[b],
        )  # fmt: skip
