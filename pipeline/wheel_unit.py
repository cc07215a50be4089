"""What a wheel-mounted unit says, turned to its wheel's axes, and what is asked of it by more than one
estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from .wheel_series import Floats, block_means, fit_walk, robust_sd

Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Series = TypeVar("Series", Floats, Complexes)

FULL_SCALES = np.radians([250.0, 500.0, 1000.0, 2000.0, 4000.0])  # rad/s, of common gyros
SPIKE = 10.0  # robust standard deviations from the median of five
REST_SPIN = 0.01  # rad/s by gravity, over two seconds: slower is standing
REST_GYRO = 0.15  # rad/s: no gyro bias is larger
CLUSTER = 3  # s, after which residuals are taken to be independent


@dataclass(frozen=True)
class Doubt:
    """Standard deviations, about zero, of what a unit's manifest entry leaves open.

    gyro_bias rad/s, accel_bias m/s², offset m, gyro_scale and accel_scale 1, tilt rad (mounting)
    """

    gyro_bias: float = 0.02
    accel_bias: float = 0.3
    offset: float = 0.03
    gyro_scale: float = 0.01
    accel_scale: float = 0.02
    tilt: float = 0.02


@dataclass(frozen=True)
class Unit:
    """A unit's samples along the axes that its manifest entry calls the wheel's.

    t : (N,) s from its first sample; plane : (N,) F = f_z − i·f_x, side : (N,) f_y, m/s²
    axle : (N,) gyro about the axle, across : (N,) G = g_z + i·g_x, rad/s
    axle_ok, across_ok : (N,) samples of the gyros to be trusted
    radius : m, about the wheel's rolling radius; place : P = ρ_z − i·ρ_x, m, where the unit sits
    carrier : (N, 3) rad/s, angular velocity of the body that carries the wheel, at the same instants, or None
    carrier_ok : (N,) where the carrier's own unit had samples
    """

    t: Floats
    plane: Complexes
    side: Floats
    axle: Floats
    across: Complexes
    axle_ok: Bools
    across_ok: Bools
    radius: float
    place: complex
    carrier: Floats | None = None
    carrier_ok: Bools | None = None

    @property
    def swings(self) -> Floats:
        """The carrier's roll and pitch rate less their medians, 0 where unseen, (N, 2); (N, 0) without a
        carrier.
        """
        if self.carrier is None:
            return np.empty((self.t.size, 0))
        rates = self.carrier[:, :2] - np.median(self.carrier[:, :2], axis=0)
        return np.where(self.carried[:, None], rates, 0.0)

    @property
    def carried(self) -> Bools:
        """Where the carrier's rates are known."""
        if self.carrier is None or self.carrier_ok is None:
            return np.full(self.t.size, self.carrier is not None)
        return self.carrier_ok


def trusted(values: Floats) -> Bools:
    """Samples of a gyro axis (or an angle) that are neither clipped nor spikes.

    Clipped: three or more equal samples in a row within 1 % of a customary full scale. Spike: `SPIKE` robust
    standard deviations off the median of its five neighbours.
    """
    same = values[1:] == values[:-1]
    run = np.flatnonzero(same[1:] & same[:-1])
    run = run[(np.abs(np.abs(values[run, None]) / FULL_SCALES - 1.0) < 0.01).any(axis=1)]
    clipped = np.zeros(values.size, dtype=bool)
    clipped[np.concatenate([run, run + 1, run + 2])] = True
    off = values - median_filter(values, 5)
    limit = SPIKE * max(robust_sd(off), robust_sd(np.diff(values)), 1.0e-4)
    return ~clipped & (np.abs(off) <= limit)


def per_second(t: Floats) -> int:
    """Samples in a second, at least one."""
    return max(round(1.0 / float(np.median(np.diff(t)))), 1)


def integrate(t: Floats, rate: Floats) -> Floats:
    """Trapezoids from 0 at the first sample: (N,)."""
    return np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))


def running_mean(values: Series, half: int) -> Series:
    """Mean over `half` samples to either side, fewer (but as many on both sides) near the ends."""
    index = np.arange(values.size)
    reach = np.minimum(np.minimum(index, values.size - 1 - index), half)
    total = np.append(0.0, np.cumsum(values))
    mean: Series = (total[index + reach + 1] - total[index - reach]) / (2 * reach + 1)
    return mean


def by_state(rest: Bools, values: Complexes) -> Complexes:
    """Median of the samples at rest and of those in motion, each written over its own samples."""
    found = np.zeros_like(values)
    for state in (rest, ~rest):
        if state.any():
            part = values[state]
            found[state] = np.median(part.real) + 1j * np.median(part.imag)
    return found


def standing(unit: Unit) -> Bools:
    """Where the wheel stands: gravity keeps its direction in the unit over two seconds, and the gyro is
    quiet.
    """
    size = per_second(unit.t)
    blocks = unit.t.size // size
    if blocks < 3:
        return np.zeros(unit.t.size, dtype=bool)
    means = block_means(unit.plane.real, size) + 1j * block_means(unit.plane.imag, size)
    turn = np.abs(np.angle(means[2:] * np.conj(means[:-2]))) / 2.0
    quiet = np.abs(block_means(unit.axle, size)) < REST_GYRO
    still = np.zeros(blocks, dtype=bool)
    still[1:-1] = (turn < REST_SPIN) & quiet[1:-1] & quiet[2:] & quiet[:-2]
    still[0], still[-1] = still[1], still[-2]
    return np.append(np.repeat(still, size), np.full(unit.t.size - blocks * size, still[-1]))


def walk_of(t: Floats, y: Floats, rest: Bools, usable: Bools) -> tuple[Floats, Floats, float]:
    """Walk's steps (N-1,), noise variance (N,), and the walk while moving; standing and moving judged
    apart.
    """
    walk, noise = np.zeros(t.size), np.zeros(t.size)
    for state in (rest, ~rest):
        chosen = state & usable
        if chosen.any():
            noise[state], walk[state] = fit_walk(t[chosen], y[chosen])
    floor = max(float(np.median(noise)) * 0.05, 1.0e-12)
    noise, walk = np.maximum(noise, floor), np.maximum(walk, 1.0e-12)
    return np.diff(t) * np.maximum(walk[1:], walk[:-1]), noise, float(np.max(walk))


def bridged(t: Floats, usable: Bools, walk: float) -> Floats:
    """Variance of a walking rate's integral over each step (N-1,) where samples lack: ∫∫ gives walk·gap³/12.

    walk : units²/s, of the rate; it is known at both ends of the gap
    """
    dt = np.diff(t)
    gap = np.where((dt > 1.5 * np.median(dt)) | ~usable[1:], dt, 0.0)
    return walk * _run_lengths(gap) ** 3 / 12.0


def _run_lengths(gap: Floats) -> Floats:
    """Length of each run of non-zero gaps, written at its last member, 0 elsewhere."""
    total = np.cumsum(gap)
    ends = (gap > 0.0) & np.append(gap[1:] == 0.0, True)
    lengths = np.zeros_like(gap)
    lengths[ends] = np.diff(np.append(0.0, total[ends]))
    return lengths
