"""Bounded alignment: least squares with a prior, its bound, and what it leaves over."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import minimize
from smts_validate.pipeline.alignment import align, align_freely, bound, remaining

Floats = NDArray[np.float64]


def problem(seed: int, size: int = 40) -> tuple[Floats, Floats, Floats, Floats]:
    generator = np.random.default_rng(seed)
    slope = generator.normal(size=(size, 3))
    root = generator.normal(size=(3, 3))
    prior = root @ root.T + 0.1 * np.eye(3)
    return generator.normal(size=size), slope, generator.uniform(0.1, 2.0, size), prior


def test_the_bound_is_the_chi_square_of_95_percent() -> None:
    assert bound(3) == pytest.approx(7.8147, abs=1e-4)
    assert bound(2) == pytest.approx(5.9915, abs=1e-4)


@given(st.integers(0, 10_000))
def test_theta_minimises_the_stated_sum(seed: int) -> None:
    residual, slope, weights, prior = problem(seed)
    found = align(residual, slope, weights, prior)
    inverse = np.linalg.inv(prior)

    def cost(theta: Floats) -> float:
        left = residual + slope @ theta
        return float(weights @ left**2 + found.weight * theta @ inverse @ theta)

    other = minimize(cost, np.zeros(3), tol=1e-12)
    assert found.theta == pytest.approx(other.x, abs=1e-4)
    assert found.chi2 == pytest.approx(found.theta @ inverse @ found.theta, rel=1e-6, abs=1e-9)


@given(st.integers(0, 10_000), st.floats(0.01, 1000.0))
def test_the_alignment_never_moves_further_than_its_prior_allows(seed: int, size: float) -> None:
    residual, slope, weights, prior = problem(seed)
    found = align(size * residual, slope, weights, prior)
    assert found.chi2 <= bound(3) * (1.0 + 1e-6)
    assert found.weight >= 1.0
    assert (found.weight == 1.0) == (found.chi2_free <= bound(3))


def test_a_raised_prior_reaches_the_bound_and_no_less() -> None:
    residual, slope, weights, prior = problem(1)
    found = align(1000.0 * residual, slope, weights, prior)
    assert found.weight > 1.0
    assert found.chi2 == pytest.approx(bound(3), rel=1e-6)


def test_a_masked_point_has_no_say() -> None:
    residual, slope, weights, prior = problem(2)
    weights[10] = 0.0
    wild = residual.copy()
    wild[10] = 1e6
    assert align(wild, slope, weights, prior).theta == pytest.approx(
        align(residual, slope, weights, prior).theta, rel=1e-12
    )


def test_without_a_prior_it_is_weighted_least_squares() -> None:
    residual, slope, weights, _ = problem(3)
    root = np.sqrt(weights)
    expected, *_ = np.linalg.lstsq(slope * root[:, np.newaxis], -residual * root, rcond=None)
    assert align_freely(residual, slope, weights).theta == pytest.approx(expected, rel=1e-9)


def test_the_gain_tells_how_theta_answers_a_change_of_the_residual() -> None:
    residual, slope, weights, prior = problem(4)
    found = align(0.05 * residual, slope, weights, prior)
    change = 1e-3 * np.sin(np.arange(40.0))
    moved = align(0.05 * residual + change, slope, weights, prior)
    assert moved.theta - found.theta == pytest.approx(-found.gain @ change, rel=1e-9, abs=1e-15)
    left = remaining(found, slope, change[:, np.newaxis])[:, 0]
    assert left == pytest.approx(change + slope @ (moved.theta - found.theta), abs=1e-12)


def test_what_lies_in_the_alignment_s_own_shapes_is_taken_out_when_the_prior_is_wide() -> None:
    _, slope, weights, _ = problem(5)
    inside = slope @ np.array([[1.0], [-2.0], [0.5]])
    found = align(np.zeros(40), slope, weights, 1e8 * np.eye(3))
    assert np.abs(remaining(found, slope, inside)).max() < 1e-6
