"""The ground under a pass: its slope by altitudes and by what accelerometers on both bodies read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from . import settings as physics
from .epochs import Epochs

Floats = NDArray[np.float64]

HILL_WINDOW = 12.5  # m of way over which a slope is taken: longer than the machine
HILL_BINS = 25
HILL_INDEPENDENT = 3  # altitudes in that window whose errors are not the same
STEEPEST = 0.15  # rad: no field that is sown is steeper across
STEPS = 40  # of a field's steepness, from the least to STEEPEST
UNKNOWN = 1.0  # rad: deviation of a gradient that nothing reads
FEWEST = 20  # altitudes
WORSE = 3.0  # times the pass's usual deviation: such altitudes would be steps on its hills
APART = 5.0  # m, with ten times the median distance: altitudes that far from the median are not the ground's


@dataclass(frozen=True)
class Leaning:
    """What one body's accelerometers say of the ground's gradient by the roll they read, as information.

    matrix (2, 2), vector (2,) : normal equations of the gradient (east, north), the reading's constant error eliminated
    """

    matrix: Floats
    vector: Floats


def leaning(yaw: Floats, roll: Floats, sd: float, duration: float) -> Leaning:
    """Of a body's roll (N,), rad, at headings yaw (N,): slope to the left, a constant error N(0, sd²) and the lean on
    rough ground, whose mean over `duration` s is small."""
    axis = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    noise = rough_mean(duration) * yaw.size
    total = axis.sum(axis=0) / noise
    shared = yaw.size / noise + 1.0 / sd**2
    return Leaning(
        axis.T @ axis / noise - np.outer(total, total) / shared,
        axis.T @ roll / noise - total * (roll.sum() / noise / shared),
    )


@dataclass(frozen=True)
class Slope:
    """The ground's gradient east and north, as a measurement for a filter that has the tractor's accelerometer itself.

    gradient (2,), covariance (2, 2) : by altitudes, by the seeder's reading and by the steepness of the field
    known, doubt (2, 2) : covariance of the gradient as all readings together tell it at the mean steepness, and by the
        steepness being unknown
    """

    gradient: Floats
    covariance: Floats
    known: Floats
    doubt: Floats


@dataclass(frozen=True)
class Steepness:
    """How much of the readings of a gradient is slope, in their principal axes (columns of `axes` (2, 2)).

    precision (2,) : of the readings, 1/rad²; read (2,) : rad; share, spread (2,) : of the slope, mean and variance
    """

    axes: Floats
    precision: Floats
    read: Floats
    share: Floats
    spread: Floats

    @property
    def prior(self) -> Floats:
        """Precision (2, 2) of the normal prior that leaves the slope its mean share of the readings."""
        odds = self.precision * (1.0 - self.share) / self.share
        return np.asarray(self.axes @ np.diag(odds) @ self.axes.T)

    @property
    def doubt(self) -> Floats:
        """Covariance (2, 2) of the slope by the doubt of its share."""
        return np.asarray(self.axes @ np.diag(self.read**2 * self.spread) @ self.axes.T)


def steepness(information: Floats, vector: Floats) -> Steepness:
    """What readings of the gradient, their normal equations (2, 2) and (2,), say of how steep a field is.

    A field's slopes are N(0, s²) in each direction, and s is unknown: half-Cauchy with the median SLOPE (Gelman 2006),
    weighed by the likelihood of the readings. In each of the readings' principal axes a slope of variance s² has the
    share m = s²/(s² + v) of what was read with variance v.
    """
    known, axes = np.linalg.eigh(information)
    known = np.maximum(known, 1.0 / UNKNOWN**2)
    read = axes.T @ vector / known
    steep = np.geomspace(0.1 * physics.SLOPE, STEEPEST, STEPS)[:, None]
    share = steep**2 * known / (1.0 + steep**2 * known)
    likelihood = 0.5 * np.sum(np.log1p(-share) + known * read**2 * share, axis=1)
    weight = np.exp(likelihood - likelihood.max())[:, None] * steep / (1.0 + (steep / physics.SLOPE) ** 2)
    weight /= weight.sum()
    mean = np.sum(weight * share, axis=0)
    return Steepness(axes, known, read, mean, np.sum(weight * (share - mean) ** 2, axis=0))


def of_the_ground(e: Epochs) -> NDArray[np.bool_]:
    """Whether an altitude is the ground's: one that stands apart from all others (a fix in two dimensions reads 0 m) is
    none."""
    if not np.isfinite(e.z).any():
        return np.zeros(e.z.size, dtype=bool)
    apart = np.abs(e.z - np.nanmedian(e.z))
    return np.asarray(apart <= APART + 10.0 * np.nanmedian(apart))


def ground_slope(e: Epochs, bodies: Sequence[Leaning] = ()) -> Slope:
    """The ground's slope from altitudes along the path, what the bodies on it read, and how steep fields are.

    Altitudes err slowly, by twice the horizontal deviation. What of a reading across the path is slope and what the
    sensors' own constant errors is a matter of the field's steepness (`steepness`). The last of the bodies, where there
    are two, is the seeder, whose reading the filter does not have: it is taken in here.
    """
    information, vector = by_altitudes(e)
    all_of = information + sum((b.matrix for b in bodies), np.zeros((2, 2)))
    field = steepness(all_of, vector + sum((b.vector for b in bodies), np.zeros(2)))
    for body in bodies[1:]:
        information, vector = information + body.matrix, vector + body.vector
    covariance = np.asarray(np.linalg.inv(information + field.prior), dtype=np.float64)
    known = np.asarray(np.linalg.inv(all_of + field.prior), dtype=np.float64)
    return Slope(covariance @ vector, covariance, known, field.doubt)


def by_altitudes(e: Epochs) -> tuple[Floats, Floats]:
    """Normal equations (2, 2), (2,) of the gradient by the receiver's altitudes, each as good as its position."""
    ok = of_the_ground(e)
    if ok.sum() < FEWEST:
        return np.zeros((2, 2)), np.zeros(2)
    independent = max((e.t[ok][-1] - e.t[ok][0]) / physics.TAU_GNSS, 2.0)
    weight = independent / ok.sum() / (2.0 * e.sd[ok]) ** 2
    A = np.column_stack([e.x[ok], e.y[ok]])
    A = A - np.average(A, axis=0, weights=weight)
    z = e.z[ok] - np.average(e.z[ok], weights=weight)
    return A.T @ (A * weight[:, None]), A.T @ (z * weight)


