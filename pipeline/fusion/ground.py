"""The ground under a pass: its slope by altitudes and by what accelerometers on both bodies read."""

from __future__ import annotations

import math
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


def sloping(bodies: Sequence[Leaning]) -> float:
    """Deviation of the ground's cross slope, rad, by which its readings on all bodies are as large as they are.

    Maximum likelihood of a prior's variance ("type II"): what was read, squared, less the variance that the sensors'
    own constant errors give it, in the direction where most of it is left. 0 where the errors explain the readings.
    """
    if not bodies:
        return 0.0
    covariance = np.linalg.inv(sum(b.matrix for b in bodies) + np.eye(2) / STEEPEST**2)
    gradient = covariance @ sum(b.vector for b in bodies)
    variances, axes = np.linalg.eigh(covariance)
    return math.sqrt(max(float(np.max((axes.T @ gradient) ** 2 - variances)), 0.0))


def of_the_ground(e: Epochs) -> NDArray[np.bool_]:
    """Whether an altitude is the ground's: one that stands apart from all others (a fix in two dimensions reads 0 m) is
    none."""
    if not np.isfinite(e.z).any():
        return np.zeros(e.z.size, dtype=bool)
    apart = np.abs(e.z - np.nanmedian(e.z))
    return np.asarray(apart <= APART + 10.0 * np.nanmedian(apart))


def ground_slope(e: Epochs, bodies: Sequence[Leaning] = ()) -> tuple[Floats, Floats]:
    """Gradient (2,) of the ground east and north, and its covariance (2, 2), from altitudes along the path.

    Ridge regression: altitudes err slowly, by twice the horizontal deviation; a gradient that the path does not
    show has the prior of a field as level as the one it shows and as the `bodies` on it read, never better than SLOPE.
    The last of the bodies, where there are two, is the seeder, whose reading the filter does not have: it is taken in
    here.
    """
    seen = sloping(bodies)
    ok = of_the_ground(e)
    A, z, noise = np.zeros((0, 2)), np.zeros(0), 1.0
    prior = max(3.0 * physics.SLOPE, seen)
    if ok.sum() >= 20:
        A = np.column_stack([e.x[ok] - e.x[ok].mean(), e.y[ok] - e.y[ok].mean()])
        z = e.z[ok] - np.median(e.z[ok])
        independent = max((e.t[ok][-1] - e.t[ok][0]) / physics.TAU_GNSS, 2.0)
        noise = (2.0 * float(np.median(e.sd[ok]))) ** 2 * ok.sum() / independent
        loose = np.linalg.solve(A.T @ A / noise + np.eye(2) / 0.05**2, A.T @ z / noise)
        prior = max(physics.SLOPE, float(np.hypot(*loose)), seen)
    information: Floats = A.T @ A / noise + np.eye(2) / prior**2
    vector: Floats = A.T @ z / noise
    for body in bodies[1:]:
        information, vector = information + body.matrix, vector + body.vector
    return np.asarray(np.linalg.solve(information, vector)), np.asarray(np.linalg.inv(information))


def undulation(e: Epochs, gradient: Floats, way: Floats, t: Floats, yaw: Floats) -> Floats:
    """Slope along the heading (N,), rad, that altitudes over HILL_WINDOW of way show beside a plane of that gradient.

    way : (N,) m, distance along the heading (backwards it falls) at the nodes t. Shrunk by the altitudes' noise, which
    leaves of a metre-level receiver's nothing.
    """
    ok = of_the_ground(e)
    at = np.interp(e.t[ok], t, way)
    if at.size < 20 or at.max() - at.min() < 2.0 * HILL_WINDOW:
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
    """Variance of the mean lean over rough ground in `duration` seconds, rad²."""
    return physics.ROUGH**2 * 2.0 * physics.ROUGH_TIME / max(duration, 1.0)
