"""Compiled runs: fixed-step Runge–Kutta 4, and batches of runs."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from . import _layout as at
from ._kernels import SLOWEST, derivative
from ._layout import Floats, Options, Tables
from ._steering import TICK, inputs_at, steering, tick
from .parts import part

FULL_SIZE, SLIP, VX1, VY1, W1, W2 = at.FULL_SIZE, at.SLIP, at.VX1, at.VY1, at.W1, at.W2
X1, Y1, YAW1, YAW2 = at.X1, at.Y1, at.YAW1, at.YAW2
HITCH, L5 = at.HITCH, at.HITCH_TO_COM
WHEELS, WHEEL_SIZE = at.WHEELS, at.WHEEL_SIZE
FASTEST_TURN = 50.0  # rad/s; a body that turns faster has diverged


@part
def substeps(s: Floats, p: Floats, h: float, largest_rate: float) -> int:
    """Parts of a step that keep Runge–Kutta 4 stable: sideways damping grows as 1/v towards standstill."""
    speed = max(abs(s[VX1] * math.cos(s[YAW1]) + s[VY1] * math.sin(s[YAW1])), SLOWEST)
    fastest = p[at.STIFF_RATE] / speed + p[at.SLIP_RATE] * speed
    return 1 + int(h * min(fastest, 1e6) / largest_rate)


@njit(cache=True, error_model="numpy", inline="always")
def finish_step(
    t: float, h: float, s: Floats, size: int, p: Floats, driver: Floats, memory: Floats, change: Floats,
    tables: Tables, options: Options, step: float, u: Floats, k: Floats, trial: Floats,
) -> None:  # fmt: skip
    """Runge–Kutta 4 from t to t + h, its first slope k[0] being known; leaves u at t + h."""
    ground, spacing = tables.distance_force[int(change[at.FORCE_ROW])], tables.spacing
    inputs_at(t + 0.5 * h, memory, driver, change, tables, step, p, u)
    for i in range(size):
        trial[i] = s[i] + 0.5 * h * k[0, i]
    derivative(trial, p, u, ground, spacing, options, k[1])
    for i in range(size):
        trial[i] = s[i] + 0.5 * h * k[1, i]
    derivative(trial, p, u, ground, spacing, options, k[2])
    for i in range(size):
        trial[i] = s[i] + h * k[2, i]
    inputs_at(t + h, memory, driver, change, tables, step, p, u)
    derivative(trial, p, u, ground, spacing, options, k[3])
    for i in range(size):
        s[i] += h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])


@njit(cache=True, error_model="numpy", inline="always")
def fixed_span(
    t: float, h: float, s: Floats, size: int, p: Floats, driver: Floats, memory: Floats, change: Floats,
    tables: Tables, options: Options, u: Floats, k: Floats, trial: Floats,
) -> None:  # fmt: skip
    """Runge–Kutta 4 over one step, in as many parts as stability asks for."""
    parts = substeps(s, p, h, options.largest_rate)
    for piece in range(parts):
        if piece > 0:
            derivative(
                s, p, u, tables.distance_force[int(change[at.FORCE_ROW])], tables.spacing, options, k[0]
            )
        finish_step(
            t + piece * h / parts, h / parts, s, size, p, driver, memory, change, tables, options, h, u, k,
            trial
        )  # fmt: skip


@njit(cache=True, error_model="numpy", inline="always")
def start_slips(s: Floats, p: Floats, u: Floats) -> None:
    """Slip states of the first instant: the slip angles of rolling without relaxation."""
    s1, c1, s2, c2 = math.sin(s[YAW1]), math.cos(s[YAW1]), math.sin(s[YAW2]), math.cos(s[YAW2])
    vx2 = s[VX1] + p[HITCH] * s1 * s[W1] + p[L5] * s2 * s[W2]
    vy2 = s[VY1] - p[HITCH] * c1 * s[W1] - p[L5] * c2 * s[W2]
    for i in range(at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS])):
        px, py = p[WHEELS + i * WHEEL_SIZE + at.WHEEL_X], p[WHEELS + i * WHEEL_SIZE + at.WHEEL_Y]
        sin, cos = (u[2 * i], u[2 * i + 1]) if i < 2 else (0.0, 1.0)
        if i < at.TRACTOR_WHEELS:
            forward, sideways = c1 * s[VX1] + s1 * s[VY1] - s[W1] * py, c1 * s[VY1] - s1 * s[VX1] + s[W1] * px
        else:
            forward, sideways = c2 * vx2 + s2 * vy2 - s[W2] * py, c2 * vy2 - s2 * vx2 + s[W2] * px
        along, across = cos * forward + sin * sideways, cos * sideways - sin * forward
        s[SLIP + i] = math.atan2(across, max(abs(along), SLOWEST))


@part
def has_diverged(s: Floats) -> bool:
    """Whether the state is no longer finite, or a body spins as no machine does."""
    return not (
        math.isfinite(s[X1])
        and math.isfinite(s[Y1])
        and abs(s[W1]) < FASTEST_TURN
        and abs(s[W2]) < FASTEST_TURN
    )


@part
def write_sample(s: Floats, rate: Floats, mean: float, sample: Floats) -> None:
    """One output sample: state, second derivatives, steering angle."""
    for i in range(at.STATE_SIZE):
        sample[i] = s[i]
    for i in range(4):
        sample[at.AX1 + i] = rate[VX1 + i]
    sample[at.STEER] = mean


@njit(cache=True, error_model="numpy", inline="always")
def begin(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, h: float, memory: Floats,
    s: Floats, u: Floats,
) -> None:  # fmt: skip
    """State, inputs and the driver's memory of the first instant."""
    for i in range(at.STATE_SIZE):
        s[i] = initial[i]
    start = change[at.START]
    memory[TICK] = start
    u[at.FORCE_FACTOR] = change[at.FORCE_SCALE]
    inputs_at(start, memory, driver, change, tables, h, p, u)
    start_slips(s, p, u)


