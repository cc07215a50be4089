"""What a companion metric is: two equally spaced signals in, named numbers out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Pair:
    """One channel of one row on the common grid.

    measured, simulated : (N,) same unit, finite, at the same chainages
    step : m, distance between neighbouring points
    speed : m/s, mean speed along the row
    """

    measured: Floats
    simulated: Floats
    step: float
    speed: float

    def __post_init__(self) -> None:
        if self.measured.shape != self.simulated.shape or self.measured.ndim != 1:
            raise ValueError("measured and simulated must be one-dimensional and equally long")
        if self.measured.size < 2:
            raise ValueError("a metric needs at least two points")
        if not (np.isfinite(self.measured).all() and np.isfinite(self.simulated).all()):
            raise ValueError("measured and simulated must be finite: mask gaps before")
        if not (self.step > 0.0 and self.speed > 0.0):
            raise ValueError("step and speed must be positive")

    @property
    def error(self) -> Floats:
        """Simulated less measured."""
        return self.simulated - self.measured


@dataclass(frozen=True)
class Metric:
    """One file of the shelf: what it computes, in what unit, where it comes from.

    unit is "same" (that of the signals), "%" or "1"; `compute` returns NaN where the metric is undefined
    (a constant signal has no correlation).
    """

    key: str
    title: str
    unit: str
    perfect: float
    source: str
    compute: Callable[[Pair], Values]


def ratio(numerator: float, denominator: float) -> float:
    """numerator / denominator, NaN where the denominator is zero or not a number."""
    return numerator / denominator if abs(denominator) > 0.0 else float("nan")
