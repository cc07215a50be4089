"""What a wheel-mounted unit says, turned to its wheel's axes, and what is asked of it by more than one
estimator.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ..sensors.manifest import GRAVITY
from .wheel_series import Floats, block_means, fit_walk, robust_sd

Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Series = TypeVar("Series", Floats, Complexes)

GYRO_SCALES = np.radians([250.0, 500.0, 1000.0, 2000.0, 4000.0])  # rad/s, of common gyros
ACCEL_SCALES = GRAVITY * np.array([2.0, 4.0, 8.0, 16.0, 24.0])  # m/s²
FROZEN = 20  # samples
BRIDGE = 1.0  # s, over which the walk that bridges gaps is judged
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
    plane_ok, axle_ok, across_ok : (N,) samples to be trusted
    radius : m, about the wheel's rolling radius; place : P = ρ_z − i·ρ_x, m, where the unit sits
    carrier : (N, 3) rad/s, angular velocity of the body that carries the wheel, at the same instants, or None
    carrier_ok : (N,) where the carrier's own unit had samples
    """

    t: Floats
    plane: Complexes
    side: Floats
    axle: Floats
    across: Complexes
    plane_ok: Bools
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
        seen = self.carried if self.carried.any() else np.ones(self.t.size, dtype=bool)
        rates = self.carrier[:, :2] - np.median(self.carrier[seen, :2], axis=0)
        return np.where(self.carried[:, None], rates, 0.0)

    @property
    def carried(self) -> Bools:
        """Where the carrier's rates are known."""
        if self.carrier is None or self.carrier_ok is None:
            return np.full(self.t.size, self.carrier is not None)
        return self.carrier_ok


def trusted(values: Floats, full_scales: Floats, spikes: bool = True) -> Bools:
    """Samples of one axis that are neither clipped, frozen, nor spikes.

    Clipped: three or more equal samples in a row within 1 % of a customary full scale. Frozen: `FROZEN`
    equal samples in a row in a series that otherwise changes. Spike: `SPIKE` robust standard deviations off
    the median of its five neighbours.
    """
    ends = np.append(np.flatnonzero(np.diff(values)), values.size - 1)
    lengths = np.diff(np.append(-1, ends))
    run = np.repeat(lengths, lengths)
    restless = robust_sd(np.diff(values))
    near = (run >= 3) & (np.abs(np.abs(values[:, None]) / full_scales - 1.0) < 0.01).any(axis=1)
    good = ~near & ((run < FROZEN) | (restless == 0.0))
    if not spikes:
        return good
    off = values - median_filter(values, 5)
    return good & (np.abs(off) <= SPIKE * max(robust_sd(off), restless, 1.0e-4))


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
    """Walk's steps (N-1,), noise variance (N,), and the walk over a gap; standing and moving are judged
    apart.

    A smooth signal walks faster over a second than over a tenth: gaps are bridged by the former.
    """
    walk, noise, wide = np.zeros(t.size), np.zeros(t.size), [1.0e-12]
    for state in (rest, ~rest):
        chosen = state & usable
        if chosen.any():
            noise[state], walk[state] = fit_walk(t[chosen], y[chosen])
            wide.append(fit_walk(t[chosen], y[chosen], BRIDGE)[1])
    floor = max(float(np.median(noise)) * 0.05, 1.0e-12)
    noise, walk = np.maximum(noise, floor), np.maximum(walk, 1.0e-12)
    dt, over = np.diff(t), max(wide)
    lacking = _lacking(t, usable)
    return dt * np.where(lacking, np.maximum(walk[1:], over), np.maximum(walk[1:], walk[:-1])), noise, over


def _lacking(t: Floats, usable: Bools) -> Bools:
    """Steps (N-1,) that lead over lost samples or to one that is not to be used."""
    dt = np.diff(t)
    return np.asarray((dt > 1.5 * np.median(dt)) | ~usable[1:])


def bridged(t: Floats, usable: Bools, walk: float) -> Floats:
    """Variance of a walking rate's integral over each step (N-1,) where samples lack.

    Over a gap whose ends are known it is walk·gap³/12, spread evenly over the gap's steps. walk : units²/s
    """
    dt, lacking = np.diff(t), _lacking(t, usable)
    begins = lacking & ~np.append(False, lacking[:-1])
    number = np.cumsum(begins) * lacking
    gap = np.bincount(number, weights=dt)[number]
    return np.where(lacking, walk * gap**2 * dt / 12.0, 0.0)
