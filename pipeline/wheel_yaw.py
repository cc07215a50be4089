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

from .wheel_phase import Phase
from .wheel_series import (
    Constants,
    Floats,
    Walk,
    block_means,
    robust_sd,
    signal,
    smooth,
    solve,
    whitened_products,
)
from .wheel_unit import (
    CLUSTER,
    Bools,
    Doubt,
    Unit,
    bridged,
    by_state,
    integrate,
    per_second,
    running_mean,
    walk_of,
)

BIAS_X, BIAS_Z, TILT_X, TILT_Z = range(4)
SHARE = 2.0  # how much of the carrier's roll and pitch rate a hub may show as its own roll rate
LAG = 10  # s, at which a drift counts as the walk that does the same
SWING = 10  # s, over which the carrier's pitch angle has no mean of its own
STEADY = 4.0  # robust standard deviations: a block at rest that departs further is being steered
STILL_SD = 1.0e-4  # rad/s: least doubt of a one-second mean at rest


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


def estimate_yaw_rate(unit: Unit, phase: Phase, doubt: Doubt) -> YawRate:
    """Demodulated yaw rate.

    With the carrier's rates its pitching is taken off the phase, so that rates are about the body's axes;
    what the roll rate has in common with it no longer hides the unit's constants; and what leaks of roll
    and pitch into the yaw rate (the unit turned about the axle against its statement) is taken off. The
    body's yaw rate is not used.
    """
    turn = np.exp(1j * (phase.phase - _pitch(unit)))
    back = unit.across * turn
    clean = back - by_state(phase.rest, unit.across) * turn
    columns = np.column_stack([1j * turn, turn, 1j * turn * phase.spin, turn * phase.spin])
    swings = unit.swings
    blank = np.zeros_like(swings)
    level, noise, walk = _model(unit, clean.real, phase.rest, unit.across_ok)
    size = CLUSTER * per_second(unit.t)
    yaw = smooth(np.column_stack([back.real, columns.real, swings, blank]), level, size)
    seen = unit.across_ok & unit.carried if unit.carrier is not None else unit.across_ok
    rolling, noise_of_roll, _ = _model(unit, clean.imag - _fit(swings, clean.imag), phase.rest, seen)
    roll = smooth(np.column_stack([back.imag, columns.imag, blank, swings]), rolling, size)
    shares = swings.shape[1]
    prior = np.repeat([doubt.gyro_bias, doubt.tilt, doubt.tilt, SHARE], [2, 2, shares, shares])
    at_rest = _rest_products(unit, phase.rest, prior.size)
    constants = solve([yaw.products, roll.products, at_rest], prior)
    rate, variance = signal(yaw, constants)
    raw = back.real - np.hstack([columns.real, swings]) @ constants.value[: 4 + shares]
    dt = np.diff(unit.t)
    own = np.minimum(noise, noise_of_roll)  # both gyros turn through both: what one has more of is motion
    grown = dt * float(np.median(dt)) * own[1:] + bridged(unit.t, unit.across_ok, walk)
    grown = grown + dt * _constants_walk(unit.t, np.hstack([columns.real, swings]), constants)[1:]
    return YawRate(
        rate=rate,
        rate_sd=np.sqrt(variance),
        roll_rate=back.imag - columns.imag @ constants.value[:4],
        turned=integrate(unit.t, np.where(unit.across_ok, raw, rate)),
        turned_variance=np.append(0.0, np.cumsum(grown)),
        constants=constants,
    )


def _model(unit: Unit, clean: Floats, rest: Bools, seen: Bools) -> tuple[Walk, Floats, float]:
    """Stochastic model of one quadrature from its bias-free version; its noise by sample, and its walk."""
    step, noise, walk = walk_of(unit.t, clean, rest, seen)
    return Walk(step, np.where(seen, noise, np.inf), 1.0), noise, walk


def _constants_walk(t: Floats, columns: Floats, constants: Constants) -> Floats:
    """Walk [rad²/s] that does over `LAG` seconds what the doubt of the constants does to the angle turned,
    (N,).

    Over whole revolutions a doubtful bias leaves nothing; at rest and on a slow wheel it is a drift.
    """
    size, m = per_second(t), columns.shape[1]
    seconds = np.arange(t[0], t[-1] + 1.0)
    turned = np.column_stack([np.interp(seconds, t, integrate(t, column)) for column in columns.T])
    index = np.arange(seconds.size)
    late, early = np.minimum(index + LAG // 2, index[-1]), np.maximum(index - LAG // 2, 0)
    apart = turned[late] - turned[early]
    variance = np.einsum("ij,ij->i", apart @ constants.covariance[:m, :m], apart)
    return np.asarray(
        np.interp(t, seconds, variance / np.maximum(seconds[late] - seconds[early], 1.0 / size))
    )


def _pitch(unit: Unit) -> Floats:
    """The carrier's pitch angle but for its slow part: its rate's integral less the mean over `SWING`
    seconds.
    """
    if unit.carrier is None:
        return np.zeros_like(unit.t)
    angle = integrate(unit.t, unit.swings[:, 1])
    return np.asarray(angle - running_mean(angle, SWING * per_second(unit.t) // 2))


def _fit(columns: Floats, y: Floats) -> Floats:
    """Least-squares image of y in the columns (N, m); zeros when there are none."""
    if columns.shape[1] == 0:
        return np.zeros_like(y)
    return np.asarray(columns @ np.linalg.lstsq(columns, y, rcond=None)[0])


def _rest_products(unit: Unit, rest: Bools, constants: int) -> Floats:
    """What one-second means at rest say of the biases, as products for `solve`.

    Blocks that differ from the median (a wheel steered while standing) are left out.
    """
    size = per_second(unit.t)
    total = np.zeros((1, 1 + constants, 1 + constants))
    for index, part in ((BIAS_X, unit.across.imag[rest]), (BIAS_Z, unit.across.real[rest])):
        means = block_means(part, size)
        means = _steady(means)
        columns = np.zeros((means.size, 1 + constants))
        columns[:, 0], columns[:, 1 + index] = means, 1.0
        total += whitened_products(columns, np.full(means.size, max(robust_sd(means), STILL_SD) ** 2))
    return total


def _steady(means: Floats) -> Floats:
    """Those of one-second means at rest that agree with their median."""
    if means.size == 0:
        return means
    limit = STEADY * max(robust_sd(means), STILL_SD)
    return np.asarray(means[np.abs(means - np.median(means)) <= limit])
