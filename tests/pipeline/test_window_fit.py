"""A steering zero too far for one linear step: taken out exactly, within its prior, and no model error with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize
from smts_validate.model.machine import Machine
from smts_validate.pipeline.adequacy import judge_pass
from smts_validate.pipeline.alignment import align, bound
from smts_validate.pipeline.compare import Comparison, compare
from smts_validate.pipeline.fusion.motion import Motion
from smts_validate.pipeline.grid import stacked_measured, stacked_simulated
from smts_validate.pipeline.replay import drive_of, run_windows, shifted, window_prior
from smts_validate.pipeline.window_fit import WindowFit, coarse, weights_of
from synthetic_motion import Errors, Field, machine_of, manifest_of, motion_of, truth_of

Floats = NDArray[np.float64]
ZEROS = (0.5, 1.5, 2.7)  # deg
STATED = 0.3  # deg, sd of the steering zero where nothing widens it
LONG_DRAWBAR = {"seeder.hitch_to_com": 2.0}


@cache
def machine() -> Machine:
    return machine_of(manifest_of())


@cache
def plain(seed: int = 0) -> Motion:
    errors = Errors(steer_zero=0.0, steer_time=20.0)
    return motion_of(truth_of(machine(), Field(), 2.8, seed), machine(), errors, 100 + seed)


def off(zero: float, stated: float) -> Motion:
    """The plain pass with its steering series off by `zero` deg, its zero's sd stated as that many deg."""
    motion = plain()
    assert motion.steer_input is not None
    series = replace(
        motion.steer_input, angle=motion.steer_input.angle + np.deg2rad(zero), zero_sd=np.deg2rad(stated)
    )
    return replace(motion, steer_input=series)


@cache
def compared(zero: float = 0.0, stated: float = STATED, drawbar: float = 1.0) -> Comparison:
    long = drawbar * machine().parameter("seeder.hitch_to_com")
    return compare(
        off(zero, stated), machine().replace_parameters({"seeder.hitch_to_com": long}), manifest_of()
    )


def theta_of(found: Comparison) -> Floats:
    return np.stack([f.alignment.theta for f in found.rows[0].fits])


@pytest.mark.parametrize("zero", ZEROS)
def test_a_steering_zero_within_its_stated_doubt_changes_neither_discrepancy_nor_verdict(zero: float) -> None:
    without, found = (
        judge_pass(compared().statistics),
        judge_pass(compared(zero, max(STATED, zero)).statistics),
    )
    assert found.value == without.value == "adequate"
    for name, one in without.responses.items():
        other = found.responses[name]
        assert other.d == pytest.approx(one.d, rel=0.03)
        # The uncertainty too is that of the aligned run: a far zero adds nothing that the alignment takes out.
        assert other.u == pytest.approx(one.u, rel=0.03)
        assert other.u_input == pytest.approx(one.u_input, rel=0.15)


@pytest.mark.parametrize("zero", ZEROS)
def test_the_zero_that_the_alignment_finds_is_the_one_put_in(zero: float) -> None:
    moved = theta_of(compared(zero, max(STATED, zero))) - theta_of(compared())
    assert np.rad2deg(moved[:, 2]) == pytest.approx(-zero, abs=0.02)
    assert np.abs(moved[:, 0]).max() < 0.002  # m
    assert np.abs(moved[:, 1]).max() < np.deg2rad(0.02)


def test_a_zero_beyond_its_stated_doubt_is_not_taken_out() -> None:
    found = compared(2.7, STATED)
    assert all(f.alignment.chi2 <= bound(3) * (1.0 + 1e-6) for f in found.rows[0].fits)
    assert found.statistics is not None
    assert found.statistics.windows_within == 0.0
    assert judge_pass(found.statistics).value != "adequate"


@pytest.mark.parametrize("zero", [0.0, *ZEROS])
def test_a_wrong_model_stays_as_wrong_whatever_the_zero(zero: float) -> None:
    expected = judge_pass(compared(0.0, STATED, 2.0).statistics)
    found = judge_pass(compared(zero, max(STATED, zero), 2.0).statistics)
    assert found.value == expected.value == "not adequate"
    for name, one in expected.responses.items():
        assert found.responses[name].d == pytest.approx(one.d, rel=0.03)


@pytest.mark.parametrize("step", [1.0, 2.7])
def test_a_zero_that_jumps_within_the_row_is_absorbed_however_large_its_stated_doubt(step: float) -> None:
    # One doubtful zero is one number a row: windows that need different ones need more than is known.
    motion = off(0.0, 2.7)
    assert motion.steer_input is not None
    later = np.arange(motion.t.size) >= compared().rows[0].fits[3].window.start
    jumped = replace(motion.steer_input, angle=motion.steer_input.angle + np.deg2rad(step) * later)
    found = compare(replace(motion, steer_input=jumped), machine(), manifest_of())
    assert found.statistics is not None
    assert found.statistics.windows_within < 0.2
    assert judge_pass(found.statistics).codes == ("alignment",)
    still = compared(0.0, 2.7).statistics
    assert still is not None
    assert still.windows_within == 1.0


def parts_of_sum(found: Comparison, fit: WindowFit) -> tuple[Floats, Floats]:
    context = found.rows[0].context
    prior = window_prior(context.motion, fit.window, found.rows[0].row, context.settings)
    return weights_of(context, fit.window, fit.parts), prior


def test_where_one_linear_step_reaches_nothing_else_is_done() -> None:
    found = compared()
    for fit in found.rows[0].fits:
        weights, prior = parts_of_sum(found, fit)
        once = align(fit.start, fit.sensitivity, weights, prior)
        assert not fit.about.any()
        np.testing.assert_array_equal(fit.alignment.theta, once.theta)


def test_theta_is_the_least_sum_of_full_simulations_by_another_optimiser() -> None:
    found = compared(2.7, 2.7)
    row, context = found.rows[0].row, found.rows[0].context
    drive = coarse(drive_of(context.motion, row, context.settings))
    fit = found.rows[0].fits[1]
    assert fit.about.any()
    weights, prior = parts_of_sum(found, fit)
    inverse = np.linalg.inv(prior)
    spread = np.sqrt(np.diag(np.linalg.inv(fit.sensitivity.T * weights @ fit.sensitivity + inverse)))

    def cost(scaled: Floats) -> float:
        theta = scaled * spread
        start = shifted(context.motion, [fit.window], row, theta[:1], theta[1:2])
        run = run_windows(context.machine, drive, context.motion, [fit.window], start, steer_offset=theta[2])
        left = stacked_simulated(fit.parts, row, run, 0) - stacked_measured(fit.parts)
        return float(weights @ left**2 + theta @ inverse @ theta)

    # From the zero that was put in, as a stranger would begin; in units of θ's own standard deviations.
    begin = np.array([0.0, 0.0, -np.deg2rad(2.7)]) / spread
    simplex = np.vstack((begin, begin + 3.0 * np.eye(3)))
    options = {"initial_simplex": simplex, "xatol": 1e-3, "fatol": 1e-6, "maxiter": 1000}
    other = minimize(cost, begin, method="Nelder-Mead", options=options)
    assert other.success
    assert fit.alignment.theta / spread == pytest.approx(other.x, abs=0.15)
