"""Signed error of the oscillation's range: the figure closest to the paper's own tables."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def range_error(pair: Pair) -> Values:
    """100·(range of simulated − range of measured) / range of measured, also for Q97.5 − Q2.5 (percent)."""
    measured, simulated = float(np.ptp(pair.measured)), float(np.ptp(pair.simulated))
    low, high = np.quantile(pair.measured, [0.025, 0.975])
    low_s, high_s = np.quantile(pair.simulated, [0.025, 0.975])
    inner, inner_s = float(high - low), float(high_s - low_s)
    return {
        "range": 100.0 * ratio(simulated - measured, measured),
        "r95": 100.0 * ratio(inner_s - inner, inner),
    }


METRIC = Metric("range_error", "Relative range error (signed)", "%", 0.0, "definition", range_error)
