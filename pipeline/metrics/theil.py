"""Theil's inequality coefficient U1."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def theil(pair: Pair) -> Values:
    """U1 = rms(e) / (rms(m) + rms(c)): zero is perfect, one the worst."""
    rms_sum = float(np.sqrt(np.mean(pair.measured**2)) + np.sqrt(np.mean(pair.simulated**2)))
    return {"u1": ratio(float(np.sqrt(np.mean(pair.error**2))), rms_sum)}


METRIC = Metric("theil", "Theil's U1", "1", 0.0, "Theil 1961", theil)
