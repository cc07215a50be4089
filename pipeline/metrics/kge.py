"""Kling and Gupta's efficiency."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def kge(pair: Pair) -> Values:
    """1 − √((r − 1)² + (α − 1)² + (β − 1)²), r correlation, α = sd ratio, β = mean ratio.

    β divides by the measured mean, which is near zero for a deviation from a line: `kge` is the
    published form,
    `kge_centred` leaves β out (both signals centred) and is the one to read here.
    """
    m, c = pair.measured, pair.simulated
    sd_m, sd_c = float(np.std(m)), float(np.std(c))
    r = ratio(float(np.mean((m - m.mean()) * (c - c.mean()))), sd_m * sd_c)
    alpha, beta = ratio(sd_c, sd_m), ratio(float(c.mean()), float(m.mean()))
    return {
        "kge": 1.0 - float(np.sqrt((r - 1.0) ** 2 + (alpha - 1.0) ** 2 + (beta - 1.0) ** 2)),
        "kge_centred": 1.0 - float(np.hypot(r - 1.0, alpha - 1.0)),
        "alpha": alpha,
        "beta": beta,
    }


METRIC = Metric("kge", "Kling–Gupta efficiency", "1", 1.0, "Gupta et al. 2009", kge)
