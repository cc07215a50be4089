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
    steering_prior_variance,
    window_prior,
)  # fmt: skip
from .replay_settings import ReplaySettings

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

OFFSET, HEADING, STEER = 0, 1, 2  # of the alignment's θ
STEER_STEP = float(np.deg2rad(0.1))  # of the finite difference for the steering offset
ROUNDS = 4  # of Gauss–Newton after the first, linear step
STEP_LEFT = 0.1  # standard deviations of θ: a step under this is left undone
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

    chi2 : of the alignment before its prior was raised, see `chi2_of_row`
    about : θ where the sensitivity was taken: nothing, or where one linear step did not get far enough
    start : residual with the state from the smoother and nothing moved; bounded : after the bounded
    alignment (run
    again with the aligned start and steering); free : with offset and heading fitted without a prior
    null : residual of the straight line after the same bounded alignment; run, index : where its motion lies
    """

    window: Window
    parts: tuple[Part, ...]
    valid: Mask
    about: Floats
    sensitivity: Floats
    alignment: Alignment
    chi2: float
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
    stands, final = _settled(context, drive, windows, parts, nominal, start)
    chi2 = chi2_of_row(context, stands)
    return tuple(
        WindowFit(
            window=w,
            parts=parts[i],
            valid=on_grid.stacked_valid(parts[i]),
            about=stands[i].about,
            sensitivity=stands[i].slope,
            alignment=stands[i].alignment,
            chi2=chi2[i],
            start=start[i],
            bounded=stands[i].residual,
            free=_free(context, w, parts[i], start[i], stands[i].slope),
            null=_null(context, w, parts[i], stands[i].slope),
            run=final,
            index=i,
        )
        for i, w in enumerate(windows)
    )


@dataclass(frozen=True)
class Stand:
    """Where one window's alignment stands.

    slope : (N, P) sensitivity at θ = `about`, whose own run left `base` (N,); alignment : the answer to
    it; residual : (N,) of the run with that answer; weights, prior : of the stated sum
    """

    about: Floats
    base: Floats
    slope: Floats
    alignment: Alignment
    residual: Floats
    weights: Floats
    prior: Floats


def _settled(
    context: Context,
    drive: Drive,
    windows: Sequence[Window],
    parts: Sequence[tuple[Part, ...]],
    nominal: BatchRun,
    start: Sequence[Floats],
) -> tuple[list[Stand], BatchRun]:
    """Each window aligned, by Gauss–Newton where one linear step is not enough, and the runs as aligned.

    A window whose run agrees with its linear forecast to a tenth of θ's standard deviations stays as the
    first step left it.
    """
    nothing = np.zeros((len(windows), 2 if context.trailed else 3))
    slopes = sensitivities(context, drive, windows, parts, nothing)
    weights = [weights_of(context, w, p) for w, p in zip(windows, parts, strict=True)]
    priors = [_prior(context, w) for w in windows]
    found = [align(*given) for given in zip(start, slopes, weights, priors, strict=True)]
    final, bounded = _moved(context, drive, windows, parts, nominal, start, slopes, found)
    stands = [
        Stand(*given) for given in zip(nothing, start, slopes, found, bounded, weights, priors, strict=True)
    ]
    for _ in range(ROUNDS):
        far = [not context.trailed and step_left(s) > STEP_LEFT for s in stands]
        if not any(far):
            break
        slopes = sensitivities(context, drive, windows, parts, np.stack([s.alignment.theta for s in stands]))
        stands = [_again(s, j) if f else s for s, j, f in zip(stands, slopes, far, strict=True)]
        final, bounded = _moved(
            context, drive, windows, parts, nominal, start, slopes, [s.alignment for s in stands]
        )
        stands = [replace(s, residual=r) for s, r in zip(stands, bounded, strict=True)]
    return stands, final


def step_left(stand: Stand) -> float:
    """How far θ would still move, in its standard deviations, by what the run differs from its linear forecast."""
    theta = stand.alignment.theta
    missed = stand.residual - stand.base - stand.slope @ (theta - stand.about)
    step = stand.alignment.gain @ missed
    return float(np.sqrt(max(float(step @ ((stand.slope.T * stand.weights) @ missed)), 0.0)))


def _again(stand: Stand, slope: Floats) -> Stand:
    """The next Gauss–Newton step, from a `slope` taken at the present θ; half the last step again where
    that made the sum larger."""
    theta = stand.alignment.theta
    if _sum(stand, stand.residual, theta) > _sum(stand, stand.base, stand.about):
        halved = 0.5 * (stand.about + theta)
        chi2 = float(halved @ np.linalg.solve(stand.prior, halved))
        return replace(stand, alignment=replace(stand.alignment, theta=halved, chi2=chi2))
    # Linear in θ about the present one, but with the prior where it always was: about nothing moved.
    forecast = stand.residual - slope @ theta
    found = align(forecast, slope, stand.weights, stand.prior)
    return replace(stand, about=theta, base=stand.residual, slope=slope, alignment=found)


def _sum(stand: Stand, residual: Floats, theta: Floats) -> float:
    """The sum that the alignment makes small: Σ rᵀS⁻¹r + θᵀP₀⁻¹θ."""
    return float(stand.weights @ residual**2 + theta @ np.linalg.solve(stand.prior, theta))


def chi2_of_row(context: Context, stands: Sequence[Stand]) -> list[float]:
    """Each window's χ² before its prior was raised: about nothing moved, or about the row's own steering
    zero where that is larger.

    A zero is one for a row, so about it (mean of the windows', weighted) a window may move by the slow
    steering error alone. Else a zero stated with a large doubt would let every window choose its own.
    """
    own = [s.alignment.chi2_free for s in stands]
    steer = context.motion.steer_input
    if steer is None or len(stands) < 2:
        return own
    slow = steering_prior_variance(steer, context.settings) - steer.zero_sd**2
    found = np.array([s.alignment.theta[STEER] for s in stands])
    spread = np.array([slow + _variance(s)[STEER, STEER] for s in stands])
    variance = 1.0 / float(np.sum(1.0 / spread))
    zero = np.array([0.0, 0.0, variance * float(np.sum(found / spread))])
    about = []
    for stand in stands:
        prior = stand.prior.copy()
        prior[STEER, STEER] += variance - steer.zero_sd**2
        residual = stand.residual + stand.slope @ (zero - stand.alignment.theta)
        about.append(align(residual, stand.slope, stand.weights, prior).chi2_free)
    return [max(pair) for pair in zip(own, about, strict=True)]


def _variance(stand: Stand) -> Floats:
    """(P, P) covariance that θ is known with."""
    information = (stand.slope.T * stand.weights) @ stand.slope
    return np.asarray(np.linalg.inv(information + stand.alignment.weight * np.linalg.inv(stand.prior)))


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
    about: Floats,
) -> list[Floats]:
    """(N, 3) of each window to θ at θ = about (W, 3), the steering offset's by a central difference; (N, 2)
    without a tractor model."""
    rigid = [rigid_sensitivity(w, p) for w, p in zip(windows, parts, strict=True)]
    if context.trailed:
        return rigid
    initial = shifted(context.motion, windows, context.grid.row, about[:, OFFSET], about[:, HEADING])
    left, right = (
        run_windows(
            context.machine, drive, context.motion, windows, initial, steer_offset=about[:, STEER] + step
        )
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
