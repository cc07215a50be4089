"""The estimator behind the wheels: random walks in white noise with unknown constants, against dense
algebra.
"""

from __future__ import annotations

import numpy as np
import pytest
from smts_validate.pipeline import wheel_series
from smts_validate.pipeline.wheel_series import (
    Walk,
    fit_walk,
    signal,
    slow_noise,
    smooth,
    solve,
    whitened_products,
)
from smts_validate.pipeline.wheel_unit import GYRO_SCALES, running_mean, trusted

RNG_SEED = 20250515


def case(n: int = 60, m: int = 2, initial: float = 4.0):
    """A short channel with uneven steps and noise, two samples of it missing."""
    rng = np.random.default_rng(RNG_SEED)
    step, noise = rng.uniform(0.01, 0.2, n - 1), rng.uniform(0.1, 1.0, n)
    noise[[7, 31]] = np.inf
    columns = np.column_stack([rng.standard_normal(n).cumsum(), rng.standard_normal((n, m))])
    return columns, Walk(step, noise, initial)


def dense(walk: Walk) -> np.ndarray:
    """Covariance of the walk itself: Cov(s_j, s_k) = initial + steps up to the earlier of both."""
    grown = walk.initial + np.append(0.0, np.cumsum(walk.step))
    return np.minimum.outer(grown, grown)


def test_smoother_equals_the_batch_conditional_mean_and_variance():
    columns, walk = case()
    seen = np.isfinite(walk.noise)
    prior = dense(walk)
    gain = prior[:, seen] @ np.linalg.inv(prior[np.ix_(seen, seen)] + np.diag(walk.noise[seen]))
    found = smooth(columns, walk)
    np.testing.assert_allclose(found.columns, gain @ columns[seen], atol=1e-10)
    np.testing.assert_allclose(found.variance, np.diag(prior - gain @ prior[seen]), atol=1e-10)


def test_constants_equal_generalised_least_squares_with_the_dense_covariance():
    columns, walk = case()
    seen = np.isfinite(walk.noise)
    weight = np.linalg.inv(dense(walk)[np.ix_(seen, seen)] + np.diag(walk.noise[seen]))
    x, y = columns[seen, 1:], columns[seen, 0]
    prior_sd = np.array([0.7, 3.0])
    covariance = np.linalg.inv(np.diag(prior_sd**-2.0) + x.T @ weight @ x)
    found = solve([smooth(columns, walk).products], prior_sd)
    np.testing.assert_allclose(found.value, covariance @ x.T @ weight @ y, atol=1e-10)
    np.testing.assert_allclose(found.covariance, covariance, atol=1e-10)


def test_signal_and_its_variance_equal_the_joint_posterior_of_walk_and_constants():
    columns, walk = case()
    seen = np.isfinite(walk.noise)
    n, x = columns.shape[0], columns[:, 1:]
    prior_sd = np.array([0.7, 3.0])
    direct = np.linspace(-1.0, 1.0, n)[:, None]
    joint = np.zeros((n + 2, n + 2))
    joint[:n, :n], joint[n:, n:] = dense(walk), np.diag(prior_sd**2)
    observed = np.hstack([np.eye(n), x])[seen]
    gain = joint @ observed.T @ np.linalg.inv(observed @ joint @ observed.T + np.diag(walk.noise[seen]))
    mean, after = gain @ columns[seen, 0], joint - gain @ observed @ joint
    wanted = np.hstack([np.eye(n), direct, np.zeros((n, 1))])
    channel = smooth(columns, walk)
    value, variance = signal(channel, solve([channel.products], prior_sd), direct)
    np.testing.assert_allclose(value, wanted @ mean, atol=1e-10)
    np.testing.assert_allclose(variance, np.diag(wanted @ after @ wanted.T), atol=1e-10)


def test_block_sums_add_up_to_the_whole():
    columns, walk = case()
    whole, blocks = smooth(columns, walk).products, smooth(columns, walk, 17).products
    assert blocks.shape[0] == 4
    np.testing.assert_allclose(blocks.sum(axis=0), whole[0], atol=1e-10)
    variance = np.full(columns.shape[0], 0.3)
    np.testing.assert_allclose(
        whitened_products(columns, variance, 17).sum(axis=0), columns.T @ columns / 0.3, atol=1e-10
    )


