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
from .wheel_series import Constants, Floats, Walk, signal, slow_noise, smooth, solve, whitened_products
from .wheel_unit import (
    CLUSTER,
    Bools,
    Complexes,
    Doubt,
    Unit,
    bridged,
    by_state,
    integrate,
    per_second,
    running_mean,
    standing,
    walk_of,
)

BIAS, SCALE, TURN, FORCE_X, FORCE_Z, PLACE_X, PLACE_Z, GRAVITY_SCALE = range(8)
COUNT, DRIFTS, Y = 8, slice(0, 3), 0  # columns hold the measurement first, then the regressors in this order
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
    step : the phase's walk; at_rest : what standing still says about the gyro's bias; seen : the force is
    to be trusted
    """

    t: Floats
    force: Complexes
    turned: Floats
    heading: Floats
    lever: Complexes
    along: Floats
    step: Floats
    rest: Bools
    seen: Bools
    at_rest: Floats


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
    seen = smooth(gyro[:, None], Walk(step, np.where(unit.axle_ok, noise, np.inf)))
    return seen.columns[:, 0], seen.variance, noise, walk


def _case(unit: Unit, gyro: Floats, spin: Floats, noise: Floats, walk: float, rest: Bools) -> _Case:
    acceleration = np.gradient(spin, unit.t)
    lever: Complexes = spin**2 + 1j * acceleration
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
        seen=unit.plane_ok,
        at_rest=_rest_products(rest, noise),
    )


def _rough_yaw_rate(unit: Unit, force: Complexes, turned: Floats, rest: Bools) -> Floats:
    """The wheel's yaw rate by the coarse phase, biases and leaked spin taken for constant: good to 0.01
    rad/s.
    """
    phase = turned + _coarse_error(unit.t, force, turned)
    back = (unit.across - by_state(rest, unit.across)) * np.exp(1j * phase)
    return running_mean(np.where(unit.across_ok, back.real, 0.0), per_second(unit.t) // 4)


def _tilt(unit: Unit, spin: Floats, yaw_rate: Floats) -> Floats:
    """Tilt φ of the axle (left end up), sin φ = (f_y − v·r)/g averaged: v·r is the hub's acceleration to
    the left.
    """
    sine = (unit.side - unit.radius * spin * yaw_rate) / GRAVITY
    return running_mean(np.clip(sine, -0.5, 0.5), round(TILT_REACH * per_second(unit.t)))


def _slow(unit: Unit, acceleration: Floats) -> Floats:
    """The vehicle's share of the spin's acceleration: pitching on rough ground is faster than half a
    second.
    """
    return running_mean(acceleration, per_second(unit.t) // 4)


def _phase_walk(unit: Unit, noise: Floats, spin_walk: float) -> Floats:
    """Variance that the gyro's noise adds to the phase from sample to sample, gaps bridged by a walking
    spin.
    """
    dt = np.diff(unit.t)
    return dt * (float(np.median(dt)) * noise[1:] + BIAS_WANDER) + bridged(unit.t, unit.axle_ok, spin_walk)


def _phase_error(case: _Case, doubt: Doubt) -> tuple[Floats, Floats, Constants]:
    """What is to be added to the integrated gyro, its variance, and the unit's constants.

    Linear in everything but the error itself, which the first look gives to a few degrees: iterated.
    """
    error = _coarse_error(case.t, case.force, case.turned)
    drift = -np.column_stack([case.t - case.t.mean(), case.turned, case.heading])
    residual = case.force * np.exp(-1j * (case.turned + error)) - 1.0
    size = CLUSTER * per_second(case.t)
    for _ in range(ITERATIONS):
        radial, tangential = _columns(case, error, drift)
        noise = _force_noise(residual, case)
        walked = smooth(tangential, Walk(case.step, noise.imag), size)
        still = whitened_products(radial, noise.real, size)
        constants = solve([walked.products, still, case.at_rest], _prior(doubt))
        error, variance = signal(walked, constants, drift)
        left = np.append(1.0, -constants.value)
        residual = radial @ left + 1j * (tangential @ left + drift @ constants.value[DRIFTS] - error)
    return error, variance, constants


def _prior(doubt: Doubt) -> Floats:
    leaning = np.hypot(doubt.accel_bias / GRAVITY, doubt.tilt)
    force, place = [doubt.accel_bias] * 2, [doubt.offset] * 2
    return np.array([doubt.gyro_bias, doubt.gyro_scale, leaning, *force, *place, doubt.accel_scale])


def _columns(case: _Case, error: Floats, drift: Floats) -> tuple[Floats, Floats]:
    """Measurement and regressors of the force turned back: radial and tangential, (N, 1+COUNT) each.

    Tangential is linearised about `error`: sin(θ − θ̂) + error. drift : (N, 3) of the phase itself
    """
    back = np.exp(-1j * (case.turned + error))
    seen = case.force * back
    lever = case.lever * back
    radial, tangential = np.zeros((back.size, 1 + COUNT)), np.zeros((back.size, 1 + COUNT))
    radial[:, Y], tangential[:, Y] = seen.real - 1.0, seen.imag + case.along + error
    radial[:, 1 + FORCE_X], tangential[:, 1 + FORCE_X] = back.imag / GRAVITY, -back.real / GRAVITY
    radial[:, 1 + FORCE_Z], tangential[:, 1 + FORCE_Z] = back.real / GRAVITY, back.imag / GRAVITY
    radial[:, 1 + PLACE_X], tangential[:, 1 + PLACE_X] = -lever.imag, lever.real
    radial[:, 1 + PLACE_Z], tangential[:, 1 + PLACE_Z] = -lever.real, -lever.imag
    radial[:, 1 + GRAVITY_SCALE] = 1.0
    tangential[:, 1 : 1 + drift.shape[1]] = drift
    return radial, tangential


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
    return np.where(case.seen, noise, complex(np.inf, np.inf))


def _coarse_error(t: Floats, force: Complexes, turned: Floats) -> Floats:
    """Phase less integrated gyro, from gravity averaged over a second after turning it back."""
    back = running_mean(force * np.exp(-1j * turned), round(COARSE * per_second(t)))
    return np.unwrap(np.angle(back))


def _rest_products(rest: Bools, noise: Floats) -> Floats:
    """Standing still says that the gyro's bias, its median at rest taken off, is zero within its noise."""
    products = np.zeros((1, 1 + COUNT, 1 + COUNT))
    if rest.any():
        products[0, 1 + BIAS, 1 + BIAS] = np.count_nonzero(rest) / (1.57 * np.median(noise[rest]))
    return products
