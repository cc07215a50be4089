"""Levels that the data themselves can tell: the clocks' lag, slips and noise, by the innovations' likelihood.

The forward filter's innovations are independent under the model, so their Gaussian log-likelihood (Schweppe
1965) is the likelihood of the levels, with a lognormal prior of a factor of three about the physical starting values: a
short or quiet pass keeps those.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from .initial import LAGS
from .settings import Levels

PRIOR_FACTOR = 3.0  # one standard deviation of the prior, as a factor
BOUNDS: Mapping[str, tuple[float, float]] = {
    "beta1": (0.0008, 0.06), "beta2": (0.0008, 0.10), "white_fixed": (0.15, 1.5), "white_float": (0.02, 1.5),
    "white_second": (0.15, 1.5), "velocity": (0.01, 1.0), "lateral": (0.7, 20.0), "hitch": (0.15, 20.0),
    "forward": (0.1, 10.0), "wheel": (0.002, 0.5),
}  # fmt: skip
FIRST, THEN = math.log(2.0), math.log(1.3)  # steps of the first sweep over the levels and of the second
NEAR = 0.1  # steps from a top: near enough
FURTHEST = 8  # steps on end in one direction


def best_lag(likelihood: Callable[[float], float], prior_sd: float) -> float:
    """Lag from which the estimate may start: the top of the parabola about the best of a grid about the prior."""
    scores = np.array([likelihood(float(lag)) - 0.5 * (float(lag) / prior_sd) ** 2 for lag in LAGS])
    best = int(np.argmax(scores))
    if best in (0, LAGS.size - 1):
        return float(LAGS[best])
    lower, middle, higher = scores[best - 1 : best + 2]
    return float(LAGS[best] + (LAGS[1] - LAGS[0]) * _top(lower - middle, higher - middle))


def best_levels(
    start: Levels,
    free: tuple[str, ...],
    likelihood: Callable[[Levels], float],
    rough: Callable[[Levels], float],
) -> Levels:
    """Levels of the largest posterior, from `start` over the named fields: twice one after the other.

    In its logarithm the posterior of one level is nearly a parabola, whose top two neighbours tell. Where a neighbour
    is the better, the search goes on to it and beyond.

    rough : likelihood of fewer data, for the first sweep, which has far to go
    """
    best = {name: float(getattr(start, name)) for name in free}
    for step, told in ((FIRST, rough), (THEN, likelihood)):

        def posterior(at: Mapping[str, float], told: Callable[[Levels], float] = told) -> float:
            prior = sum(math.log(at[name] / getattr(start, name)) ** 2 for name in free)
            return told(replace(start, **at)) - prior / (2.0 * math.log(PRIOR_FACTOR) ** 2)

        best = _swept(best, posterior, step)
    return replace(start, **best)


def _swept(
    best: Mapping[str, float], posterior: Callable[[Mapping[str, float]], float], step: float
) -> dict[str, float]:
    """All levels one after the other brought to the top of the posterior along their own logarithms."""
    best = dict(best)
    score = posterior(best)
    for name in best:
        scores = {best[name]: score}  # at a bound both neighbours may be where the level is already

        def along(place: float, name: str = name, scores: dict[float, float] = scores) -> float:
            value = _within(name, place)
            if value not in scores:
                scores[value] = posterior(best | {name: value})
            return scores[value]

        place, score = _climbed(along, math.log(best[name]), score, step)
        best[name] = _within(name, place)
    return best


def _within(name: str, logarithm: float) -> float:
    low, high = BOUNDS[name]
    return min(max(math.exp(logarithm), low), high)


def _climbed(
    score_at: Callable[[float], float], place: float, score: float, step: float
) -> tuple[float, float]:
    """Top of a function along one line, from a place of known score, and the score there: by the parabola through the
    best of its points, `step` apart, and that one's neighbours."""
    lower, higher = score_at(place - step), score_at(place + step)
    if max(lower, higher) > score:
        way, beyond, behind = (step, higher, score) if higher > lower else (-step, lower, score)
        for _ in range(FURTHEST):
            place, score = place + way, beyond
            beyond = score_at(place + way)
            if beyond <= score:
                break
            behind = score
        lower, higher = (behind, beyond) if way > 0.0 else (beyond, behind)
    top = _top(lower - score, higher - score)
    if abs(top) < NEAR:
        return place, score
    reached = score_at(place + step * top)
    return (place + step * top, reached) if reached > score else (place, score)


def _top(lower: float, higher: float) -> float:
    """Where the parabola through (-1, lower), (0, 0), (1, higher) is highest; neither of its neighbours is above zero,
    so that is half a step away at most."""
    bend = lower + higher
    return 0.5 * (lower - higher) / bend if bend < 0.0 else 0.0