@pytest.mark.parametrize("name", ["_forward", "_backward", "_doubt"])
def test_compiled_kernels_equal_their_uncompiled_selves(name):
    columns, walk = case()
    kernel = getattr(wheel_series, name)
    forward = wheel_series._forward.py_func(columns, walk.step, walk.noise, walk.initial, 17)
    inputs = {
        "_forward": (columns, walk.step, walk.noise, walk.initial, 17),
        "_backward": forward[:3],
        "_doubt": (columns, np.array([[2.0, 0.3], [0.3, 1.0]])),
    }[name]
    first, second = (tuple(np.copy(a) if isinstance(a, np.ndarray) else a for a in inputs) for _ in range(2))
    returned = kernel(*first), kernel.py_func(*second)
    pairs = zip(first, second, strict=True) if name == "_backward" else [returned]
    for compiled, plain in pairs:
        for a, b in (
            zip(np.atleast_1d(compiled), np.atleast_1d(plain), strict=True)
            if name != "_forward"
            else zip(compiled, plain, strict=True)
        ):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(("noise_sd", "walk"), [(0.5, 1.0), (0.1, 4.0)])
def test_noise_and_walk_of_a_simulated_channel_are_found(noise_sd, walk):
    rng = np.random.default_rng(RNG_SEED)
    t = np.arange(60_000) * 0.01
    y = np.cumsum(np.sqrt(walk * 0.01) * rng.standard_normal(t.size)) + noise_sd * rng.standard_normal(t.size)
    variance, rate = fit_walk(t, y)
    # Third differences of the walk itself add 6/20 of a step's variance to the white noise.
    assert variance == pytest.approx(noise_sd**2 + 0.3 * walk * 0.01, rel=0.05)
    assert rate == pytest.approx(walk, rel=0.15)


def test_a_start_and_a_few_wild_samples_do_not_change_the_noise_found():
    rng = np.random.default_rng(RNG_SEED)
    t = np.arange(6000) * 0.01
    y = 0.1 * rng.standard_normal(t.size) + 0.2 * np.sin(t)
    hurt = y + np.where((t > 5.0) & (t < 8.0), 4.0 * (t - 5.0), 0.0) + np.where(t >= 8.0, 12.0, 0.0)
    hurt[[100, 2000, 4000]] += 50.0
    assert fit_walk(t, hurt)[0] == pytest.approx(fit_walk(t, y)[0], rel=0.1)


def test_block_means_tell_coloured_noise_from_white():
    rng = np.random.default_rng(RNG_SEED)
    white = rng.standard_normal(60_000)
    # A first-order process of coefficient 0.9 has (1 + 0.9)/(1 − 0.9) = 19 times its variance at zero
    # frequency.
    coloured = np.empty_like(white)
    coloured[0] = white[0]
    for k in range(1, white.size):
        coloured[k] = 0.9 * coloured[k - 1] + white[k]
    assert slow_noise(white, 400) == pytest.approx(1.0, rel=0.25)
    assert slow_noise(coloured, 400) == pytest.approx(19.0 * np.var(coloured), rel=0.35)


def test_constants_stay_honest_when_the_signal_resonates_at_their_own_frequency():
    # A signal with a resonance at the regressor's frequency, of wandering phase: white or walking noise it
    # is not.
    errors = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        t = np.arange(6000) * 0.01
        wander = np.exp(1j * np.cumsum(0.15 * rng.standard_normal(t.size)))
        regressor = np.exp(1j * 4.5 * t)
        y = 0.05 * (wander * np.exp(1j * 4.5 * t)).real + 0.02 * rng.standard_normal(t.size)
        columns = np.column_stack([y, regressor.real, regressor.imag])
        variance, walk = fit_walk(t, y)
        channel = smooth(columns, Walk(walk * np.diff(t), np.full(t.size, variance)), 300)
        found = solve([channel.products], np.array([1.0, 1.0]))
        errors.append(found.value / found.sd)
    assert 0.6 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_running_mean_is_the_plain_mean_of_a_symmetric_window():
    values = np.random.default_rng(RNG_SEED).standard_normal(50)
    found = running_mean(values, 4)
    np.testing.assert_allclose(
        found[4:-4], np.convolve(values, np.full(9, 1.0 / 9.0), mode="valid"), atol=1e-12
    )
    assert found[0] == pytest.approx(values[0])
    assert found[1] == pytest.approx(values[:3].mean())


def test_clipped_runs_and_single_spikes_are_not_trusted_and_all_else_is():
    values = np.random.default_rng(RNG_SEED).standard_normal(1000) * 0.01
    values[200:220], values[500] = np.radians(250.0), 3.0
    bad = np.flatnonzero(~trusted(values, GYRO_SCALES))
    assert set(range(200, 220)) | {500} == set(bad.tolist())


def test_a_series_that_freezes_is_not_trusted_while_it_does():
    values = np.random.default_rng(RNG_SEED).standard_normal(1000) * 0.01
    values[300:360] = values[300]
    assert np.flatnonzero(~trusted(values, GYRO_SCALES)).tolist() == list(range(300, 360))
