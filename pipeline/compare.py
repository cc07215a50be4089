"""Two motions on one path frame: the comparison of a pass, down to the numbers that the verdict needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.machine import Machine
from ..sensors.manifest import Manifest
from . import grid as on_grid
from .alignment import bound, remaining
from .bounds import PassStatistics, ResponseStatistics
from .fusion.motion import Motion
from .grid import RowGrid
from .replay_settings import ReplaySettings
from .rows import PassedOver, Row, survey
from .uncertainty import GROUPS, input_changes, measuring_changes
from .window_fit import Context, WindowFit, fit_windows, make_context

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

NONE, START_ONLY, BOUNDED, FREE = "none", "start", "bounded", "free"
ALIGNMENTS = (NONE, START_ONLY, BOUNDED, FREE)  # of the disclosure table
LAG_SHARE = 0.25  # of the record: longer lags of an autocorrelation hold too few pairs


@dataclass(frozen=True)
class RowComparison:
    """One row compared: its grid, its headline windows, and by response arrays on the body's grid.

    simulated, residual : bounded alignment; unaligned : nothing moved, the row in one piece; start,
    free, null : as
    in `WindowFit`; u2, u2_input : variances that measuring error and inputs leave in the residual;
    window : index
    explained : (D,) by response, mean square of draws of measuring error and inputs together
    """

    context: Context
    fits: tuple[WindowFit, ...]
    valid: Mapping[str, Mask]
    measured: Mapping[str, Floats]
    residual: Mapping[str, Floats]
    unaligned: Mapping[str, Floats]
    start: Mapping[str, Floats]
    free: Mapping[str, Floats]
    null: Mapping[str, Floats]
    window: Mapping[str, Floats]
    u2: Mapping[str, Floats]
    u2_input: Mapping[str, Mapping[str, Floats]]
    explained: Mapping[str, Floats]
    horizons: Mapping[float, Mapping[str, Floats]]

    @property
    def grid(self) -> RowGrid:
        """The row's common grid."""
        return self.context.grid

    @property
    def row(self) -> Row:
        """The row."""
        return self.context.grid.row


@dataclass(frozen=True)
class ExcludedRow:
    """A row that was found and not compared, with the reason."""

    row: Row
    reason: str


@dataclass(frozen=True)
class Comparison:
    """A pass compared: its rows, what was left out and why, and the statistics of the pass (None without
    a row).

    trailed : there was no independent steering series, so the measured tractor was imposed and only the
    seeder judged
    """

    rows: tuple[RowComparison, ...]
    excluded: tuple[ExcludedRow, ...]
    passed_over: tuple[PassedOver, ...]
    statistics: PassStatistics | None
    responses: tuple[str, ...]
    trailed: bool
    settings: ReplaySettings
    found: tuple[Row, ...]

    def pooled(self, arrays: str, response: str) -> Floats:
        """Valid points of one of `RowComparison`'s arrays, over all rows."""
        return np.concatenate([getattr(r, arrays)[response][r.valid[response]] for r in self.rows])


def compare(
    motion: Motion,
    machine: Machine,
    manifest: Manifest,
    settings: ReplaySettings = ReplaySettings(),
) -> Comparison:
    """The model replayed over every row of a pass and compared with the smoothed motion.

    Rows with under 95 % coverage are excluded with their reason. Without an independent steering series
    only the
    seeder is compared; without a seeder too, nothing is.
    """
    found = survey(motion, manifest)
    trailed = motion.steer_input is None
    bodies = _bodies(motion, trailed)
    rates = [gps.rate for gps in manifest.of_kind("gps").values()]
    gap = on_grid.longest_gap(rates, settings.longest_gap)
    compared, excluded = [], []
    for row in found.rows:
        reason = _unfit(motion, row, bodies)
        grid = None if reason else on_grid.row_grid(motion, row, bodies, settings.grid_step, gap)
        if grid is not None and not grid.coverage >= settings.least_coverage:
            reason = f"{100.0 * grid.coverage:.1f} % of it lies outside GNSS gaps, 95 % are needed"
        if grid is None or reason:
            excluded.append(ExcludedRow(row, reason))
            continue
        context = make_context(motion, machine, grid, settings, trailed)
        compared.append(compare_row(context, manifest.uncertainty))
    rows = tuple(compared)
    names = rows[0].grid.responses if rows else ()
    statistics = pass_statistics(rows, names, motion, manifest) if rows else None
    return Comparison(
        rows, tuple(excluded), found.passed_over, statistics, names, trailed, settings, found.rows
    )


