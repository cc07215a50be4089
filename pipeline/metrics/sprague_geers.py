"""Sprague and Geers' magnitude, phase and comprehensive error."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def sprague_geers(pair: Pair) -> Values:
    """M = √(Σc²/Σm²) − 1, P = arccos(Σmc / √(Σm²Σc²)) / π, C = √(M² + P²).

    The square root in M matters: without it a model 20 % too large reads 44 %.
    """
    mm, cc = float(np.sum(pair.measured**2)), float(np.sum(pair.simulated**2))
    mc = float(np.sum(pair.measured * pair.simulated))
    magnitude = float(np.sqrt(ratio(cc, mm))) - 1.0
    phase = float(np.arccos(np.clip(ratio(mc, float(np.sqrt(mm * cc))), -1.0, 1.0))) / np.pi
    return {"magnitude": magnitude, "phase": phase, "comprehensive": float(np.hypot(magnitude, phase))}


METRIC = Metric("sprague_geers", "Sprague–Geers M, P, C", "1", 0.0, "Sprague and Geers 2004", sprague_geers)
