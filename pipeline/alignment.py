"""Bounded alignment: what a window's simulation may move, and how far."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.special import gammaincinv

Floats = NDArray[np.float64]

LEVEL = 0.95  # χ² bound on the alignment: 7.81 for three parameters
HEAVIEST = 1e12  # weight of the prior at which nothing moves any more


@dataclass(frozen=True)
class Alignment:
    """What moved in one window, and what that does to the residual.

    theta : (P,) lateral offset m, heading rad, steering offset rad (the last is absent without a tractor
    model)
    chi2_free : θᵀP₀⁻¹θ with the prior as stated; chi2 : after its weight was raised to keep the bound
    weight : the prior's weight, 1 or more (0 for a free alignment)
    gain : (P, N) θ = −gain·r, with the final weight
    """

    theta: Floats
    chi2_free: float
    chi2: float
    weight: float
    gain: Floats


def bound(parameters: int) -> float:
    """The χ² that an alignment of so many parameters may reach: 7.81 for three."""
    return float(2.0 * gammaincinv(parameters / 2.0, LEVEL))


def align(residual: Floats, sensitivity: Floats, weights: Floats, prior: Floats) -> Alignment:
    """θ that minimises Σ (r + Jθ)ᵀS⁻¹(r + Jθ) + λ·θᵀP₀⁻¹θ, with the least λ ≥ 1 that keeps θᵀP₀⁻¹θ in
    its bound.

    Parameters
    ----------
    residual : (N,) simulated − measured, all channels stacked
    sensitivity : (N, P) its derivative with respect to θ
    weights : (N,) 1/S, zero where a point is masked
    prior : (P, P) covariance P₀, positive definite

    In the basis where P₀ is the unit matrix and JᵀS⁻¹J is diagonal (h), θ = −b/(h + λ), so χ²(λ) = Σ
    b²/(h + λ)²
    falls with λ and the bound has one root.
    """
    root = np.linalg.cholesky(prior)
    information = root.T @ (sensitivity.T * weights) @ sensitivity @ root
    stiffness, basis = np.linalg.eigh(information)
    stiffness = np.maximum(stiffness, 0.0)
    whitened = basis.T @ root.T @ (sensitivity.T * weights)
    slope = whitened @ residual

    def chi2_at(weight: float) -> float:
        return float(np.sum((slope / (stiffness + weight)) ** 2))

    limit = bound(prior.shape[0])
    free = chi2_at(1.0)
    weight = 1.0 if free <= limit else brentq(lambda log: chi2_at(np.exp(log)) - limit, 0.0, np.log(HEAVIEST))
    weight = 1.0 if free <= limit else float(np.exp(weight))
    gain = root @ basis @ (whitened / (stiffness + weight)[:, np.newaxis])
    return Alignment(-gain @ residual, free, chi2_at(weight), weight, gain)


def align_freely(residual: Floats, sensitivity: Floats, weights: Floats) -> Alignment:
    """θ by weighted least squares without a prior: only for the disclosure table, never for the headline."""
    information = (sensitivity.T * weights) @ sensitivity
    gain = np.linalg.pinv(information) @ (sensitivity.T * weights)
    return Alignment(-gain @ residual, float("nan"), float("nan"), 0.0, gain)


def remaining(alignment: Alignment, sensitivity: Floats, change: Floats) -> Floats:
    """What is left of a change (N, K) of the residual once the alignment has answered it: (I −
    J·gain)·change."""
    return np.asarray(change - sensitivity @ (alignment.gain @ change))
