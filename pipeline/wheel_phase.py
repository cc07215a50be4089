"""Phase and spin of a wheel from the unit that turns with it.

Wheel's frame at phase θ: gravity's reaction reads (−g·sin θ, 0, g·cos θ). With the complex in-plane force
F = f_z − i·f_x, ω the spin and α its rate:

    F = (g + a_z − i·a_x)·e^{iθ} + B − (ω² + iα)·P + noise,    B = b_z − i·b_x,  P = ρ_z − i·ρ_x

(a_x, a_z: the hub's acceleration along the wheel's heading and up; b: the accelerometer's bias; ρ: the
unit's place on the wheel). The axle's gyro reads θ̇ + r·sin φ (r: yaw rate, φ: the axle's tilt, which is
worth degrees in a headland turn) and gives θ but for its bias, scale and random walk; gravity holds
those. Phase is that of the unit's frame as the manifest states it: how far the unit is turned about the
axle against that statement cannot be seen, and does not matter to what is demodulated with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..sensors.manifest import GRAVITY
from .wheel_series import Constants, Floats, Walk, signal, slow_noise, smooth, solve, whiten
from .wheel_unit import (
    CLUSTER,
    Bools,
    Complexes,
    Doubt,
    Unit,
    by_state,
    integrate,
    per_second,
    run_lengths,
    running_mean,
    standing,
    walk_of,
)

BIAS, SCALE, TURN, FORCE_X, FORCE_Z, PLACE_X, PLACE_Z, GRAVITY_SCALE = range(8)
COUNT = 8
BIAS_WANDER = 1.0e-4**2  # rad²/s: what the axle gyro's bias instability adds to the phase's walk
WANDER_LAG = 30.0  # s, over which gravity takes the phase's walk off again
COARSE = 0.5  # s to either side, of the first look at the phase error
TILT_REACH = 1.0  # s to either side, over which the axle's tilt is averaged
TILT_SD = 0.005  # rad, doubt of that average but for its constant part
ITERATIONS = 2


@dataclass(frozen=True)
class Phase:
    """Phase θ and spin with standard deviations, (N,).

    phase : rad, unwrapped, positive rolling forward, against gravity
    spin : rad/s about the axle, smoothed; gyro : the same, not smoothed
    rest : standing still; constants : biases and places, see the indices above
    """

    phase: Floats
    phase_sd: Floats
    spin: Floats
    gyro: Floats
    rest: Bools
    constants: Constants


@dataclass(frozen=True)
class _Case:
    """What the phase's error is sought from; accelerations in units of g.

    turned : integrated axle gyro; heading : integral of the yaw rate; lever : ω² + iα; along : α·radius;
    step : the phase's walk; rest_row : what standing still says about the gyro's bias
    """

    t: Floats
    force: Complexes
    turned: Floats
    heading: Floats
    lever: Complexes
    along: Floats
    step: Floats
    rest: Bools
    rest_row: Floats


def estimate_phase(unit: Unit, doubt: Doubt) -> Phase:
    """Smoothed phase and spin of a unit."""
    rest = standing(unit)
    gyro = unit.axle - (float(np.median(unit.axle[rest])) if rest.any() else 0.0)
    spin, _, noise, walk = _smooth_gyro(unit, gyro, rest)
    case = _case(unit, np.where(unit.axle_ok, gyro, spin), spin, noise, walk, rest)
    error, error_variance, constants = _phase_error(case, doubt)
    bias, scale = constants.value[[BIAS, SCALE]]
    return Phase(
        phase=case.turned + error,
        phase_sd=np.sqrt(error_variance),
        spin=spin - bias - scale * spin,
        gyro=gyro - bias - scale * gyro,
        rest=rest,
        constants=constants,
    )


def _smooth_gyro(unit: Unit, gyro: Floats, rest: Bools) -> tuple[Floats, Floats, Floats, float]:
    """Smoothed rate, its variance, each sample's noise variance, and the rate's random walk [units²/s]."""
    step, noise, walk = walk_of(unit.t, gyro, rest, unit.axle_ok)
    seen = smooth(gyro, np.empty((gyro.size, 0)), Walk(step, np.where(unit.axle_ok, noise, np.inf)))
    return seen.columns[:, 0], seen.variance, noise, walk


def _case(unit: Unit, gyro: Floats, spin: Floats, noise: Floats, walk: float, rest: Bools) -> _Case:
    acceleration = np.gradient(spin, unit.t)
    lever = spin**2 + 1j * acceleration
    force = (unit.plane + lever * unit.place) / GRAVITY
    turned = integrate(unit.t, gyro)
    yaw_rate = _rough_yaw_rate(unit, force, turned, rest)
    tilted = yaw_rate * _tilt(unit, spin, yaw_rate)
    return _Case(
        t=unit.t,
        force=force,
        turned=turned - integrate(unit.t, tilted),
        heading=integrate(unit.t, yaw_rate),
        lever=lever / GRAVITY,
        along=unit.radius * _slow(unit, acceleration) / GRAVITY,
        step=_phase_walk(unit, noise, walk)
        + np.diff(unit.t) * 2.0 * TILT_REACH * (TILT_SD * yaw_rate[1:]) ** 2,
        rest=rest,
        rest_row=_rest_row(rest, noise),
    )


def _rough_yaw_rate(unit: Unit, force: Complexes, turned: Floats, rest: Bools) -> Floats:
    """The wheel's yaw rate by the coarse phase, biases and leaked spin taken for constant: good to 0.01
    rad/s.
    """
    phase = turned + _coarse_error(unit.t, force, turned)
    back = (unit.across - by_state(rest, unit.across)) * np.exp(1j * phase)
    return np.asarray(running_mean(np.where(unit.across_ok, back.real, 0.0), per_second(unit.t) // 4))


def _tilt(unit: Unit, spin: Floats, yaw_rate: Floats) -> Floats:
    """Tilt φ of the axle (left end up), sin φ = (f_y − v·r)/g averaged: v·r is the hub's acceleration to
    the left.
    """
    sine = (unit.side - unit.radius * spin * yaw_rate) / GRAVITY
    return np.asarray(running_mean(np.clip(sine, -0.5, 0.5), round(TILT_REACH * per_second(unit.t))))


def _slow(unit: Unit, acceleration: Floats) -> Floats:
    """The vehicle's share of the spin's acceleration: pitching on rough ground is faster than half a
    second.
    """
    return np.asarray(running_mean(acceleration, per_second(unit.t) // 4))


def _phase_walk(unit: Unit, noise: Floats, spin_walk: float) -> Floats:
    """Variance that the gyro's noise adds to the phase from sample to sample.

    Gaps are bridged by a spin that walks: ∫∫ gives walk·gap³/12.
    """
    dt = np.diff(unit.t)
    usual = float(np.median(dt))
    gap = np.where((dt > 1.5 * usual) | ~unit.axle_ok[1:], dt, 0.0)
    return dt * (usual * noise[1:] + BIAS_WANDER) + spin_walk * run_lengths(gap) ** 3 / 12.0


def _phase_error(case: _Case, doubt: Doubt) -> tuple[Floats, Floats, Constants]:
    """What is to be added to the integrated gyro, its variance, and the unit's constants.

    Linear in everything but the error itself, which the first look gives to a few degrees: iterated.
    """
    error = _coarse_error(case.t, case.force, case.turned)
    drift = np.zeros((case.t.size, COUNT))
    drift[:, BIAS], drift[:, SCALE], drift[:, TURN] = -(case.t - case.t.mean()), -case.turned, -case.heading
    residual = case.force * np.exp(-1j * (case.turned + error)) - 1.0
    size = CLUSTER * per_second(case.t)
    for _ in range(ITERATIONS):
        back = np.exp(-1j * (case.turned + error))
        seen = case.force * back + 1j * case.along
        columns = _force_columns(back, case.lever)
        noise = _force_noise(residual, case)
        tangential = smooth(seen.imag + error, columns.imag + drift, Walk(case.step, noise.imag))
        radial = whiten(seen.real - 1.0, columns.real, noise.real)
        constants = solve([tangential.whitened, radial, case.rest_row], _prior(doubt), [size, size, 0])
        better, variance = signal(tangential, constants, drift)
        residual = seen - 1.0 - columns @ constants.value - 1j * (better - error)
        error = better
    return error, variance, constants


def _prior(doubt: Doubt) -> Floats:
    leaning = np.hypot(doubt.accel_bias / GRAVITY, doubt.tilt)
    force, place = [doubt.accel_bias] * 2, [doubt.offset] * 2
    return np.array([doubt.gyro_bias, doubt.gyro_scale, leaning, *force, *place, doubt.accel_scale])


def _force_columns(back: Complexes, lever: Complexes) -> Complexes:
    """Complex regressors (N, COUNT) of the demodulated force: real part radial, imaginary part tangential."""
    columns = np.zeros((back.size, COUNT), dtype=np.complex128)
    columns[:, FORCE_X], columns[:, FORCE_Z] = -1j * back / GRAVITY, back / GRAVITY
    columns[:, PLACE_X], columns[:, PLACE_Z] = 1j * lever * back, -lever * back
    columns[:, GRAVITY_SCALE] = 1.0
    return columns


def _force_noise(residual: Complexes, case: _Case) -> Complexes:
    """Variance of each sample of the demodulated force (radial + i·tangential) that stands for its slow part.

    Standing and moving are judged apart.
    """
    size = per_second(case.t)
    noise = np.empty(case.t.size, dtype=np.complex128)
    for state in (case.rest, ~case.rest):
        radial = max(slow_noise(residual.real[state], size), 1.0e-10)
        tangential = max(slow_noise(residual.imag[state], size), 1.0e-10)
        noise[state] = radial + 1j * tangential
    return noise


def _coarse_error(t: Floats, force: Complexes, turned: Floats) -> Floats:
    """Phase less integrated gyro, from gravity averaged over a second after turning it back."""
    back = running_mean(force * np.exp(-1j * turned), round(COARSE * per_second(t)))
    return np.unwrap(np.angle(back))


def _rest_row(rest: Bools, noise: Floats) -> Floats:
    """Standing still says that the gyro's bias, its median at rest taken off, is zero within its noise."""
    row = np.zeros((1, 1 + COUNT))
    if rest.any():
        row[0, 1 + BIAS] = np.sqrt(np.count_nonzero(rest) / (1.57 * np.median(noise[rest])))
    return row