def undulation(e: Epochs, gradient: Floats, way: Floats, t: Floats, yaw: Floats) -> Floats:
    """Slope along the heading (N,), rad, that altitudes over HILL_WINDOW of way show beside a plane of that gradient.

    way : (N,) m, distance along the heading (backwards it falls) at the nodes t. Shrunk by the altitudes' noise, which
    leaves of a metre-level receiver's nothing.
    """
    ok = of_the_ground(e)
    ok &= e.sd <= WORSE * np.median(e.sd)
    at = np.interp(e.t[ok], t, way)
    if at.size < FEWEST or at.max() - at.min() < 2.0 * HILL_WINDOW:
        return np.zeros(t.size)
    step = HILL_WINDOW / HILL_BINS
    bins = ((at - at.min()) / step).astype(np.int64)
    count = np.bincount(bins)
    height = np.bincount(bins, e.z[ok]) / np.maximum(count, 1)
    places = np.arange(count.size)
    height = np.interp(places, places[count > 0], height[count > 0])
    grade = savgol_filter(height, HILL_BINS, 1, deriv=1, delta=step)
    noise = 12.0 * (2.0 * float(np.median(e.sd[ok])) / HILL_WINDOW) ** 2 / HILL_INDEPENDENT
    plane = np.cos(yaw) * gradient[0] + np.sin(yaw) * gradient[1]
    here = np.interp((way - at.min()) / step - 0.5, places, grade)
    return np.asarray((here - plane) * physics.HILL**2 / (physics.HILL**2 + noise))


def rough_mean(duration: float) -> float:
    """Variance of the mean roll over rough ground in `duration` seconds, rad²."""
    return physics.ROUGH**2 * 2.0 * physics.ROUGH_TIME / max(duration, 1.0)


def rough_pitch(duration: float, rests: Floats) -> float:
    """Variance of the mean pitch over rough ground, rad²; rests : (K,) s that the machine stood on end.

    Pitch is the slope of the track that is driven: its mean over the way is what the way rises from end to end, which
    altitudes show, but for the height of the ground at both ends. While the machine stands it is one draw.
    """
    share = np.append(np.asarray(rests), [physics.ROUGH_TIME, physics.ROUGH_TIME]) / max(duration, 1.0)
    return float(physics.ROUGH**2 * min(np.sum(share**2), 1.0))


def standstills(way: Floats, step: float) -> Floats:
    """Durations (K,), s, for which the way (N,), m, every `step` s, stands."""
    stands = np.concatenate([[0], (np.diff(way) == 0.0).astype(np.int8), [0]])
    edges = np.flatnonzero(np.diff(stands))
    return np.asarray((edges[1::2] - edges[::2]) * step)
