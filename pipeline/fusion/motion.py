"""The fused motion of one pass: what leaves fusion, and all that the comparison may know of the field."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...sensors.streams import Warn

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Origin:
    """Origin of the East-North-Up tangent plane: lat, lon in degrees, alt in m above the ellipsoid."""

    lat: float
    lon: float
    alt: float


@dataclass(frozen=True)
class BodyMotion:
    """One body's planar motion, smoothed, on the grid of its `Motion`; all (N,) unless said otherwise.

    x, y : m, ENU, of the centre of mass; yaw : rad, unwrapped
    v : m/s, component of the CoM's velocity along the body's x axis (negative backwards)
    v_lateral : m/s, component along the body's y axis; yaw_rate : rad/s
    covariance : (N, 6, 6) of (x, y, yaw, v, v_lateral, yaw_rate), with lever-arm and mounting doubt included
    roll, pitch : rad, NaN where not estimated
    lateral_acceleration : m/s², of the CoM along the body's y axis, from the body's IMD, lever arm moved and
        g·sin(roll) removed; None when that could not be done
    """

    x: Floats
    y: Floats
    yaw: Floats
    v: Floats
    v_lateral: Floats
    yaw_rate: Floats
    covariance: Floats
    roll: Floats
    pitch: Floats
    lateral_acceleration: Floats | None = None

    def sd(self, index: int) -> Floats:
        """Standard deviation of component `index` of (x, y, yaw, v, v_lateral, yaw_rate)."""
        return np.sqrt(self.covariance[:, index, index])


@dataclass(frozen=True)
class SteerInput:
    """The steering series that alone may drive the replay: never updated by the body's position or yaw.

    angle : (N,) rad, mean of the front wheels, left positive
    sd : (N,) rad, of its error without the constant zero error
    correlation_time : s, of that error (0: white)
    zero_sd, scale_sd : standard deviations of a constant offset (rad) and of a scale error (1)
    source : what it was made of
    """

    angle: Floats
    sd: Floats
    correlation_time: float
    zero_sd: float
    scale_sd: float
    source: Literal["sensor", "wheels"]


@dataclass(frozen=True)
class SensorConsistency:
    """Innovation statistics of one sensor's channel: NIS against its χ² bounds, whiteness, rejections."""

    channel: str
    count: int
    rejected: int
    dof: int
    mean_nis: float
    nis_low: float
    nis_high: float
    lag1_autocorrelation: float
    consistent: bool


@dataclass(frozen=True)
class Motion:
    """Both bodies' smoothed motion with its uncertainty.

    t : (N,) s, UTC, a regular grid of 1/50 s
    steer, sd_steer : (N,) rad, best estimate (may use everything); NaN when there is none
    draw_t : (M,) s, UTC, coarser regular grid; draws : (K, M, 6) posterior draws of the smoother's error of
        (x1, y1, yaw1, x2, y2, yaw2) across time, zero-mean; the last three are absent for a tractor alone
    gnss_t : (G,) s, UTC, instants with an accepted GNSS position (gaps over 0.5 s are masked in the comparison)
    consistency : innovation statistics; consistent : whether the filter's own tests hold
    noise : what noise figure each sensor was given and where it came from ("manifest", "rest", "innovations", ...)
    calibration : estimated constants with standard deviations (biases, radii, latency, misalignments), for the report
    """

    t: Floats
    origin: Origin
    tractor: BodyMotion
    seeder: BodyMotion | None
    steer: Floats
    sd_steer: Floats
    steer_input: SteerInput | None
    draw_t: Floats
    draws: Floats
    gnss_t: Floats
    consistency: tuple[SensorConsistency, ...] = ()
    consistent: bool = True
    noise: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibration: Mapping[str, Any] = field(default_factory=dict)
    innovations: Mapping[str, Mapping[str, Floats]] = field(default_factory=dict)
    warnings: tuple[Warn, ...] = ()

    @property
    def bodies(self) -> tuple[BodyMotion, ...]:
        """The tractor, and the seeder where there is one."""
        return (self.tractor,) if self.seeder is None else (self.tractor, self.seeder)
