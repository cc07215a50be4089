"""What drives the machine: steering and speed over time, a driver who follows a path, disturbance of the
ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Floats = NDArray[np.float64]
FORCES = 6  # columns of a disturbance: F_O1 forward, F_O1 left, M_O1, F_O2 forward, F_O2 left, M_O2


class InputError(ValueError):
    """An input that cannot drive a simulation: one line, what and how to mend."""


def _checked(name: str, values: object, ndim: Sequence[int]) -> Floats:
    array = np.array(values, dtype=np.float64, order="C")
    if array.ndim not in ndim:
        raise InputError(f"{name} has {array.ndim} dimensions; it must have {' or '.join(map(str, ndim))}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} holds a value that is not finite; fill gaps before simulating")
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class ForceSeries:
    """Disturbance at equal steps of time (s) or of distance travelled (m), linear between them, held beyond.

    values : (n, 6), or (rows, n, 6) for a batch that chooses a row a run. Columns: main vector along x and
    y of the body's frame (N) and moment (N·m) at O1, the same at O2. Over distance, 0 is where O1 starts.
    """

    spacing: float
    values: Floats
    start: float = 0.0

    def __post_init__(self) -> None:
        if not (self.spacing > 0.0 and np.isfinite(self.spacing)):
            raise InputError(f"disturbance spacing is {self.spacing!r}; it must be a finite number above 0")
        values = _checked("disturbance values", self.values, (2, 3))
        if values.shape[-1] != FORCES or values.shape[-2] < 1:
            raise InputError(
                f"disturbance values have shape {values.shape}; the last axis must have {FORCES} columns"
            )
        object.__setattr__(self, "values", values)

    @property
    def rows(self) -> Floats:
        """Values as (rows, n, 6)."""
        return self.values if self.values.ndim == 3 else self.values[None]


@dataclass(frozen=True)
class Path:
    """A path to follow, at equal distances: x, y (m), yaw (rad, unwrapped), curvature (1/m), each (n,), n ≥
    2."""

    spacing: float
    x: Floats
    y: Floats
    yaw: Floats
    curvature: Floats

    def __post_init__(self) -> None:
        if not (self.spacing > 0.0 and np.isfinite(self.spacing)):
            raise InputError(f"path spacing is {self.spacing!r}; it must be a finite number above 0")
        for name in ("x", "y", "yaw", "curvature"):
            object.__setattr__(self, name, _checked(f"path {name}", getattr(self, name), (1,)))
        if not self.x.size == self.y.size == self.yaw.size == self.curvature.size >= 2:
            raise InputError("path x, y, yaw and curvature must have the same length of 2 or more")


def straight_path(x: float = 0.0, y: float = 0.0, heading: float = 0.0, length: float = 1.0) -> Path:
    """A straight path from (x, y); a driver goes straight on beyond its end."""
    along = np.array([0.0, length])
    return Path(
        spacing=length,
        x=x + along * np.cos(heading),
        y=y + along * np.sin(heading),
        yaw=np.full(2, heading),
        curvature=np.zeros(2),
    )


def path_from_curvature(
    curvature: Floats, spacing: float, x: float = 0.0, y: float = 0.0, heading: float = 0.0
) -> Path:
    """The path with given curvatures (1/m) at equal distances, by trapezoids of heading and midpoint
    chords."""
    k = np.asarray(curvature, dtype=np.float64)
    turn = np.concatenate(([0.0], np.cumsum(0.5 * spacing * (k[1:] + k[:-1]))))
    yaw = heading + turn
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    return Path(
        spacing=spacing,
        x=x + np.concatenate(([0.0], np.cumsum(spacing * np.cos(middle)))),
        y=y + np.concatenate(([0.0], np.cumsum(spacing * np.sin(middle)))),
        yaw=yaw,
        curvature=k,
    )


@dataclass(frozen=True)
class Driver:
    """Who follows the path: pure pursuit with human limits.

    Every `period` s: aim = the path's point `preview` m ahead; angle = gain·atan(2·L·y_aim/preview²),
    carried out after `delay` s, through a first-order lag (time constant, s), within max_rate (rad/s) and
    max_angle (rad). Source: R. C. Coulter, "Implementation of the Pure Pursuit Path Tracking Algorithm",
    CMU-RI-TR-92-01 (1992); delay and lag as in D. T. McRuer and H. R. Jex, IEEE Trans. Human Factors HFE-8
    (1967).
    """

    preview: float = 8.0
    delay: float = 0.2
    lag: float = 0.1
    gain: float = 1.0
    max_rate: float = 0.6
    max_angle: float = 0.6
    period: float = 0.02

    def __post_init__(self) -> None:
        for name in ("preview", "max_rate", "max_angle", "period"):
            if not (getattr(self, name) > 0.0 and np.isfinite(getattr(self, name))):
                raise InputError(
                    f"driver.{name} is {getattr(self, name)!r}; it must be a finite number above 0"
                )
        for name in ("delay", "lag"):
            if not (getattr(self, name) >= 0.0 and np.isfinite(getattr(self, name))):
                raise InputError(
                    f"driver.{name} is {getattr(self, name)!r}; it must be a finite number, 0 or above"
                )
        if not np.isfinite(self.gain):
            raise InputError(f"driver.gain is {self.gain!r}; it must be a finite number")


@dataclass(frozen=True)
class Controls:
    """Inputs of a simulation over time.

    t : (n,) s, increasing; linear between, held beyond its ends
    speed : (n,) m/s, asked of the tractor's CoM along its axis (negative: backwards)
    steer : (n,) rad, mean of the front wheels, positive to the left; or (rows, n) for a batch; None: zero.
        With a driver it is added to what the driver does.
    driver, path : a driver needs a path
    over_time, over_distance : disturbance
    """

    t: Floats
    speed: Floats
    steer: Floats | None = None
    driver: Driver | None = None
    path: Path | None = None
    over_time: ForceSeries | None = None
    over_distance: ForceSeries | None = None

    def __post_init__(self) -> None:
        t = _checked("controls.t", self.t, (1,))
        if t.size < 2 or not (np.diff(t) > 0.0).all():
            raise InputError("controls.t must have two or more increasing times")
        speed = np.full(t.size, self.speed) if np.ndim(self.speed) == 0 else self.speed
        steer = np.zeros(t.size) if self.steer is None else self.steer
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "speed", _checked("controls.speed", speed, (1,)))
        object.__setattr__(self, "steer", _checked("controls.steer", steer, (1, 2)))
        if self.speed.shape != t.shape or self.steer_rows.shape[1] != t.size:
            raise InputError("controls.speed and controls.steer must be as long as controls.t")
        if self.driver is not None and self.path is None:
            raise InputError("controls.driver needs controls.path to follow")

    @property
    def steer_rows(self) -> Floats:
        """Steering as (rows, n)."""
        steer = np.zeros(self.t.size) if self.steer is None else self.steer
        return np.atleast_2d(steer)


def coloured_noise(
    generator: np.random.Generator, count: int, spacing: float, sd: float, correlation: float
) -> Floats:
    """Stationary first-order Gauss–Markov noise: autocovariance sd²·exp(−|τ|/correlation).

    x_0 ~ N(0, sd²), x_{k+1} = a·x_k + sd·√(1 − a²)·n_k with a = exp(−spacing/correlation); (count,), in
    sd's unit; spacing and correlation in the same unit of time or distance.
    """
    if not (correlation > 0.0 and spacing > 0.0):
        raise InputError(f"noise correlation is {correlation!r} at spacing {spacing!r}; both must be above 0")
    a = float(np.exp(-spacing / correlation))
    white = generator.standard_normal(count)
    white[1:] *= np.sqrt(1.0 - a * a)
    return np.asarray(sd * lfilter([1.0], [1.0, -a], white), dtype=np.float64)


def ackermann_angles(mean: float | Floats, track: float, wheelbase: float) -> tuple[Floats, Floats]:
    """Left and right front angle, rad, whose axles meet on the rear axle's line and whose mean is `mean`.

    cot right − cot left = track/wheelbase = k; with left = mean + d, right = mean − d:
    2·d = atan(k/2) − asin(k·cos(2·mean)/√(4 + k²)).
    """
    k = track / wheelbase
    half = 0.5 * (np.arctan(0.5 * k) - np.arcsin(k * np.cos(2.0 * np.asarray(mean)) / np.sqrt(4.0 + k * k)))
    return np.asarray(mean + half), np.asarray(mean - half)
