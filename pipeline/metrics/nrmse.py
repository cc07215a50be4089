"""Discrepancies normalised by range, maximum and rms of the measured signal."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def nrmse(pair: Pair) -> Values:
    """100·rmse over the measured signal's range, greatest magnitude and rms (percent).

    The range grows with the record's length, so these are companions, never the headline.
    """
    rmse = 100.0 * float(np.sqrt(np.mean(pair.error**2)))
    measured = pair.measured
    return {
        "by_range": ratio(rmse, float(np.ptp(measured))),
        "by_max": ratio(rmse, float(np.abs(measured).max())),
        "by_rms": ratio(rmse, float(np.sqrt(np.mean(measured**2)))),
    }


METRIC = Metric("nrmse", "Discrepancy by range, maximum and rms", "%", 0.0, "definition", nrmse)
