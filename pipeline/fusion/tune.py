"""Levels that the data themselves can tell: the clocks' lag, slips and noise, by the innovations' likelihood.

The forward filter's innovations are independent under the model, so their Gaussian log-likelihood (Schweppe
1965) is the likelihood of the levels. Coordinate search over logarithmic steps with a lognormal prior of a
factor of three about the physical starting values: a short or quiet pass keeps those.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .initial import LAGS
from .settings import Levels

Floats = NDArray[np.float64]

PRIOR_FACTOR = 3.0  # one standard deviation of the prior, as a factor
BOUNDS: Mapping[str, tuple[float, float]] = {
    "beta1": (0.0008, 0.06), "beta2": (0.0008, 0.10), "white_fixed": (0.15, 1.5), "white_float": (0.02, 1.5),
    "white_second": (0.15, 1.5), "velocity": (0.01, 1.0), "lateral": (0.7, 20.0), "hitch": (0.15, 20.0),
    "forward": (0.1, 10.0), "wheel": (0.002, 0.5),
}  # fmt: skip
FACTORS = (2.0, 1.4, 1.2)  # of successive sweeps


def best_lag(likelihood: Callable[[float], float], prior_sd: float) -> float:
    """Lag from which the estimate may start: best of a grid of 25 ms about the prior, refined to 6 ms."""

    def posterior(lag: float) -> float:
        return likelihood(lag) - 0.5 * (lag / prior_sd) ** 2

    lag = float(max(LAGS, key=posterior))
    for step in (0.0125, 0.00625):
        lag = max((lag - step, lag, lag + step), key=posterior)
    return lag


def best_levels(start: Levels, free: tuple[str, ...], likelihood: Callable[[Levels], float]) -> Levels:
    """Levels of the largest posterior: coordinate search from `start` over the named fields."""

    def posterior(levels: Levels) -> float:
        prior = sum(
            math.log(getattr(levels, name) / getattr(start, name)) ** 2 for name in free
        ) / (2.0 * math.log(PRIOR_FACTOR) ** 2)  # fmt: skip
        return likelihood(levels) - prior

    best, score = start, posterior(start)
    for factor in FACTORS:
        for name in free:
            for direction in (factor, 1.0 / factor):
                climbed = False
                while True:
                    low, high = BOUNDS[name]
                    value = min(max(getattr(best, name) * direction, low), high)
                    trial = replace(best, **{name: value})
                    if value == getattr(best, name) or (new := posterior(trial)) <= score:
                        break
                    best, score, climbed = trial, new, True
                if climbed:
                    break
    return best
