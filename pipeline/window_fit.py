"""One row replayed in windows: residuals with nothing moved, with the bounded alignment, and of the
straight line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..model.machine import Machine
from ..model.simulate import BatchRun
from ..model.trailed import imposed_from_body, simulate_trailed_batch
from . import grid as on_grid
from .alignment import Alignment, align, align_freely
from .fusion.motion import Motion
from .grid import Part, RowGrid, stacked_simulated
from .replay import (
    OVERRUN,
    Drive,
    Window,
    cut_windows,
    drive_of,
    driven_samples,
    initial_states,
    run_windows,
    shifted,
    window_prior,
)  # fmt: skip
from .replay_settings import ReplaySettings

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

OFFSET, HEADING, STEER = 0, 1, 2  # of the alignment's θ
STEER_STEP = float(np.deg2rad(0.1))  # of the finite difference for the steering offset
COARSE_SPACING, COARSE_STEP = 0.05, 0.02  # s, for the horizon curve and the sensitivities


@dataclass(frozen=True)
class Context:
    """What all windows of one row share. `trailed`: the measured tractor is imposed, only the seeder
    simulated."""

    motion: Motion
    machine: Machine
    grid: RowGrid
    settings: ReplaySettings
    trailed: bool
    variance: Floats  # (responses,) of the measuring error, in m² or rad²
    correlation: Floats  # (responses,) m, correlation length of that error


@dataclass(frozen=True)
class WindowFit:
    """One window: stacked arrays (N,) over its points, response by response.

    start : residual with the state from the smoother and nothing moved; bounded : after the bounded
    alignment (run
    again with the aligned start and steering); free : with offset and heading fitted without a prior
    null : residual of the straight line after the same bounded alignment; run, index : where its motion lies
    """

    window: Window
    parts: tuple[Part, ...]
    valid: Mask
    sensitivity: Floats
    alignment: Alignment
    start: Floats
    bounded: Floats
    free: Floats
    null: Floats
    run: BatchRun
    index: int


def make_context(
    motion: Motion, machine: Machine, grid: RowGrid, settings: ReplaySettings, trailed: bool
) -> Context:
    """The row's context, with size and correlation length of the measuring error from the smoother's
    draws."""
    variance, correlation = [], []
    for body in grid.bodies:
        part = Part(body, 0, body.s.size)
        draws = on_grid.stacked_draws((part,), grid.row, motion)
        for _, place in on_grid.slices((part,)):
            variance.append(max(float(np.mean(draws[place] ** 2)) if draws.shape[1] else 0.0, 1e-12))
            correlation.append(correlation_length(draws[place], grid.step))
    return Context(motion, machine, grid, settings, trailed, np.array(variance), np.array(correlation))


def correlation_length(draws: Floats, step: float) -> float:
    """Twice the lag at which the draws' (N, K) autocorrelation falls to 1/e: ∫ρ of an exponential, m."""
    if draws.shape[1] == 0 or draws.shape[0] < 2:
        return step
    power = float(np.mean(draws**2))
    lags = np.unique(np.geomspace(1, draws.shape[0] - 1, 24).astype(int))
    for lag in lags:
        if float(np.mean(draws[:-lag] * draws[lag:])) < power / np.e:
            return 2.0 * step * float(lag)
    return 2.0 * step * float(lags[-1])


def fit_windows(context: Context, horizon: float, fine: bool) -> tuple[WindowFit, ...]:
    """Every window of the row replayed and aligned; `fine` samples finely, for the result's own tables."""
    row, motion = context.grid.row, context.motion
    windows = cut_windows(motion, row, horizon)
    parts = [on_grid.parts_of(context.grid, w, motion) for w in windows]
    drive = drive_of(motion, row, context.settings)
    drive = drive if fine else coarse(drive)
    nominal = nominal_run(context, drive, windows)
    start = residuals(nominal, parts, context)
    slopes = sensitivities(context, drive, windows, parts)
    found = [_aligned(context, w, p, r, j) for w, p, r, j in zip(windows, parts, start, slopes, strict=True)]
    final, bounded = _moved(context, drive, windows, parts, nominal, start, slopes, found)
    return tuple(
        WindowFit(
            window=w,
            parts=parts[i],
            valid=on_grid.stacked_valid(parts[i]),
            sensitivity=slopes[i],
            alignment=found[i],
            start=start[i],
            bounded=bounded[i],
            free=_free(context, w, parts[i], start[i], slopes[i]),
            null=_null(context, w, parts[i], slopes[i]),
            run=final,
            index=i,
        )
        for i, w in enumerate(windows)
    )


def coarse(drive: Drive) -> Drive:
    """The same drive sampled and stepped more coarsely: errors stay under 0.1 mm."""
    return replace(drive, spacing=COARSE_SPACING, settings=replace(drive.settings, step=COARSE_STEP))


def nominal_run(context: Context, drive: Drive, windows: Sequence[Window]) -> BatchRun:
    """The windows' runs from the smoothed states, nothing moved."""
    if context.trailed:
        return trailed_run(context, drive, windows, context.machine)
    initial = initial_states(context.motion, windows)
    return run_windows(context.machine, drive, context.motion, windows, initial)


