"""Cross-track statistics in the manner of ISO 12188-2, of both signals."""

from __future__ import annotations

import numpy as np

from ._base import Floats, Metric, Pair, Values


def cross_track(pair: Pair) -> Values:
    """Mean, sd, rms and 95th percentile of |deviation from the line|, for the measured and the simulated
    signal.

    ISO 12188-2 reports these for a steering system's relative cross-track error; here they describe how
    straight
    each signal is, so that a model that is merely calm can be told from one that is right.
    """
    values = {f"measured_{key}": value for key, value in _statistics(pair.measured).items()}
    return values | {f"simulated_{key}": value for key, value in _statistics(pair.simulated).items()}


def _statistics(deviation: Floats) -> dict[str, float]:
    return {
        "mean": float(np.mean(deviation)),
        "sd": float(np.std(deviation, ddof=1)),
        "rms": float(np.sqrt(np.mean(deviation**2))),
        "p95": float(np.quantile(np.abs(deviation), 0.95)),
    }


METRIC = Metric(
    "cross_track",
    "Cross-track statistics (ISO 12188 style)",
    "same",
    float("nan"),
    "ISO 12188-2:2012, style",
    cross_track,
)
