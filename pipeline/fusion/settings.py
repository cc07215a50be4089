"""What may be chosen of the fusion, and the physics its defaults stand for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class FusionSettings:
    """Options of `fuse`; the defaults are what the reports are made with.

    engine : "compiled" (numba, the default) or "filterpy" (the readable reference); equal results
    tilt_compensation : False only to show what the antenna's sway costs
    magnetometers : use those that prove consistent; False to show what that is worth
    adapt : estimate slip and noise levels from the innovations' likelihood; False keeps the starting values
    passes : relinearisations about the smoothed path (Gauss-Newton) after the first filter pass
    draws : posterior draws for the comparison's uncertainty; seed : of their generator
    """

    engine: Literal["compiled", "filterpy"] = "compiled"
    tilt_compensation: bool = True
    magnetometers: bool = True
    adapt: bool = True
    passes: int = 2
    draws: int = 64
    seed: int = 0


@dataclass(frozen=True)
class Levels:
    """Standard deviations that the data themselves can tell (tuned by likelihood), with physical starting values.

    beta1, beta2 : rad, slip angle at the tractor's rear and the seeder's axle. Tyres on tilled soil slip by
        tenths of a degree on a straight row.
    white_fixed, white_float, white_second : 1, share of the receiver's stated deviation that is white;
        the rest is slow (multipath, atmosphere, base)
    velocity : m/s, of a GNSS velocity component
    lateral : 1, factor on the accelerometer's noise in the tilt measurement
    hitch : 1, factor on the gyros' noise in the measurement at the seeder's axle
    forward : 1, factor on the accelerometer's noise along the way
    wheel : m/s, white error of the wheels' speed
    """

    beta1: float = 0.006
    beta2: float = 0.010
    white_fixed: float = 0.6
    white_float: float = 0.3
    white_second: float = 0.6
    velocity: float = 0.05
    lateral: float = 1.5
    hitch: float = 0.5
    wheel: float = 0.03
    forward: float = 1.0


# Physical constants of the error models, each with its reason.
TAU_SLIP = 1.0  # s: yaw and slip of a tractor settle within about a second
# rad/(m/s²): axle load over cornering stiffness, about 2500 kg / (2 · 70 kN/rad), known to a factor of 1.5: 19 of 20
# lie under 1.96 times that
COMPLIANCE = 0.0175
COMPLIANCE_FAST = 0.01  # rad/(m/s²): what of it changes from second to second
CRAB = 0.1  # share of a slip angle's deviation that stays all along a row, unseen: side forces average out
TAU_TURN = 10.0  # s: a headland turn's slip stays as long as the turn
DRAG = 0.08  # rad/rad: draft across the tractor when it is bent, 10 kN over 2 · 90 kN/rad, times the hitch's lever
BEND_FROM = 0.03  # rad of articulation: a row stays below
TOOLS = 0.5  # m: the tools' middle ahead of the seeder's axle or behind it; there a turn moves them aside
TURN_FROM = 0.15  # m/s² of lateral acceleration: a weave along a row stays below
TAU_GNSS = 40.0  # s: multipath and residual atmosphere of a moving RTK receiver, tens of seconds
WHEEL_WALK = 0.003  # 1/sqrt(s): wheel slip follows soil and draft, by a percent in ten seconds
WHEEL_DRIVE = 0.05  # 1/sqrt(s) per m/s²: and traction, by some percent while the machine gathers speed
RADIUS_SD = 0.10  # 1: effective against stated rolling radius, and mean slip under draft
GYRO_BIAS = 0.02  # rad/s, MEMS turn-on bias (about 1 °/s) when the manifest states none
ACCEL_BIAS = 0.20  # m/s²: MEMS offset (data sheets: 20 to 60 mg, some of it calibrated away) and mounting
SLOPE = 0.005  # rad: of a field's slopes the standard deviation that half of all fields exceed
HILL = 0.03  # rad: slopes of hills about a field's plane
LEAN = 0.005  # rad: of one body beside the ground it stands on, by its tyres and its load
ROUGH = 0.02  # rad: roll and pitch of a machine on rough ground, about a second long
ROUGH_TIME = 1.0  # s
GYRO_SCALE = 0.005  # 1: MEMS scale error by data sheets, 0.5 to 1 %
BIAS_WALK = 2.0e-6  # rad/s/sqrt(s): MEMS bias instability of about 10 °/h over minutes
LEVER_SD = 0.003  # m: antenna and centre-of-mass positions by tape
MOUNT_SD = 0.004  # rad: a unit's bracket against the body's vertical, by a spirit level
HEADING_SD = 0.003  # rad: a dual antenna's baseline against the body's axis
UNSTATED = {1: 1.5, 2: 0.6, 3: 0.6, 4: 0.015, 5: 0.30, 6: 5.0, 9: 0.6}  # m by GGA quality when no GST says