def trailed_run(
    context: Context,
    drive: Drive,
    windows: Sequence[Window],
    machines: Machine | Sequence[Machine],
    yaw: Floats | float = 0.0,
    rate: Floats | float = 0.0,
) -> BatchRun:
    """The seeder behind the measured tractor; yaw, rate : rad, rad/s added to the seeder's start."""
    motion, one, two = context.motion, context.motion.tractor, context.motion.seeder
    assert two is not None  # a trailed comparison is made for a pass with a seeder only
    part = driven_samples(motion, context.grid.row)
    series = (one.x, one.y, one.yaw, one.v, one.v_lateral, one.yaw_rate)
    tractor = imposed_from_body(motion.t[part] - drive.t0, *(values[part] for values in series))
    at = [w.start for w in windows]
    longest = max(w.stop - w.start for w in windows) * float(np.median(np.diff(motion.t)))
    return simulate_trailed_batch(
        machines,
        tractor,
        two.yaw[at] + yaw,
        two.yaw_rate[at] + rate,
        int(np.ceil((longest + OVERRUN) / drive.spacing)) + 1,
        drive.spacing,
        start=motion.t[at] - drive.t0,
        settings=drive.settings,
    )


def residuals(run: BatchRun, parts: Sequence[tuple[Part, ...]], context: Context) -> list[Floats]:
    """Simulated − measured of each window, stacked."""
    row = context.grid.row
    return [stacked_simulated(p, row, run, i) - on_grid.stacked_measured(p) for i, p in enumerate(parts)]


def rigid_sensitivity(window: Window, parts: Sequence[Part]) -> Floats:
    """(N, 2) of deviation and yaw to a lateral offset (1, 0) and to a heading about the start (s − s₀, 1).

    The equations of motion do not know where North is, so these two are exact to first order.
    """
    columns = []
    for part in parts:
        size = part.last - part.first
        columns.append(np.column_stack((np.ones(size), part.s - window.origin)))
        columns.append(np.column_stack((np.zeros(size), np.ones(size))))
    return np.concatenate(columns)


def sensitivities(
    context: Context,
    drive: Drive,
    windows: Sequence[Window],
    parts: Sequence[tuple[Part, ...]],
) -> list[Floats]:
    """(N, 3) of each window to θ, the steering offset's by a central difference; (N, 2) without a tractor
    model."""
    rigid = [rigid_sensitivity(w, p) for w, p in zip(windows, parts, strict=True)]
    if context.trailed:
        return rigid
    initial = initial_states(context.motion, windows)
    left, right = (
        run_windows(context.machine, drive, context.motion, windows, initial, steer_offset=step)
        for step in (STEER_STEP, -STEER_STEP)
    )
    row = context.grid.row
    slopes = []
    for i, part in enumerate(parts):
        change = stacked_simulated(part, row, left, i) - stacked_simulated(part, row, right, i)
        slopes.append(np.column_stack((rigid[i], change / (2.0 * STEER_STEP))))
    return slopes


def weights_of(context: Context, window: Window, parts: Sequence[Part]) -> Floats:
    """(N,) 1/S with S = variance of the measuring error × correlation length / grid step; 0 where masked.

    A correlation length beyond the window counts as the window's: a window holds at least one
    independent value.
    """
    weights = on_grid.stacked_valid(parts).astype(np.float64)
    for i, (_, place) in enumerate(on_grid.slices(parts)):
        size = max(place.stop - place.start, 1)
        spread = min(max(context.correlation[i] / context.grid.step, 1.0), size)
        weights[place] /= context.variance[i] * spread
    return weights


def _prior(context: Context, window: Window) -> Floats:
    prior = window_prior(context.motion, window, context.grid.row, context.settings)
    return prior[:2, :2] if context.trailed else prior


def _aligned(
    context: Context, window: Window, parts: Sequence[Part], residual: Floats, slope: Floats
) -> Alignment:
    return align(residual, slope, weights_of(context, window, parts), _prior(context, window))


def _moved(
    context: Context,
    drive: Drive,
    windows: Sequence[Window],
    parts: Sequence[tuple[Part, ...]],
    nominal: BatchRun,
    start: Sequence[Floats],
    slopes: Sequence[Floats],
    found: Sequence[Alignment],
) -> tuple[BatchRun, list[Floats]]:
    """The runs again with the aligned start and steering, and their residuals; rigidly moved when trailed."""
    theta = np.array([a.theta for a in found])
    if context.trailed:
        return nominal, [r + j @ t for r, j, t in zip(start, slopes, theta, strict=True)]
    initial = shifted(context.motion, windows, context.grid.row, theta[:, OFFSET], theta[:, HEADING])
    run = run_windows(context.machine, drive, context.motion, windows, initial, steer_offset=theta[:, STEER])
    return run, residuals(run, parts, context)


def _free(context: Context, window: Window, parts: Sequence[Part], residual: Floats, slope: Floats) -> Floats:
    rigid = slope[:, [OFFSET, HEADING]]
    return np.asarray(
        residual + rigid @ align_freely(residual, rigid, weights_of(context, window, parts)).theta
    )


def _null(context: Context, window: Window, parts: Sequence[Part], slope: Floats) -> Floats:
    """Residual of the straight line, aligned like the model."""
    residual = straight_line(context, window, parts) - on_grid.stacked_measured(parts)
    moved = align(residual, slope, weights_of(context, window, parts), _prior(context, window))
    return np.asarray(residual + slope @ moved.theta)


def straight_line(context: Context, window: Window, parts: Sequence[Part]) -> Floats:
    """(N,) the null model: from its smoothed place each body goes straight on along its own smoothed yaw."""
    columns = []
    for part in parts:
        moving = context.motion.bodies[part.grid.body - 1]
        at = slice(window.start, window.start + 1)
        s, n = context.grid.row.line.project(moving.x[at], moving.y[at])
        yaw = float(moving.yaw[window.start]) - part.grid.yaw_reference
        columns += [n[0] + np.tan(yaw) * (part.s - s[0]), np.full(part.s.size, yaw)]
    return np.concatenate(columns)
