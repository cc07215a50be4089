"""Root mean square error, and its parts."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values


def rmse(pair: Pair) -> Values:
    """√mean(e²), with the mean error, the largest |e| and e's 95th percentile of magnitude."""
    error = pair.error
    return {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "bias": float(np.mean(error)),
        "max_abs": float(np.abs(error).max()),
        "p95_abs": float(np.quantile(np.abs(error), 0.95)),
    }


METRIC = Metric("rmse", "Root mean square error", "same", 0.0, "definition", rmse)
