"""Objective rating of ISO/TS 18571:2024: corridor, phase, magnitude and slope, weighted to R."""

from __future__ import annotations

import numpy as np

from ._base import Floats, Metric, Pair, Values

INNER, OUTER = 0.05, 0.50  # corridors, of the reference's greatest magnitude
CORRIDOR_POWER = 2.0
LARGEST_SHIFT = 0.2  # of the record's length
WARP_BAND = 0.1  # of the record's length
MAGNITUDE_LIMIT, SLOPE_LIMIT = 0.5, 2.0
SMOOTHED_OVER = 9  # samples


def iso18571(pair: Pair) -> Values:
    """R = 0.4·Z + 0.2·(EP + EM + ES), with the measured signal as reference. One is perfect.

    The standard samples at 10 kHz for crash pulses; only sample counts enter, so the grid's 0.2 m takes
    the place
    of 0.1 ms: slopes are smoothed over 9 points, that is 1.8 m.
    """
    if not (np.ptp(pair.measured) > 0.0 and np.ptp(pair.simulated) > 0.0 and pair.measured.size >= 20):
        return dict.fromkeys(("r", "corridor", "phase", "magnitude", "slope"), float("nan"))
    corridor = corridor_score(pair.measured, pair.simulated)
    phase, measured, simulated = phase_score(pair.measured, pair.simulated)
    magnitude = magnitude_score(measured, simulated)
    slope = slope_score(measured, simulated)
    total = 0.4 * corridor + 0.2 * (phase + magnitude + slope)
    return {"r": total, "corridor": corridor, "phase": phase, "magnitude": magnitude, "slope": slope}


def corridor_score(reference: Floats, compared: Floats) -> float:
    """Mean of 1 inside the inner corridor, 0 outside the outer, ((δo − |c − t|)/(δo − δi))² between."""
    norm = float(np.abs(reference).max())
    share = (OUTER * norm - np.abs(compared - reference)) / ((OUTER - INNER) * norm)
    return float(np.mean(np.clip(share, 0.0, 1.0) ** CORRIDOR_POWER))


def phase_score(reference: Floats, compared: Floats) -> tuple[float, Floats, Floats]:
    """(m − n)/m for the shift n ≤ m of greatest correlation, and both signals cut to their overlap at
    that shift."""
    count = reference.size
    largest = int(LARGEST_SHIFT * count)
    shifts = sorted(range(-largest, largest + 1), key=abs)
    best = max(shifts, key=lambda shift: _correlation(*_overlap(reference, compared, shift)))
    cut = _overlap(reference, compared, best)
    return (largest - abs(best)) / largest, cut[0], cut[1]


def _overlap(reference: Floats, compared: Floats, shift: int) -> tuple[Floats, Floats]:
    count = reference.size
    if shift >= 0:
        return reference[: count - shift], compared[shift:]
    return reference[-shift:], compared[: count + shift]


def _correlation(a: Floats, b: Floats) -> float:
    a, b = a - a.mean(), b - b.mean()
    return float(a @ b) / max(float(np.sqrt((a @ a) * (b @ b))), 1e-300)


def magnitude_score(reference: Floats, compared: Floats) -> float:
    """(0.5 − ε)/0.5 with ε = Σ|c − t| / Σ|t| along the warped path, not under zero."""
    from ._warping import warped  # late: reports name this metric and have no need of the compiler

    compared, reference = warped(compared, reference, int(np.ceil(WARP_BAND * reference.size)) - 1)
    error = float(np.abs(compared - reference).sum()) / float(np.abs(reference).sum())
    return max(0.0, (MAGNITUDE_LIMIT - error) / MAGNITUDE_LIMIT)


def slope_score(reference: Floats, compared: Floats) -> float:
    """(2 − ε)/2 with ε = Σ|c' − t'| / Σ|t'| of the smoothed slopes, not under zero."""
    slope, wanted = _smoothed(np.gradient(compared)), _smoothed(np.gradient(reference))
    error = float(np.abs(slope - wanted).sum() / np.abs(wanted).sum())
    return max(0.0, (SLOPE_LIMIT - error) / SLOPE_LIMIT)


def _smoothed(signal: Floats) -> Floats:
    """Mean over 9 points; nearer the ends over as many as fit symmetrically."""
    sums = np.concatenate(([0.0], np.cumsum(signal)))
    index = np.arange(signal.size)
    half = np.minimum(SMOOTHED_OVER // 2, np.minimum(index, signal.size - 1 - index))
    return np.asarray((sums[index + half + 1] - sums[index - half]) / (2 * half + 1), dtype=np.float64)


METRIC = Metric("iso18571", "ISO/TS 18571 rating", "1", 1.0, "ISO/TS 18571:2024", iso18571)
