"""Nash and Sutcliffe's model efficiency."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def nse(pair: Pair) -> Values:
    """1 − Σe² / Σ(m − mean m)²: one is perfect, zero is no better than the mean."""
    spread = float(np.sum((pair.measured - pair.measured.mean()) ** 2))
    return {"nse": 1.0 - ratio(float(np.sum(pair.error**2)), spread)}


METRIC = Metric("nse", "Nash–Sutcliffe efficiency", "1", 1.0, "Nash and Sutcliffe 1970", nse)