def _bodies(motion: Motion, trailed: bool) -> tuple[int, ...]:
    if motion.seeder is None:
        return () if trailed else (1,)
    return (2,) if trailed else (1, 2)


def _unfit(motion: Motion, row: Row, bodies: Sequence[int]) -> str:
    """Why a row cannot be replayed at all; empty when it can."""
    if not bodies:
        return "tractor not testable: no independent steering series, and no seeder to judge in its place"
    steer = motion.steer_input
    if steer is not None and not np.isfinite(steer.angle[row.samples]).all():
        return "the steering series has a gap inside it"
    return ""


def compare_row(context: Context, parameters: Mapping[str, float]) -> RowComparison:
    """One row: headline windows with their uncertainty, and the other horizons for disclosure."""
    fits = fit_windows(context, context.settings.horizon, fine=True)
    u2, u2_input, explained = _variances(context, fits, parameters)
    horizons = {h: fit_windows(context, h, fine=False) for h in context.settings.horizons}
    whole = horizons.get(float("inf")) or fit_windows(context, float("inf"), fine=False)
    return RowComparison(
        context=context,
        fits=fits,
        valid=_masks(fits),
        measured=dict(channel for body in context.grid.bodies for channel in body.channels),
        residual=_joined(fits, [f.bounded for f in fits]),
        unaligned=_joined(whole, [f.start for f in whole]),
        start=_joined(fits, [f.start for f in fits]),
        free=_joined(fits, [f.free for f in fits]),
        null=_joined(fits, [f.null for f in fits]),
        window=_joined(fits, [np.full(f.start.size, float(f.window.index)) for f in fits]),
        u2=u2,
        u2_input=u2_input,
        explained=explained,
        horizons={h: _joined(f, [w.bounded for w in f]) for h, f in horizons.items()},
    )


def _joined(fits: Sequence[WindowFit], stacked: Sequence[Floats]) -> dict[str, Floats]:
    """Windows' stacked arrays as one array a response over the whole row."""
    found: dict[str, list[Floats]] = {}
    for fit, values in zip(fits, stacked, strict=True):
        for name, place in on_grid.slices(fit.parts):
            found.setdefault(name, []).append(values[place])
    return {name: np.concatenate(parts) for name, parts in found.items()}


def _masks(fits: Sequence[WindowFit]) -> dict[str, Mask]:
    joined = _joined(fits, [f.valid.astype(np.float64) for f in fits])
    return {name: values > 0.5 for name, values in joined.items()}


def _variances(
    context: Context, fits: Sequence[WindowFit], parameters: Mapping[str, float]
) -> tuple[dict[str, Floats], dict[str, dict[str, Floats]], dict[str, Floats]]:
    """Variances along the row of what measuring error and inputs leave after alignment, and draws of
    their M."""
    inputs = input_changes(context, fits, parameters, context.settings.seed + context.grid.row.index)
    measuring = [remaining(f.alignment, f.sensitivity, measuring_changes(context, f)) for f in fits]
    known = [
        {g: remaining(f.alignment, f.sensitivity, c[g]) for g in GROUPS}
        for f, c in zip(fits, inputs, strict=True)
    ]
    u2 = _joined(fits, [_mean_square(m) for m in measuring])
    u2_input = {g: _joined(fits, [_mean_square(k[g]) for k in known]) for g in GROUPS}
    total = []
    for noise, groups in zip(measuring, known, strict=True):
        both = np.sum([groups[g] for g in GROUPS], axis=0)
        count = min(noise.shape[1], both.shape[1]) or both.shape[1]
        total.append(both[:, :count] + noise[:, :count] if noise.shape[1] else both)
    explained = {name: np.mean(draws**2, axis=0) for name, draws in _joined(fits, total).items()}
    by_response = {name: {g: u2_input[g][name] for g in GROUPS} for name in u2}
    return u2, by_response, explained


def _mean_square(draws: Floats) -> Floats:
    return np.mean(draws**2, axis=1) if draws.shape[1] else np.zeros(draws.shape[0])


def pass_statistics(
    rows: Sequence[RowComparison], names: Sequence[str], motion: Motion, manifest: Manifest
) -> PassStatistics:
    """What the verdict needs of a pass: its rows pooled, every response."""
    free = [f.chi2 <= bound(f.alignment.theta.size) for r in rows for f in r.fits]
    return PassStatistics(
        **run_labels(manifest),
        responses={name: response_statistics(rows, name) for name in names},
        windows_within=float(np.mean(free)),
        consistent=motion.consistent,
        tractor_testable=motion.steer_input is not None,
    )


