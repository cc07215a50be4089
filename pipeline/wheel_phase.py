"""Phase and spin of a wheel from the unit that turns with it.

Wheel's frame at phase θ: gravity's reaction reads (−g·sin θ, 0, g·cos θ). With the complex in-plane force
F = f_z − i·f_x and ω the spin, α its rate:

    F = (g + a_z − i·a_x)·e^{iθ} + B − (ω² + iα)·P + noise,    B = b_z − i·b_x,  P = ρ_z − i·ρ_x

(a_x, a_z: the hub's acceleration along the wheel's heading and up; b: the accelerometer's bias; ρ: the
unit's place on the wheel). The axle's gyro gives θ but for its bias, scale and random walk; gravity holds
those. Phase is that of the unit's frame as the manifest states it: how far the unit is turned about the
axle against that statement cannot be seen, and does not matter to what is demodulated with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..sensors.manifest import GRAVITY
from .wheel_series import (
    Constants,
    Floats,
    Walk,
    block_means,
    fit_walk,
    signal,
    slow_noise,
    smooth,
    solve,
    whiten,
)

Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]

BIAS, SCALE, FORCE_X, FORCE_Z, PLACE_X, PLACE_Z, GRAVITY_SCALE = range(7)
BIAS_WANDER = 1.0e-4**2  # rad²/s: what the axle gyro's bias instability adds to the phase's walk
REST_SPIN = 0.01  # rad/s by gravity, over two seconds: slower is standing
REST_GYRO = 0.15  # rad/s: no gyro bias is larger
COARSE = 1.0  # s, window of the first look at the phase error
ITERATIONS = 3
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
class Phase:
    """Phase θ and spin with standard deviations, (N,).

    phase : rad, unwrapped, positive rolling forward, against gravity; spin : rad/s, its rate
    rolling, rolling_sd : rad/s, spin less what it shares with the carrier's pitching: times the effective
    radius
        it is the hub's speed
    rest : standing still; constants : biases and places, see the indices above
    """

    phase: Floats
    phase_sd: Floats
    spin: Floats
    rolling: Floats
    rolling_sd: Floats
    rest: Bools
    constants: Constants


def estimate_phase(
    t: Floats, force: Complexes, gyro: Floats, radius: float, place: complex, usable: Bools, doubt: Doubt,
    pitch_rate: Floats | None = None,
) -> Phase:  # fmt: skip
    """Smoothed phase and spin.

    t : (N,) s; force : (N,) F of the module's equation, m/s²; gyro : (N,) rad/s about the axle; radius : m,
    rolling radius, to take the vehicle's acceleration α·radius off; place : P, m; usable : (N,) samples of
    the gyro to be trusted; pitch_rate : (N,) rad/s of the body that carries the wheel
    """
    rest = standing(t, force, gyro)
    gyro = gyro - (float(np.median(gyro[rest])) if rest.any() else 0.0)
    shared = np.zeros_like(t) if pitch_rate is None else _common(t, gyro, pitch_rate, ~rest)
    spin, _, noise, walk = _smooth_gyro(t, gyro, rest, usable)
    rolling, rolling_variance, _, _ = _smooth_gyro(t, gyro - shared, rest, usable)
    lever = spin**2 + 1j * np.gradient(spin, t)
    case = _Case(
        t=t,
        force=(force + lever * place) / GRAVITY,
        turned=integrate(t, np.where(usable, gyro, spin)),
        lever=lever / GRAVITY,
        along=radius * np.gradient(rolling, t) / GRAVITY,
        step=_phase_walk(t, usable, noise, walk),
        rest=rest,
        rest_rows=_rest_rows(rest, noise),
    )
    error, error_variance, constants = _phase_error(case, doubt)
    shape = np.column_stack([np.ones_like(t), rolling])
    both = np.ix_([BIAS, SCALE], [BIAS, SCALE])
    doubt_variance = np.einsum("ij,jk,ik->i", shape, constants.covariance[both], shape)
    correction = shape @ constants.value[[BIAS, SCALE]]
    return Phase(
        phase=case.turned + error,
        phase_sd=np.sqrt(error_variance),
        spin=spin - correction,
        rolling=rolling - correction,
        rolling_sd=np.sqrt(rolling_variance + doubt_variance + BIAS_WANDER / 30.0),
        rest=rest,
        constants=constants,
    )


def _common(t: Floats, gyro: Floats, pitch_rate: Floats, moving: Bools) -> Floats:
    """What the axle's gyro shares with the carrier's pitch rate: its image in it over changes of 50 ms.

    A wheel carried by a pitching body turns with it in full when the contact does not slip, in part or not at
    all in other suspensions, so the share is measured and not assumed; changes are used because bias and
    speed drop out.
    """
    lag = max(per_second(t) // 20, 1)
    if np.count_nonzero(moving) < 10 * lag:
        return np.zeros_like(t)
    both = moving[lag:] & moving[:-lag]
    swing, seen = (x[lag:] - x[:-lag] for x in (pitch_rate, gyro))
    power = float(swing[both] @ swing[both])
    share = float(swing[both] @ seen[both]) / power if power > 0.0 else 0.0
    return share * (pitch_rate - np.median(pitch_rate))


def standing(t: Floats, force: Complexes, gyro: Floats) -> Bools:
    """Where the wheel stands: gravity keeps its direction in the unit over two seconds, and the gyro is
    quiet.
    """
    size = per_second(t)
    blocks = force.size // size
    if blocks < 3:
        return np.zeros(t.size, dtype=bool)
    means = block_means(force.real, size) + 1j * block_means(force.imag, size)
    turn = np.abs(np.angle(means[2:] * np.conj(means[:-2]))) / 2.0
    quiet = np.abs(block_means(gyro, size)) < REST_GYRO
    still = np.zeros(blocks, dtype=bool)
    still[1:-1] = (turn < REST_SPIN) & quiet[1:-1] & quiet[2:] & quiet[:-2]
    still = still | np.append(still[1:] & quiet[:-1], False) | np.append(False, still[:-1] & quiet[1:])
    return np.append(np.repeat(still, size), np.full(t.size - blocks * size, still[-1]))


def integrate(t: Floats, rate: Floats) -> Floats:
    """Trapezoids from 0 at the first sample: (N,)."""
    return np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(t)))


def _smooth_gyro(t: Floats, gyro: Floats, rest: Bools, usable: Bools) -> tuple[Floats, Floats, Floats, float]:
    """Smoothed rate, its variance, each sample's noise variance, and the rate's random walk [units²/s]."""
    step, noise, walk = walk_of(t, gyro, rest, usable)
    seen = smooth(gyro, np.empty((t.size, 0)), Walk(step, np.where(usable, noise, np.inf)))
    return seen.columns[:, 0], seen.variance, noise, walk


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
    moving = float(np.max(walk))
    return np.diff(t) * np.maximum(walk[1:], walk[:-1]), noise, moving


def _phase_walk(t: Floats, usable: Bools, noise: Floats, spin_walk: float) -> Floats:
    """Variance that the gyro's noise adds to the phase from sample to sample, gaps bridged by a spin that
    walks.
    """
    dt = np.diff(t)
    usual = float(np.median(dt))
    gap = np.where((dt > 1.5 * usual) | ~usable[1:], dt, 0.0)
    return dt * (usual * noise[1:] + BIAS_WANDER) + spin_walk * _run_lengths(gap) ** 3 / 12.0


def _run_lengths(gap: Floats) -> Floats:
    """Length of each run of non-zero gaps, written at its last member, 0 elsewhere."""
    total = np.cumsum(gap)
    ends = (gap > 0.0) & np.append(gap[1:] == 0.0, True)
    lengths = np.zeros_like(gap)
    lengths[ends] = np.diff(np.append(0.0, total[ends]))
    return lengths


@dataclass(frozen=True)
class _Case:
    """What the phase's error is sought from; accelerations in units of g.

    turned : integrated gyro; lever : ω² + iα; along : α·radius; step : the phase's walk; rest_rows : what
    standing still says about the gyro's bias
    """

    t: Floats
    force: Complexes
    turned: Floats
    lever: Complexes
    along: Floats
    step: Floats
    rest: Bools
    rest_rows: Floats


def _phase_error(case: _Case, doubt: Doubt) -> tuple[Floats, Floats, Constants]:
    """What is to be added to the integrated gyro, its variance, and the unit's constants.

    Linear in everything but the error itself, which the first look gives to a few degrees: iterated.
    """
    error = _coarse_error(case)
    drift = np.zeros((case.t.size, 7))
    drift[:, BIAS], drift[:, SCALE] = -(case.t - case.t.mean()), -case.turned
    residual = case.force * np.exp(-1j * (case.turned + error)) - 1.0
    size = CLUSTER * per_second(case.t)
    for _ in range(ITERATIONS):
        back = np.exp(-1j * (case.turned + error))
        seen = case.force * back + 1j * case.along
        columns = _force_columns(back, case.lever)
        tangential = smooth(
            seen.imag + error, columns.imag + drift, Walk(case.step, _force_noise(residual.imag, case))
        )
        radial = whiten(seen.real - 1.0, columns.real, _force_noise(residual.real, case))
        constants = solve([tangential.whitened, radial, case.rest_rows], _prior(doubt), [size, size, 0])
        better, variance = signal(tangential, constants, drift)
        residual = seen - 1.0 - columns @ constants.value - 1j * (better - error)
        error = better
    return error, variance, constants


def _prior(doubt: Doubt) -> Floats:
    force, place = [doubt.accel_bias] * 2, [doubt.offset] * 2
    return np.array([doubt.gyro_bias, doubt.gyro_scale, *force, *place, doubt.accel_scale])


def _force_columns(back: Complexes, lever: Complexes) -> Complexes:
    """Complex regressors (N, 7) of the demodulated force: real part radial, imaginary part tangential."""
    columns = np.zeros((back.size, 7), dtype=np.complex128)
    columns[:, FORCE_X], columns[:, FORCE_Z] = -1j * back / GRAVITY, back / GRAVITY
    columns[:, PLACE_X], columns[:, PLACE_Z] = 1j * lever * back, -lever * back
    columns[:, GRAVITY_SCALE] = 1.0
    return columns


def _force_noise(residual: Floats, case: _Case) -> Floats:
    """Variance of each sample of the demodulated force that stands for its slow part, standing and moving
    apart.
    """
    size = per_second(case.t)
    noise = np.empty(case.t.size)
    for state in (case.rest, ~case.rest):
        noise[state] = max(slow_noise(residual[state], size), 1.0e-10)
    return noise


def _coarse_error(case: _Case) -> Floats:
    """Phase less integrated gyro, from gravity averaged over `COARSE` seconds after turning it back."""
    size = min(max(int(COARSE * per_second(case.t)), 1), case.t.size)
    back = case.force * np.exp(-1j * case.turned)
    low = np.maximum(np.arange(case.t.size) - size // 2, 0)
    high = np.minimum(low + size, case.t.size)
    total = np.append(0.0, np.cumsum(back))
    return np.unwrap(np.angle(total[high] - total[low]))


def _rest_rows(rest: Bools, noise: Floats) -> Floats:
    """Standing still says that the gyro's bias, its median at rest taken off, is zero within its noise."""
    row = np.zeros((1, 8))
    if rest.any():
        row[0, 1 + BIAS] = np.sqrt(np.count_nonzero(rest) / (1.57 * np.median(noise[rest])))
    return row


def per_second(t: Floats) -> int:
    """Samples in a second, at least one."""
    return max(round(1.0 / float(np.median(np.diff(t)))), 1)
