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
MAD_TO_SD = 1.4826


@njit(cache=True)
def _forward(
    columns: Floats, step: Floats, noise: Floats, initial: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Filter all columns with one gain; returns means, variances, predicted variances, whitened
    innovations.
    """
    n, m = columns.shape
    mean, white = np.empty((n, m)), np.empty((n, m))
    variance, predicted = np.empty(n), np.empty(n)
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
            white[k, j] = scale * innovation
    return mean, variance, predicted, white


@njit(cache=True)
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
    """Filtered both ways: columns (N, 1+m) smoothed, variance (N,) of the signal given β, whitened (N,
    1+m).
    """

    columns: Floats
    variance: Floats
    whitened: Floats


@dataclass(frozen=True)
class Constants:
    """Least-squares constants of a unit: value (m,), covariance (m, m)."""

    value: Floats
    covariance: Floats

    @property
    def sd(self) -> Floats:
        return np.sqrt(np.diag(self.covariance))


def smooth(y: Floats, regressors: Floats, walk: Walk) -> Smoothed:
    """Filter and smooth y and its regressors (N, m) with one set of gains."""
    columns = np.column_stack([y, regressors])
    mean, variance, predicted, white = _forward(columns, walk.step, walk.noise, walk.initial)
    _backward(mean, variance, predicted)
    return Smoothed(mean, variance, white)


def whiten(y: Floats, regressors: Floats, variance: Floats) -> Floats:
    """Rows (y, X) of plain white measurements, each divided by its standard deviation."""
    return np.column_stack([y, regressors]) / np.sqrt(variance)[:, None]


def solve(rows: Sequence[Floats], prior_sd: Floats, blocks: Sequence[int]) -> Constants:
    """Constants common to several sets of whitened rows (y, X) (k, 1+m).

    prior_sd : (m,) of β about zero
    blocks : for each set, the samples after which its residuals are taken to be independent (0: all are).
        A set whose residuals agree with the regressors over whole blocks more than white noise would (a
        signal with a resonance at the wheel's own frequency) is weighted down by what it shows.
    """
    first = _least_squares(rows, prior_sd)
    weighed = [
        part / np.sqrt(_clustering(part, first.value, size)) for part, size in zip(rows, blocks, strict=True)
    ]
    return _least_squares(weighed, prior_sd)


def _least_squares(rows: Sequence[Floats], prior_sd: Floats) -> Constants:
    information, vector = np.diag(prior_sd**-2.0), np.zeros(prior_sd.size)
    for part in rows:
        y, x = part[:, 0], part[:, 1:]
        information, vector = information + x.T @ x, vector + x.T @ y
    covariance = np.linalg.inv(information)
    return Constants(covariance @ vector, covariance)


def _clustering(rows: Floats, value: Floats, size: int) -> float:
    """Variance of Σ x·e over blocks against that of white e: Σ_b (Σ x·e)² / Σ x², at least 1."""
    count = rows.shape[0] // size if size else 0
    if count < 4:
        return 1.0
    x = rows[: count * size, 1:]
    score = (x * (rows[: count * size, 0] - x @ value)[:, None]).reshape(count, size, -1).sum(axis=1)
    total, white = (score**2).sum(axis=0), (x**2).sum(axis=0)
    known = white > 0.0
    return max(1.0, float(np.mean(total[known] / white[known]))) if known.any() else 1.0


def signal(channel: Smoothed, constants: Constants, direct: Floats | None = None) -> tuple[Floats, Floats]:
    """The walk's value and variance, constants taken off: s = S(y) − S(X)·β, with the doubt of β.

    direct : (N, m) regressors that belong to the signal itself (a drift is part of the phase): s + direct·β
    """
    x = channel.columns[:, 1:] if direct is None else channel.columns[:, 1:] - direct
    value = channel.columns[:, 0] - x @ constants.value
    return value, channel.variance + np.sum((x @ constants.covariance) * x, axis=1)


def fit_walk(t: Floats, y: Floats) -> tuple[float, float]:
    """Noise of a channel from the channel itself: (variance of the white noise, walk in units²/s).

    White noise from third differences, in which a signal slower than a tenth of the sampling rate is gone
    (their variance is 20 times the noise's); the walk from changes over `LAG` seconds less that noise. Both
    by median absolute deviations: a start, a stop or a few bad samples do not count.
    """
    dt = float(np.median(np.diff(t))) if t.size > 1 else 0.0
    lag = max(round(LAG / dt), 1) if dt > 0.0 else 1
    if y.size < 4 * lag:
        return 0.0, 0.0
    even = np.diff(t) < 1.5 * dt
    noise = robust_sd(np.diff(y, 3)[even[2:] & even[1:-1] & even[:-2]]) ** 2 / 20.0
    change = robust_sd((y[lag:] - y[:-lag])[t[lag:] - t[:-lag] < 1.5 * lag * dt]) ** 2
    return noise, max(change - 2.0 * noise, 0.1 * change) / (lag * dt)


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
    if residual.size < 4 * size:
        return robust_sd(residual) ** 2
    return max(size * robust_sd(block_means(residual, size)) ** 2, 0.1 * robust_sd(residual) ** 2)
