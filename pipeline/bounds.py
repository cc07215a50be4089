"""Bounds of the discrepancy: from each pass's numbers to D with its upper and lower bound.

The pass is the unit, because samples along a pass are autocorrelated. For one response (a body's deviation or
yaw) l = ½·ln M, with M the mean square of simulated − measured over one pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Floats = NDArray[np.float64]

DEVIATION1, DEVIATION2, YAW1, YAW2 = "deviation1", "deviation2", "yaw1", "yaw2"
RESPONSES = (DEVIATION1, DEVIATION2, YAW1, YAW2)
LEAST_RANGE = {  # m, rad
    DEVIATION1: 0.02,
    DEVIATION2: 0.02,
    YAW1: float(np.deg2rad(0.3)),
    YAW2: float(np.deg2rad(0.3)),
}
LEAST_RANGE_IN_U = 4.0
NORMAL_R95 = 3.92  # Q97.5 − Q2.5 of a normal variate, in standard deviations
R95_LOG_VARIANCE = 0.905  # n·var(ln R95) of n independent normal values, by the quantiles' asymptotic law
LARGEST_POWER = 700.0  # of e in a double
GUARDS = {True: (0.8, 1.25), False: (0.5, 2.0)}  # factors on u² when the filter's consistency holds, or not


@dataclass(frozen=True)
class ResponseStatistics:
    """One response of one pass, in m or rad.

    mse : M, mean of (simulated − measured)² over the pass's windows; null_mse : the same of the straight line
    r95 : Q97.5 − Q2.5 of the measured deviation, the rows centred
    u2 : variance that measuring error leaves in the residual after alignment
    u2_range : variance of the centred measured deviation's own error (it widens r95)
    u2_absolute : variance of the measured deviation's (yaw's) error, nothing centred: whether a swing
    can be seen
    u2_input : variance of the residual from steering, start and stated parameters, after the same alignment
    n_eff, n_eff_range : effective number of independent samples in the residual and in the deviation
    deviation : (N,) the measured deviation, the rows centred, to pool over a cell's passes
    """

    mse: float
    null_mse: float
    r95: float
    u2: float
    u2_range: float
    u2_absolute: float
    u2_input: float
    n_eff: float
    n_eff_range: float
    deviation: Floats = field(default_factory=lambda: np.empty(0), repr=False)


@dataclass(frozen=True)
class PassStatistics:
    """All that the verdict needs of one pass.

    windows_within : share of windows whose alignment χ², before its prior was raised, is within the bound
    consistent : whether the filter's own tests hold; tractor_testable : whether an independent steering
    series exists
    """

    run: str
    field: str
    direction: str
    repeat: int
    variant: str
    responses: Mapping[str, ResponseStatistics]
    windows_within: float
    consistent: bool
    tractor_testable: bool

    @property
    def cell(self) -> tuple[str, str]:
        """Field and direction: within a cell the passes are repeats."""
        return (self.field, self.direction)


@dataclass(frozen=True)
class Summary:
    """One response over the passes of one version, before any threshold is applied."""

    mean_log: float
    mean_log_null: float
    r95: float
    spread2: float
    spread_floor: float
    dof: int
    count: int
    log_r95_variance: float
    u2: float
    u2_range: float
    u2_absolute: float
    u2_input: float
    consistent: bool


def cell_r95(passes: Sequence[PassStatistics], response: str) -> dict[tuple[str, str], float]:
    """R95 of each cell: quantiles of the passes' centred deviations pooled (a pass without samples gives
    its own)."""
    found = {}
    for cell in dict.fromkeys(p.cell for p in passes):
        members = [p.responses[response] for p in passes if p.cell == cell]
        pooled = np.concatenate([m.deviation for m in members])
        if pooled.size and all(m.deviation.size for m in members):
            low, high = np.quantile(pooled, [0.025, 0.975])
            found[cell] = float(high - low)
        else:
            found[cell] = float(np.exp(np.mean([np.log(m.r95) for m in members])))
    return found


def pooled_spread(values: Floats, cells: Sequence[tuple[str, str]]) -> tuple[Floats, int]:
    """Variance of the values (..., passes) pooled inside cells, (...), and its degrees of freedom Σ(n_cell − 1).

    Without a repeated cell the spread over all passes is taken: it holds the cells' differences too, and so is no
    smaller on average.
    """
    values = np.asarray(values, dtype=np.float64)
    kinds = list(dict.fromkeys(cells))
    inside = np.array([[cell == kind for kind in kinds] for cell in cells], dtype=np.float64)
    if values.shape[-1] == len(kinds):
        inside = np.ones((len(kinds), 1))
    dof = values.shape[-1] - inside.shape[1]
    if dof <= 0:
        return np.zeros(values.shape[:-1]), 0
    means = values @ (inside / inside.sum(axis=0))
    return np.asarray(np.sum((values - means @ inside.T) ** 2, axis=-1) / dof), dof


def summarise(passes: Sequence[PassStatistics], response: str) -> Summary:
    """Means, spread and uncertainties of one response over passes.

    The spread's floor is 1/(2·N_eff), the variance that ½·ln M has within a single stationary pass.
    """
    members = [p.responses[response] for p in passes]
    logs = np.array([0.5 * np.log(max(m.mse, 1e-300)) for m in members])
    spread2, dof = pooled_spread(logs, [p.cell for p in passes])
    floor = float(np.mean([1.0 / (2.0 * max(m.n_eff, 1.0)) for m in members]))
    ranges = cell_r95(passes, response)
    count = len(passes)
    return Summary(
        mean_log=float(logs.mean()),
        mean_log_null=float(np.mean([0.5 * np.log(max(m.null_mse, 1e-300)) for m in members])),
        r95=float(np.exp(np.mean([np.log(ranges[p.cell]) for p in passes]))),
        spread2=max(float(spread2), floor),
        spread_floor=floor,
        dof=dof,
        count=count,
        log_r95_variance=R95_LOG_VARIANCE / max(sum(m.n_eff_range for m in members), 1.0),
        u2=float(np.mean([m.u2 for m in members])),
        u2_range=float(np.mean([m.u2_range for m in members])),
        u2_absolute=float(np.mean([m.u2_absolute for m in members])),
        u2_input=float(np.mean([m.u2_input for m in members])),
        consistent=all(p.consistent for p in passes),
    )


def half_width(summary: Summary, level: float, count: int | None = None, dof: int | None = None) -> float:
    """U = t_{level, ν}·√(s²/n + var ln R95) on the scale of l; infinite without degrees of freedom.

    ν by Welch and Satterthwaite: the spread has its own degrees of freedom, the normaliser's variance those of
    the effective samples that it comes from.
    """
    count = summary.count if count is None else count
    dof = summary.dof if dof is None else dof
    if dof < 1:
        return float("inf")
    between = summary.spread2 / count
    normaliser = summary.log_r95_variance * summary.count / count
    samples = R95_LOG_VARIANCE / normaliser
    effective = (between + normaliser) ** 2 / (between**2 / dof + normaliser**2 / samples)
    return float(stdtrit(effective, level) * np.sqrt(between + normaliser))


def upper(summary: Summary, width: float) -> float:
    """D_hi = √([M_hi − min(g_lo·u², M_hi/2)] / max(R95² − 3.92²·g_hi·u_R², R95²/4)); never subtracts
    u_in². Infinite where the width is: one pass of a campaign knows no spread."""
    power = 2.0 * (summary.mean_log + width)
    if not power < LARGEST_POWER:
        return float("inf")
    low, high = GUARDS[summary.consistent]
    mse = float(np.exp(power))
    range2 = summary.r95**2
    normaliser = max(range2 - NORMAL_R95**2 * high * summary.u2_range, range2 / 4.0)
    return float(np.sqrt((mse - min(low * summary.u2, mse / 2.0)) / normaliser))


def lower(summary: Summary, width: float, with_input: bool = True) -> float:
    """D_lo = √(max(M_lo − g_hi·u² − g_hi·u_in², 0)) / R95."""
    _, high = GUARDS[summary.consistent]
    mse = float(np.exp(2.0 * (summary.mean_log - width)))
    known = high * (summary.u2 + (summary.u2_input if with_input else 0.0))
    return float(np.sqrt(max(mse - known, 0.0))) / summary.r95


def percentage_possible(summary: Summary, response: str) -> bool:
    """Whether R95 is at least 4 standard uncertainties and 2 cm (0.3°).

    The uncertainty is that of the deviation from the line itself, offset included: a receiver of a metre
    cannot tell how straight a row was, however smooth its error is.
    """
    known = max(summary.u2_range, summary.u2_absolute)
    least = max(LEAST_RANGE_IN_U * float(np.sqrt(known)), LEAST_RANGE[response])
    return bool(summary.r95 >= least)
