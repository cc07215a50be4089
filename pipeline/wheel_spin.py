"""Speed of the hub: the wheel's spin less what the body that carries it adds by pitching and rolling.

The axle's gyro reads the spin against the body plus the body's own rate about the axle: its pitch rate, and,
on a steered wheel, its roll rate too: q·cos δ − p·sin δ. On rough ground that is 5 to 10 cm/s at the rim and
says nothing of the speed.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

from .wheel_phase import BIAS, BIAS_WANDER, SCALE, WANDER_LAG, Phase
from .wheel_series import Floats, Walk, block_means, smooth
from .wheel_unit import Bools, Unit, integrate, per_second, running_mean, walk_of
from .wheel_yaw import TILT_X, TILT_Z, YawRate

UNSEEN = 20.0  # samples over which the carrier's swing is one error where its own unit has a gap
STRAIGHT = 121  # s: over so long the median of a front wheel's angle is taken to be zero


def hub_spin(unit: Unit, phase: Phase, yaw: YawRate, steered: bool) -> tuple[Floats, Floats]:
    """Spin [rad/s] that times the effective radius is the hub's speed, and its standard deviation, (N,)."""
    tilt = yaw.constants.value
    across = unit.across.imag * tilt[TILT_X] + unit.across.real * tilt[TILT_Z]
    rate = phase.gyro + np.where(unit.across_ok, across - np.median(across), 0.0)
    angle = _rough_angle(unit, yaw) if steered else 0.0
    carried = _carried(unit, rate, angle, ~phase.rest & unit.axle_ok & unit.carried)
    rate = rate - carried
    step, noise, _ = walk_of(unit.t, rate, phase.rest, unit.axle_ok)
    swing = _unseen_swing(unit, rate, carried)
    seen = smooth(rate[:, None], Walk(step, np.where(unit.axle_ok, noise + UNSEEN * swing, np.inf)))
    spin = seen.columns[:, 0]
    shape = np.column_stack([np.ones_like(spin), spin])
    pair = np.ix_([BIAS, SCALE], [BIAS, SCALE])
    doubt = np.sum((shape @ phase.constants.covariance[pair]) * shape, axis=1)
    return spin, np.sqrt(seen.variance + doubt + BIAS_WANDER / WANDER_LAG + swing)


def _unseen_swing(unit: Unit, rate: Floats, carried: Floats) -> Floats:
    """Variance of the carrier's swing where its own unit did not see it: as elsewhere, or as the rate's
    fast part.
    """
    if unit.carried.any():
        return np.where(unit.carried, 0.0, float(np.mean(carried[unit.carried] ** 2)))
    return np.full(rate.size, float(np.var(rate - running_mean(rate, per_second(unit.t) // 2))))


def _rough_angle(unit: Unit, yaw: YawRate) -> Floats:
    """Steering angle of the wheel to a few degrees: its turning less the body's, without its trend and slow
    median.
    """
    if unit.carrier is None:
        return np.zeros_like(unit.t)
    size = per_second(unit.t)
    apart = yaw.turned - integrate(unit.t, unit.carrier[:, 2])
    ends = apart[-size:].mean() - apart[:size].mean()
    apart = apart - ends / (unit.t[-1] - unit.t[0]) * unit.t
    middle = median_filter(block_means(apart, size), STRAIGHT)
    return np.asarray(apart - np.interp(unit.t, block_means(unit.t, size), middle))


def _carried(unit: Unit, rate: Floats, angle: Floats | float, usable: Bools) -> Floats:
    """What the axle's gyro shares with the carrier's rate about the axle: its image in it over changes of
    50 ms.

    A wheel carried by a pitching body turns with it in full when the contact does not slip, in part or not at
    all in other suspensions, so the share is measured and not assumed, and with it the part of the other
    rate that a tilted unit mixes in; changes are used because bias and speed drop out.
    """
    if unit.carrier is None:
        return np.zeros_like(rate)
    roll, pitch = unit.swings.T
    turned = np.column_stack(
        [pitch * np.cos(angle) - roll * np.sin(angle), roll * np.cos(angle) + pitch * np.sin(angle)]
    )
    lag = max(per_second(unit.t) // 20, 1)
    both = usable[lag:] & usable[:-lag]
    swing, seen = (x[lag:][both] - x[:-lag][both] for x in (turned, rate))
    power = swing.T @ swing
    if not np.linalg.det(power) > 0.0:
        return np.zeros_like(rate)
    return np.asarray(turned @ np.linalg.solve(power, swing.T @ seen))
