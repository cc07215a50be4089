"""The field's traditional tests, reported and never deciding: Cochran's C and Fisher's F.

Cochran's C asks whether the repeats' variances are equal, Fisher's F whether the model's misfit exceeds
the repeats'
scatter. Fisher's test rewards sloppy repeats: the larger their scatter, the easier a wrong model passes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as fisher

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TestResult:
    """A statistic beside its critical value; `holds`: the hypothesis of equality is not rejected."""

    statistic: float
    critical: float
    holds: bool
    groups: int
    repeats: int


def cochran_critical(groups: int, repeats: int, alpha: float = 0.05) -> float:
    """Critical C of `groups` variances of `repeats` values each: 1 / (1 + (k − 1)/F), F at 1 − α/k with
    n − 1 and (k − 1)(n − 1) degrees of freedom (Cochran 1941; 't Lam 2010)."""
    if groups < 2 or repeats < 2:
        raise ValueError("Cochran's test needs two or more groups of two or more repeats")
    quantile = float(fisher.ppf(1.0 - alpha / groups, repeats - 1, (groups - 1) * (repeats - 1)))
    return 1.0 / (1.0 + (groups - 1) / quantile)


def cochran(variances: Sequence[float] | Floats, repeats: int, alpha: float = 0.05) -> TestResult:
    """C = max s² / Σ s² of the groups' variances against its critical value."""
    values = np.asarray(variances, dtype=np.float64)
    total = float(values.sum())
    statistic = float(values.max()) / total if total > 0.0 else float("nan")
    critical = cochran_critical(values.size, repeats, alpha)
    return TestResult(statistic, critical, bool(statistic <= critical), values.size, repeats)


def fisher_adequacy(measured: Floats, simulated: Floats, fitted: int = 0, alpha: float = 0.05) -> TestResult:
    """F = s²_ad / s²_y of stations (k, n) measured in n repeats against the model's means (k, n).

    s²_ad = n·Σ (ȳ_i − ŷ_i)² / (k − d) with d fitted parameters, s²_y the mean of the stations'
    variances; adequate
    in this test's sense while F does not exceed the quantile at k − d and k(n − 1) degrees of freedom.
    """
    stations, repeats = measured.shape
    if repeats < 2 or not stations > fitted:
        raise ValueError("Fisher's test needs two or more repeats, and more stations than fitted parameters")
    misfit = float(np.sum((measured.mean(axis=1) - simulated.mean(axis=1)) ** 2))
    s2_ad = repeats * misfit / (stations - fitted)
    s2_y = float(np.mean(np.var(measured, axis=1, ddof=1)))
    statistic = s2_ad / s2_y if s2_y > 0.0 else float("inf")
    critical = float(fisher.ppf(1.0 - alpha, stations - fitted, stations * (repeats - 1)))
    return TestResult(statistic, critical, bool(statistic <= critical), stations, repeats)


def correlation_length(signal: Floats, step: float) -> float:
    """The first distance at which a signal's autocorrelation falls to 1/e, m."""
    centred = signal - signal.mean()
    power = float(centred @ centred)
    if not power > 0.0:
        return step
    for lag in range(1, signal.size):
        if float(centred[:-lag] @ centred[lag:]) < power / np.e:
            return lag * step
    return step * signal.size


@dataclass(frozen=True)
class Track:
    """One pass's response along its first compared row: s from the row's begin (m), measured, simulated
    (N,)."""

    s: Floats
    measured: Floats
    simulated: Floats


def station_values(tracks: Sequence[Track]) -> tuple[Floats, Floats]:
    """Measured and simulated values (k, n) of n passes at stations a correlation length or more apart."""
    step = float(np.median(np.diff(tracks[0].s)))
    apart = max(correlation_length(t.measured, step) for t in tracks)
    last = min(float(t.s[-1] - t.s[0]) for t in tracks)
    stations = np.arange(0.0, last, max(apart, step))
    measured = [np.interp(stations, t.s - t.s[0], t.measured) for t in tracks]
    simulated = [np.interp(stations, t.s - t.s[0], t.simulated) for t in tracks]
    return np.column_stack(measured), np.column_stack(simulated)


def of_cell(tracks: Sequence[Track], alpha: float = 0.05) -> Mapping[str, TestResult] | None:
    """Both tests for one cell's repeats; None with fewer than two passes or stations."""
    if len(tracks) < 2:
        return None
    measured, simulated = station_values(tracks)
    if measured.shape[0] < 2:
        return None
    variances = np.var(measured, axis=1, ddof=1)
    return {
        "cochran": cochran(variances, len(tracks), alpha),
        "fisher": fisher_adequacy(measured, simulated, 0, alpha),
    }