@njit(cache=True, error_model="numpy", inline="always")
def run(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, options: Options,
    h: float, every: int, memory: Floats, out: Floats,
) -> int:  # fmt: skip
    """One run at fixed step h, a sample every `every` steps into out (n, 13); gives how many samples are
    good."""
    size = SLIP + at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS])
    s, u, trial, k = (
        np.zeros(FULL_SIZE),
        np.zeros(at.INPUT_SIZE),
        np.zeros(FULL_SIZE),
        np.zeros((4, FULL_SIZE)),
    )
    start, period = change[at.START], max(int(driver[at.PERIOD_STEPS]), 1)
    ground = tables.distance_force[int(change[at.FORCE_ROW])]
    begin(initial, p, driver, change, tables, h, memory, s, u)
    for step in range((out.shape[0] - 1) * every + 1):
        t = start + step * h
        if driver[at.ACTIVE] > 0.0 and step % period == 0:
            tick(t, s, p, driver, memory, tables, h)
        derivative(s, p, u, ground, tables.spacing, options, k[0])
        if step % every == 0:
            if has_diverged(s):
                return step // every
            write_sample(s, k[0], steering(t, memory, driver, change, tables, h), out[step // every])
        fixed_span(t, h, s, size, p, driver, memory, change, tables, options, u, k, trial)
    return int(out.shape[0])


@njit(cache=True, error_model="numpy", nogil=True)
def run_batch(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, options: Options,
    h: float, every: int, memory: Floats, out: Floats, good: Floats,
) -> None:  # fmt: skip
    """`run` for every row of initial; p, driver may hold one row for all."""
    for b in range(initial.shape[0]):
        good[b] = run(
            initial[b], p[b % p.shape[0]], driver[b % driver.shape[0]], change[b], tables, options,
            h, every, memory[b], out[b],
        )  # fmt: skip