def run_labels(manifest: Manifest) -> dict[str, Any]:
    """Who a pass is: run, field, direction, repeat, variant."""
    run = manifest.run
    return {
        "run": run.id,
        "field": run.field,
        "direction": run.direction,
        "repeat": run.repeat,
        "variant": run.variant,
    }


def response_statistics(rows: Sequence[RowComparison], name: str) -> ResponseStatistics:
    """One response of a pass: mean squares, R95 and uncertainties over the valid points of its rows."""
    deviations = [centred(r.measured[name][r.valid[name]]) for r in rows]
    deviation = np.concatenate(deviations)
    low, high = np.quantile(deviation, [0.025, 0.975])

    def pooled(pick: str) -> Floats:
        return np.concatenate([getattr(r, pick)[name][r.valid[name]] for r in rows])

    inputs = [sum(r.u2_input[name][g][r.valid[name]] for g in GROUPS) for r in rows]
    return ResponseStatistics(
        mse=float(np.mean(pooled("residual") ** 2)),
        null_mse=float(np.mean(pooled("null") ** 2)),
        r95=float(high - low),
        u2=float(np.mean(pooled("u2"))),
        u2_range=float(np.mean([range_variance(r, name) for r in rows])),
        u2_absolute=float(np.mean([absolute_variance(r, name) for r in rows])),
        u2_input=float(np.mean(np.concatenate(inputs))),
        n_eff=sum(effective_count(r.residual[name][r.valid[name]]) for r in rows),
        n_eff_range=sum(effective_count(d) for d in deviations),
        deviation=deviation,
    )


def centred(values: Floats) -> Floats:
    """The values less their mean."""
    return np.asarray(values - values.mean())


def absolute_variance(row: RowComparison, name: str) -> float:
    """Variance of the error of the measured deviation (or yaw) over one row, nothing centred."""
    return float(row.context.variance[row.grid.responses.index(name)])


def range_variance(row: RowComparison, name: str) -> float:
    """Variance of the error of the centred measured deviation (or yaw) over one row: it widens R95."""
    for body in row.grid.bodies:
        part = on_grid.Part(body, 0, body.s.size)
        for found, place in on_grid.slices((part,)):
            if found == name:
                draws = on_grid.stacked_draws((part,), row.row, row.context.motion)[place]
                return float(np.mean((draws - draws.mean(axis=0)) ** 2)) if draws.shape[1] else 0.0
    raise KeyError(name)


def effective_count(values: Floats) -> float:
    """N / (1 + 2·Σ (1 − k/N)·ρ_k²): independent samples that a mean square is worth (Bartlett).

    For AR(1) with coefficient r this is N·(1 − r²)/(1 + r²).
    """
    count = values.size
    if count < 4 or not float(np.ptp(values)) > 0.0:
        return 1.0
    spectrum = np.abs(np.fft.rfft(values - values.mean(), 2 * count)) ** 2
    lags = max(int(LAG_SHARE * count), 1)
    autocovariance = np.fft.irfft(spectrum)[: lags + 1]
    rho = autocovariance[1:] / autocovariance[0]
    share = 1.0 - np.arange(1, lags + 1) / count
    # An estimated ρ has variance (1 + 2·Σρ²)/N (Bartlett), which its square adds: that much is taken off
    # again.
    ratio = (1.0 + 2.0 * np.sum(share * rho**2)) / (1.0 + 2.0 * np.sum(share) / count)
    return float(np.clip(count / ratio, 1.0, count))


def discrepancies(comparison: Comparison, arrays: str) -> dict[str, float]:
    """D = √M / R95 of each response, M over one of `RowComparison`'s residual arrays, as fractions."""
    statistics = comparison.statistics
    if statistics is None:
        return {}
    return {
        name: float(np.sqrt(np.mean(comparison.pooled(arrays, name) ** 2)) / statistics.responses[name].r95)
        for name in comparison.responses
    }


def horizon_curve(comparison: Comparison) -> dict[float, dict[str, float]]:
    """D of each response against the windows' length (bounded alignment), as fractions."""
    statistics = comparison.statistics
    if statistics is None:
        return {}
    curve: dict[float, dict[str, float]] = {}
    for horizon in comparison.settings.horizons:
        curve[horizon] = {}
        for name in comparison.responses:
            pooled = np.concatenate([r.horizons[horizon][name][r.valid[name]] for r in comparison.rows])
            r95 = statistics.responses[name].r95
            curve[horizon][name] = float(np.sqrt(np.mean(pooled**2)) / r95)
    return curve
