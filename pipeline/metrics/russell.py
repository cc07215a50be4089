"""Russell's magnitude, phase and comprehensive error."""

from __future__ import annotations

import numpy as np

from ._base import Metric, Pair, Values, ratio


def russell(pair: Pair) -> Values:
    """m = (Σc² − Σm²)/√(Σm²Σc²), M = sign(m)·log10(1 + |m|), P = arccos(Σmc/√(Σm²Σc²))/π, C = √(π/4·(M²
    + P²))."""
    mm, cc = float(np.sum(pair.measured**2)), float(np.sum(pair.simulated**2))
    mc = float(np.sum(pair.measured * pair.simulated))
    root = float(np.sqrt(mm * cc))
    relative = ratio(cc - mm, root)
    magnitude = float(np.sign(relative) * np.log10(1.0 + abs(relative)))
    phase = float(np.arccos(np.clip(ratio(mc, root), -1.0, 1.0))) / np.pi
    comprehensive = float(np.sqrt(np.pi / 4.0 * (magnitude**2 + phase**2)))
    return {"magnitude": magnitude, "phase": phase, "comprehensive": comprehensive}


METRIC = Metric("russell", "Russell M, P, C", "1", 0.0, "Russell 1997", russell)
