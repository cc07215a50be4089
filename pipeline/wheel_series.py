"""Random walks seen through white noise and unknown constants: the one estimator behind wheels.py.

Every channel of a wheel-mounted unit is modelled alike: y = s + X·β + n, with s a random walk (phase error,
yaw rate, spin), X known regressors (what a bias looks like once it is turned by the phase), β constants of
the unit, n white. A scalar Kalman filter run over y and the columns of X with the same gains whitens them;
least squares of the whitened columns is then the exact generalised least squares for β, and the smoothed
columns give s given β (the augmented filter of Rosenberg 1973 and de Jong 1991).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

DIFFUSE = 1.0e4  # initial variance of a walk whose start is unknown, in units of the channel squared
LAG = 0.1  # s, over which a channel's walk is judged
FIT_SAMPLES, RUN = 40_000, 500  # samples that a long channel's noise is judged by, in runs
MAD_TO_SD = 1.4826


@njit(cache=True, nogil=True)
def _forward(
    columns: Floats, step: Floats, noise: Floats, initial: float, block: int
) -> tuple[Floats, Floats, Floats, Floats]:
    """Filter all columns with one gain: means (N, m), variances, predicted variances, and the products of the
    whitened innovations summed over blocks (B, m, m), lower triangles.
    """
    n, m = columns.shape
    mean, white = np.empty((n, m)), np.empty(m)
    variance, predicted = np.empty(n), np.empty(n)
    products = np.zeros(((n + block - 1) // block, m, m))
    prior = initial
    for k in range(n):
        if k > 0:
            prior = variance[k - 1] + step[k - 1]
        predicted[k] = prior
        spread = prior + noise[k]
        gain = prior / spread
        scale = 1.0 / np.sqrt(spread)
        variance[k] = prior * noise[k] / spread if np.isfinite(noise[k]) else prior
        for j in range(m):
            before = mean[k - 1, j] if k > 0 else 0.0
            innovation = columns[k, j] - before
            mean[k, j] = before + gain * innovation
            white[j] = scale * innovation
            for i in range(j + 1):
                products[k // block, j, i] += white[j] * white[i]
    return mean, variance, predicted, products


@njit(cache=True, nogil=True)
def _backward(mean: Floats, variance: Floats, predicted: Floats) -> None:
    """Rauch-Tung-Striebel pass in place, for a state that is carried over unchanged."""
    n, m = mean.shape
    for k in range(n - 2, -1, -1):
        gain = variance[k] / predicted[k + 1]
        variance[k] += gain * gain * (variance[k + 1] - predicted[k + 1])
        for j in range(m):
            mean[k, j] += gain * (mean[k + 1, j] - mean[k, j])


@dataclass(frozen=True)
class Walk:
    """A channel's stochastic model.

    step : (N-1,) variance gained from one sample to the next; noise : (N,) variance of each sample's white
    noise, inf where the sample is not to be used; initial : variance of the first value
    """

    step: Floats
    noise: Floats
    initial: float = DIFFUSE


@dataclass(frozen=True)
class Smoothed:
    """Filtered both ways: columns (N, 1+m) smoothed, variance (N,) of the signal given β, and `products`
    (B, 1+m, 1+m) of the whitened columns, summed over blocks of samples.
    """

    columns: Floats
    variance: Floats
    products: Floats


@dataclass(frozen=True)
class Constants:
    """Least-squares constants of a unit: value (m,), covariance (m, m)."""

    value: Floats
    covariance: Floats

    @property
    def sd(self) -> Floats:
        return np.sqrt(np.diag(self.covariance))


def smooth(columns: Floats, walk: Walk, block: int = 0) -> Smoothed:
    """Filter and smooth y and its regressors, columns (N, 1+m), with one set of gains.

    block : samples after which the residuals are taken to be independent (0: one block), see `solve`
    """
    columns = np.ascontiguousarray(columns)
    size = block or columns.shape[0]
    mean, variance, predicted, half = _forward(
        columns, walk.step, np.ascontiguousarray(walk.noise), walk.initial, size
    )
    _backward(mean, variance, predicted)
    return Smoothed(mean, variance, half + np.transpose(np.tril(half, -1), (0, 2, 1)))


def whitened_products(columns: Floats, variance: Floats, block: int = 0) -> Floats:
    """Products of plain white measurements (N, 1+m) over their variance, summed over blocks: (B, 1+m,
    1+m).
    """
    rows = columns / np.sqrt(variance)[:, None]
    if not block or variance.size < block:
        return np.asarray((rows.T @ rows)[None])
    count = variance.size // block
    parts = rows[: count * block].reshape(count, block, -1)
    rest = rows[count * block :]
    return np.concatenate([np.transpose(parts, (0, 2, 1)) @ parts, (rest.T @ rest)[None]])


def solve(channels: Sequence[Floats], prior_sd: Floats) -> Constants:
    """Constants common to several channels, each given by its blocks' products (B, 1+m, 1+m).

    prior_sd : (m,) of β about zero. A channel whose residuals agree with the regressors over whole blocks
    more than white noise would (a signal with a resonance at the wheel's own frequency) is weighted down by
    what it shows.
    """
    sums = [products.sum(axis=0) for products in channels]
    first = _least_squares(sums, prior_sd)
    weights = [1.0 / _clustering(products, first.value) for products in channels]
    return _least_squares([total * weight for total, weight in zip(sums, weights, strict=True)], prior_sd)


def _least_squares(sums: Sequence[Floats], prior_sd: Floats) -> Constants:
    total = np.sum(sums, axis=0)
    covariance = np.linalg.inv(np.diag(prior_sd**-2.0) + total[1:, 1:])
    return Constants(covariance @ total[1:, 0], covariance)


def _clustering(products: Floats, value: Floats) -> float:
    """Variance of Σ x·e over blocks against that of white e: Σ_b (Σ x·e)² / Σ x², at least 1."""
    if products.shape[0] < 4:
        return 1.0
    score = products[:, 1:, 0] - products[:, 1:, 1:] @ value
    total = np.sum(score**2, axis=0)
    white = np.diagonal(products[:, 1:, 1:], axis1=1, axis2=2).sum(axis=0)
    known = white > 0.0
    return max(1.0, float(np.mean(total[known] / white[known]))) if known.any() else 1.0


def signal(channel: Smoothed, constants: Constants, direct: Floats | None = None) -> tuple[Floats, Floats]:
    """The walk's value and variance, constants taken off: s = S(y) − S(X)·β, with the doubt of β.

    direct : (N, k) regressors of the first k constants that belong to the signal itself (a drift is part of
    the phase): s + direct·β
    """
    columns = channel.columns
    if direct is not None:
        columns = columns.copy()
        columns[:, 1 : 1 + direct.shape[1]] -= direct
    return columns @ np.append(1.0, -constants.value), channel.variance + _doubt(
        columns, constants.covariance
    )


@njit(cache=True, nogil=True)
def _doubt(columns: Floats, covariance: Floats) -> Floats:
    """xᵀ·C·x of every row, the first column left out: (N,)."""
    n, m = columns.shape
    doubt = np.empty(n)
    for k in range(n):
        total = 0.0
        for j in range(1, m):
            row = 0.5 * covariance[j - 1, j - 1] * columns[k, j]
            for i in range(1, j):
                row += covariance[j - 1, i - 1] * columns[k, i]
            total += 2.0 * row * columns[k, j]
        doubt[k] = total
    return doubt


def fit_walk(t: Floats, y: Floats, lag_s: float = LAG) -> tuple[float, float]:
    """Noise of a channel from the channel itself: (variance of the white noise, walk in units²/s).

    White noise from third differences, in which a signal slower than a tenth of the sampling rate is gone
    (their variance is 20 times the noise's); the walk from changes over `lag_s` seconds less that noise. Both
    by median absolute deviations: a start, a stop or a few bad samples do not count.
    """
    if t.size < 2:
        return 0.0, 0.0
    dt = float(np.median(np.diff(t)))
    t, y = _thinned(t, y)
    lag = max(round(lag_s / dt), 1)
    if y.size < 4 * lag:
        return 0.0, 0.0
    even = np.abs(np.diff(t) - dt) < 0.5 * dt
    noise = robust_sd(np.diff(y, 3)[even[2:] & even[1:-1] & even[:-2]]) ** 2 / 20.0
    apart = t[lag:] - t[:-lag]
    change = robust_sd((y[lag:] - y[:-lag])[np.abs(apart - lag * dt) < 0.5 * lag * dt]) ** 2
    return noise, max(change - 2.0 * noise, 0.1 * change) / (lag * dt)


def _thinned(t: Floats, y: Floats) -> tuple[Floats, Floats]:
    """Evenly spread runs of `RUN` samples of a long channel: enough to know its noise to 1 %."""
    every = y.size // FIT_SAMPLES
    if every < 2:
        return t, y
    keep = (np.arange(y.size) // RUN) % every == 0
    return t[keep], y[keep]


def robust_sd(values: Floats) -> float:
    """Standard deviation from the median absolute deviation; 0 for nothing."""
    if values.size == 0:
        return 0.0
    return float(MAD_TO_SD * np.median(np.abs(values - np.median(values))))


def block_means(values: Floats, size: int) -> Floats:
    """Means of consecutive blocks of `size` samples, the rest at the end left out."""
    count = values.size // size
    return np.asarray(values[: count * size].reshape(count, size).mean(axis=1))


def slow_noise(residual: Floats, size: int) -> float:
    """Variance that white samples would need for the scatter that block means of a coloured residual show."""
    fast = robust_sd(residual[:: max(residual.size // FIT_SAMPLES, 1)]) ** 2
    if residual.size < 4 * size:
        return fast
    return max(size * robust_sd(block_means(residual, size)) ** 2, 0.1 * fast)
