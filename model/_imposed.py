"""Compiled runs of the seeder alone behind an imposed tractor: row 4 of the equations of motion."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from . import _layout as at
from ._integrators import has_diverged, substeps
from ._kernels import FORCE, add_distance_force, interpolate, seeder_force
from ._layout import Floats, Options, Tables
from .parts import part

YAW2, W2, SLIP, FULL_SIZE = at.YAW2, at.W2, at.SLIP, at.FULL_SIZE


@part
def impose(t: float, table: Floats, tables: Tables, s: Floats, u: Floats, force_row: int) -> None:
    """Tractor's pose and rates at t into the state; its accelerations and the seeder's disturbance into u."""
    place = t / tables.dt
    s[at.X1], s[at.Y1] = interpolate(table, place, at.IMPOSED_X), interpolate(table, place, at.IMPOSED_Y)
    s[at.YAW1] = interpolate(table, place, at.IMPOSED_YAW)
    s[at.VX1], s[at.VY1] = interpolate(table, place, at.IMPOSED_VX), interpolate(table, place, at.IMPOSED_VY)
    s[at.W1] = interpolate(table, place, at.IMPOSED_W)
    u[0], u[1] = interpolate(table, place, at.IMPOSED_AX), interpolate(table, place, at.IMPOSED_AY)
    u[2] = interpolate(table, place, at.IMPOSED_ALPHA)
    if tables.time_force.shape[1] > 0:
        for k in range(3, at.FORCE_SIZE):
            u[FORCE + k] = interpolate(tables.time_force[force_row], place, k)


@part
def trailed_derivative(
    s: Floats, p: Floats, u: Floats, tables: Tables, row: int, options: Options, rate: Floats
) -> None:
    """yaw2'' = (Q4 − h4 − a41·x1'' − a42·y1'' − a43·yaw1'')/a44, into rate[W2]."""
    s1, c1, s2, c2 = math.sin(s[at.YAW1]), math.cos(s[at.YAW1]), math.sin(s[YAW2]), math.cos(s[YAW2])
    l4, l5, w1, w2, m2 = p[at.HITCH], p[at.HITCH_TO_COM], s[at.W1], s[W2], p[at.MASS2]
    vx2 = s[at.VX1] + l4 * s1 * w1 + l5 * s2 * w2
    vy2 = s[at.VY1] - l4 * c1 * w1 - l5 * c2 * w2
    fx, fy, moment = seeder_force(c2 * vx2 + s2 * vy2, c2 * vy2 - s2 * vx2, w2, s, p, options, rate)
    add_distance_force(s[at.DISTANCE], p, tables.distance_force[row], tables.spacing, u)
    fx += u[at.FORCE_NOW + 3]
    fy += u[at.FORCE_NOW + 4]
    moment += u[at.FORCE_NOW + 5]
    q4 = moment - l5 * fy  # l5·(sin·F_x − cos·F_y) of the world's components
    if options.as_printed == 0:
        q4 += m2 * l4 * l5 * (s1 * c2 - c1 * s2) * w1 * w1
    q4 -= m2 * l5 * (s2 * u[0] - c2 * u[1]) + m2 * l4 * l5 * (c1 * c2 + s1 * s2) * u[2]
    rate[YAW2] = w2
    rate[W2] = q4 / (p[at.INERTIA2] + m2 * l5 * l5)
    rate[at.DISTANCE] = c1 * s[at.VX1] + s1 * s[at.VY1]


@part
def move(s: Floats, k: Floats, h: float, size: int, trial: Floats) -> None:
    """trial = s + h·k for the seeder's own states (yaw2, its rate, the distance, the slips)."""
    for i in range(at.DISTANCE, size):
        trial[i] = s[i] + h * k[i]
    trial[YAW2] = s[YAW2] + h * k[YAW2]
    trial[W2] = s[W2] + h * k[W2]


@part
def trailed_step(
    t: float, h: float, s: Floats, size: int, p: Floats, table: Floats, tables: Tables, row: int,
    options: Options, u: Floats, k: Floats, trial: Floats,
) -> None:  # fmt: skip
    """Runge–Kutta 4 from t to t + h; k[0] holds the first slope; leaves the tractor at t + h in s."""
    move(s, k[0], 0.5 * h, size, trial)
    impose(t + 0.5 * h, table, tables, trial, u, row)
    trailed_derivative(trial, p, u, tables, row, options, k[1])
    move(s, k[1], 0.5 * h, size, trial)
    trailed_derivative(trial, p, u, tables, row, options, k[2])
    move(s, k[2], h, size, trial)
    impose(t + h, table, tables, trial, u, row)
    trailed_derivative(trial, p, u, tables, row, options, k[3])
    for i in range(size):
        k[0, i] = (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i]) / 6.0
    move(s, k[0], h, size, s)
    impose(t + h, table, tables, s, u, row)


@part
def run_trailed(
    initial: Floats, p: Floats, start: float, table: Floats, tables: Tables, row: int, options: Options,
    h: float, every: int, out: Floats,
) -> int:  # fmt: skip
    """One run from initial = (yaw2, its rate); samples into out (n, 13); gives how many are good."""
    size = SLIP + at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS])
    s, u, trial, k = (
        np.zeros(FULL_SIZE),
        np.zeros(at.INPUT_SIZE),
        np.zeros(FULL_SIZE),
        np.zeros((4, FULL_SIZE)),
    )
    u[at.FORCE_FACTOR] = 1.0
    impose(start, table, tables, s, u, row)
    s[YAW2], s[W2] = initial[0], initial[1]
    for step in range((out.shape[0] - 1) * every + 1):
        trailed_derivative(s, p, u, tables, row, options, k[0])
        if step % every == 0:
            if has_diverged(s):
                return step // every
            sample = out[step // every]
            for i in range(at.STATE_SIZE):
                sample[i] = s[i]
            sample[at.AX1], sample[at.AY1], sample[at.ALPHA1], sample[at.ALPHA2] = u[0], u[1], u[2], k[0, W2]
        parts = substeps(s, p, h, options.largest_rate)
        t = start + step * h
        for piece in range(parts):
            if piece > 0:
                trailed_derivative(s, p, u, tables, row, options, k[0])
            trailed_step(
                t + piece * h / parts, h / parts, s, size, p, table, tables, row, options, u, k, trial
            )
    return int(out.shape[0])


@njit(cache=True, error_model="numpy", nogil=True)
def run_trailed_batch(
    initial: Floats, p: Floats, start: Floats, table: Floats, tables: Tables, rows: Floats, options: Options,
    h: float, every: int, out: Floats, good: Floats,
) -> None:  # fmt: skip
    """`run_trailed` for every row of initial; p may hold one row for all."""
    for b in range(initial.shape[0]):
        good[b] = run_trailed(
            initial[b], p[b % p.shape[0]], start[b], table, tables, int(rows[b]), options, h, every, out[b]
        )
