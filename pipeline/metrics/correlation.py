"""Pearson's correlation and Lin's concordance."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def correlation(pair: Pair) -> Values:
    """r = cov(m, c)/(σm·σc); concordance 2·cov/(σm² + σc² + (mean m − mean c)²), which also sees scale
    and offset."""
    m, c = pair.measured, pair.simulated
    covariance = float(np.mean((m - m.mean()) * (c - c.mean())))
    spread = float(np.var(m) + np.var(c) + (m.mean() - c.mean()) ** 2)
    return {
        "pearson": ratio(covariance, float(np.std(m) * np.std(c))),
        "concordance": ratio(2.0 * covariance, spread),
    }


METRIC = Metric("correlation", "Correlation and concordance", "1", 1.0, "Pearson; Lin 1989", correlation)
