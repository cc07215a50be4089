"""The wheel's yaw rate from the gyro axes across the axle, demodulated by the phase.

With the hub turning at roll rate p (about the wheel's heading), yaw rate r (about the upward normal of
axle and heading) and phase θ, the unit sees g_x = p·cos θ − r·sin θ, g_z = p·sin θ + r·cos θ, so with
G = g_z + i·g_x

    G = (r + i·p)·e^{−iθ} + β + ε·ω,    β = b_z + i·b_x,    r + i·p = (G − β − ε·ω)·e^{iθ}

β: gyro biases; ε·ω: the spin ω leaking through a mounting tilted against the axle. Both are fixed to the
unit, so turning them back moves them to the spin's frequency, where they are told from r and p, which are
not. At rest the phase stands and only the sum of both seen in one direction is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .wheel_phase import CLUSTER, Bools, Complexes, Doubt, Phase, integrate, per_second, walk_of
from .wheel_series import (
    Constants,
    Floats,
    Smoothed,
    Walk,
    block_means,
    robust_sd,
    signal,
    smooth,
    solve,
    whiten,
)

BIAS_X, BIAS_Z, TILT_X, TILT_Z = range(4)
SWING = 10  # s, over which the carrier's pitch angle has no mean of its own
STEADY = 0.02  # rad/s: a block at rest that departs this far from the others' median is being steered
STILL_SD = 1.0e-3  # rad/s: least doubt of a one-second mean at rest (sway, slow turns)


@dataclass(frozen=True)
class YawRate:
    """Yaw and roll rate of the hub.

    rate, rate_sd : (N,) rad/s, smoothed; roll_rate : (N,) rad/s, not smoothed
    turned, turned_variance : (N,) rad and rad², integral of the unsmoothed rate from the first sample, and
    how
        its variance grows; constants : biases and tilts, see the indices above
    """

    rate: Floats
    rate_sd: Floats
    roll_rate: Floats
    turned: Floats
    turned_variance: Floats
    constants: Constants


def estimate_yaw_rate(
    t: Floats, across: Complexes, phase: Phase, usable: Bools, doubt: Doubt, carrier: Floats | None = None
) -> YawRate:
    """Demodulated yaw rate.

    across : (N,) G of the module's equation, rad/s; usable : (N,) samples to be trusted
    carrier : (N, 3) rad/s, angular velocity of the body that carries the wheel, at the same instants. Its
        pitching is taken off the phase, so that rates are about the body's axes, and what the roll rate has
        in common with it no longer hides the unit's constants. The body's yaw rate is not used.
    """
    relative = phase.phase - (0.0 if carrier is None else _swing(t, carrier[:, 1]))
    turn = np.exp(1j * relative)
    back = across * turn
    clean = back - _first_constants(across, phase) * turn
    columns = np.column_stack([1j * turn, turn, 1j * turn * phase.spin, turn * phase.spin])
    shared = np.empty((t.size, 0)) if carrier is None else carrier[:, :2]
    blank = np.zeros_like(shared)
    yaw, noise = _smoothed(t, back.real, clean.real, np.hstack([columns.real, blank]), phase.rest, usable)
    clean_roll = clean.imag - _fit(shared, clean.imag)
    roll, _ = _smoothed(t, back.imag, clean_roll, np.hstack([columns.imag, shared]), phase.rest, usable)
    prior = np.array([doubt.gyro_bias] * 2 + [doubt.tilt] * 2 + [2.0] * shared.shape[1])
    rest_rows = _rest_rows(across, phase.rest, t, prior.size)
    size = CLUSTER * per_second(t)
    constants = solve([yaw.whitened, roll.whitened, rest_rows], prior, [size, size, 0])
    return _assemble(t, back, columns, (yaw, roll), noise, usable, constants)


def _assemble(
    t: Floats,
    back: Complexes,
    columns: Complexes,
    smoothed: tuple[Smoothed, Smoothed],
    noise: Floats,
    usable: Bools,
    constants: Constants,
) -> YawRate:
    rate, variance = signal(smoothed[0], constants)
    raw = back.real - columns.real @ constants.value[:4]
    grown = np.diff(t) * float(np.median(np.diff(t))) * noise[1:]
    return YawRate(
        rate=rate,
        rate_sd=np.sqrt(variance),
        roll_rate=back.imag - columns.imag @ constants.value[:4],
        turned=integrate(t, np.where(usable, raw, rate)),
        turned_variance=np.append(0.0, np.cumsum(grown + _bridged(t, usable, variance))),
        constants=constants,
    )


def _swing(t: Floats, rate: Floats) -> Floats:
    """Angle of a rate that swings about zero: its integral less the mean over `SWING` seconds about each
    sample.
    """
    angle = integrate(t, rate - np.median(rate))
    half = max(SWING * per_second(t) // 2, 1)
    total = np.append(0.0, np.cumsum(angle))
    index = np.arange(t.size)
    reach = np.minimum(np.minimum(index, t.size - 1 - index), half)
    return angle - (total[index + reach + 1] - total[index - reach]) / (2 * reach + 1)


def _fit(columns: Floats, y: Floats) -> Floats:
    """Least-squares image of y in the columns (N, m); zeros when there are none."""
    if columns.shape[1] == 0:
        return np.zeros_like(y)
    return np.asarray(columns @ np.linalg.lstsq(columns, y, rcond=None)[0])


def _smoothed(
    t: Floats, y: Floats, clean: Floats, columns: Floats, rest: Bools, usable: Bools
) -> tuple[Smoothed, Floats]:
    """One quadrature smoothed with the noise that its bias-free version shows, and that noise."""
    step, noise, _ = walk_of(t, clean, rest, usable)
    return smooth(y, columns, Walk(step, np.where(usable, noise, np.inf), 1.0)), noise


def _bridged(t: Floats, usable: Bools, variance: Floats) -> Floats:
    """Variance of the angle turned where samples lack: the smoothed rate's doubt, wholly correlated over a
    step.
    """
    dt = np.diff(t)
    lacking = (dt > 1.5 * np.median(dt)) | ~usable[1:]
    return np.where(lacking, dt**2 * np.maximum(variance[1:], variance[:-1]), 0.0)


def _first_constants(across: Complexes, phase: Phase) -> Complexes:
    """Mean of the unit's transverse axes, standing and moving: biases and leaked spin to first order,
    (N,).
    """
    mean = np.zeros(across.size, dtype=np.complex128)
    for state in (phase.rest, ~phase.rest):
        if state.any():
            mean[state] = np.median(across.real[state]) + 1j * np.median(across.imag[state])
    return mean


def _rest_rows(across: Complexes, rest: Bools, t: Floats, constants: int) -> Floats:
    """What one-second means at rest say of the biases, as whitened rows (k, 1+constants).

    Blocks that differ from the median (a wheel steered while standing) are left out.
    """
    size = per_second(t)
    rows = []
    for index, part in ((BIAS_X, across.imag[rest]), (BIAS_Z, across.real[rest])):
        means = block_means(part, size)
        means = means[np.abs(means - np.median(means)) < STEADY] if means.size else means
        columns = np.zeros((means.size, constants))
        columns[:, index] = 1.0
        rows.append(whiten(means, columns, np.full(means.size, max(robust_sd(means), STILL_SD) ** 2)))
    return np.concatenate(rows)
