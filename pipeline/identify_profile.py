"""Profile intervals: how far one parameter may go when all the others follow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from .identify_fit import Fit, prior_centre, prior_information, searched
from .identify_problem import bounds_of, residual_of, values_at

Floats = NDArray[np.float64]

WIDENED = 1.6  # a bracket that does not hold the end yet
FINE = 0.02  # of the interval's half width


def profile(fit: Fit, index: int) -> tuple[float | None, float | None]:
    """Ends of one parameter's profile interval in its own unit; None where its bound comes first.

    The least sum of squares with the parameter fixed, all others free, rises by t²·κ at an end, with κ = C_ii/(A⁻¹)_ii
    the factor by which autocorrelation widens the variance. On a straight problem this is the interval
    of the standard error; it is skewed where the sum of squares is.
    """
    low, high = (float(b[index]) for b in bounds_of(fit.parameters))
    ends = [_end(fit, index, bound) for bound in (low, high)]
    parameter, pull = fit.parameters[index], float(fit.pull[index])
    found = [None if z is None else parameter.value(min(max(z - pull, low), high)) for z in ends]
    return found[0], found[1]


def _end(fit: Fit, index: int, bound: float) -> float | None:
    """z at which the profile has risen enough, towards a bound; None when the bound comes first."""
    centre = float(fit.optimum[index])
    width = fit.quantile * float(fit.sd[index])
    needed = fit.quantile * float(np.sqrt(fit.covariance[index, index] / fit.bread[index, index]))
    least = _least(fit)

    def short(z: float) -> float:
        """How much the root of the rise is still short of what is needed: straight for a quadratic."""
        return float(np.sqrt(max(_fixed(fit, index, z) - least, 0.0))) - needed

    side = 1.0 if bound > centre else -1.0
    reach = width
    while True:
        outer = min(centre + reach, bound) if side > 0.0 else max(centre - reach, bound)
        if short(outer) >= 0.0:
            break
        if outer == bound:
            return None
        reach *= WIDENED
    return float(brentq(lambda z: -needed if z == centre else short(z), centre, outer, xtol=FINE * width))


def _least(fit: Fit) -> float:
    residual = residual_of(fit.stretches, values_at(fit.parameters, fit.optimum))
    away = fit.optimum - prior_centre(fit.parameters)
    prior = away @ prior_information(fit.parameters) @ away
    return float(np.sum(fit.weights * residual**2) + prior)


def _fixed(fit: Fit, index: int, z: float) -> float:
    """The least sum of squares with one parameter fixed."""
    parameter = fit.parameters[index]
    rest = [p for k, p in enumerate(fit.parameters) if k != index]
    prior = parameter.information * (z - parameter.centre) ** 2
    fixed = {parameter.name: parameter.value(z)}
    if not rest:
        return float(np.sum(fit.weights * residual_of(fit.stretches, fixed) ** 2) + prior)
    # Where a straight problem would have the others: near enough for a step or two.
    follow = np.delete(fit.bread[:, index], index) / fit.bread[index, index]
    start = np.delete(fit.optimum, index) + follow * (z - fit.optimum[index])
    return searched(fit.stretches, rest, fit.weights, start, fixed)[1] + prior
