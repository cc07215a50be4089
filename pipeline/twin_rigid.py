"""Rigid-body kinematics of a twin: what an ideal unit feels anywhere on a body or on one of its wheels.

A `Feel` is what an ideal strapdown unit at the origin of a moving frame would feel, in that frame's own axes.
It is carried along a chain of frames: body → steered wheel carrier → turning wheel → unit. Everything
comes from the truth by differentiating splines; no code of the fusion or of `sensors.mounting` is used.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from .twin_ground import Attitude
from .twin_motion import STEP, PlanarMotion

Floats = NDArray[np.float64]

GRAVITY = 9.80665  # m/s²
X, Y, Z = range(3)
EAST, NORTH, UP, ROLL, PITCH, YAW = range(6)


@dataclass(frozen=True)
class Feel:
    """force : (N, 3) specific force of the frame's origin, m/s²; rate : (N, 3) angular velocity, rad/s;
    twist : (N, 3) angular acceleration, rad/s²; axes : (N, 3, 3) the frame's axes as columns in the
    world, for fields fixed there."""

    force: Floats
    rate: Floats
    twist: Floats
    axes: Floats

    def at(self, arm: Sequence[float] | Floats) -> Feel:
        """At a point fixed in the frame: f + α×r + ω×(ω×r)."""
        r = np.asarray(arm, dtype=float)
        spin = np.cross(self.rate, np.cross(self.rate, r))
        return Feel(self.force + np.cross(self.twist, r) + spin, self.rate, self.twist, self.axes)

    def turned(self, axis: int, angle: Floats, rate: Floats, acceleration: Floats) -> Feel:
        """In a frame turned about one of this frame's axes by a changing angle (same origin).

        ω' = Rᵀω + e·θ̇; α' = Rᵀα + e·θ̈ + (Rᵀω)×e·θ̇.
        """
        turn = elementary(axis, angle)
        e = np.eye(3)[axis]
        before = _into(turn, self.rate)
        extra = np.cross(before, e) * rate[:, None]
        return Feel(
            force=_into(turn, self.force),
            rate=before + e * rate[:, None],
            twist=_into(turn, self.twist) + e * acceleration[:, None] + extra,
            axes=self.axes @ turn,
        )

    def mounted(self, rotation: Floats) -> Feel:
        """In a frame fixed in this one, whose axes are the columns of `rotation` (3, 3)."""
        return Feel(self.force @ rotation, self.rate @ rotation, self.twist @ rotation, self.axes @ rotation)


def _into(turn: Floats, vectors: Floats) -> Floats:
    return np.asarray(np.einsum("nji,nj->ni", turn, vectors))


def elementary(axis: int, angle: Floats | float) -> Floats:
    """Right-handed rotation about coordinate axis 0, 1 or 2; (..., 3, 3), columns are the turned axes."""
    angle = np.asarray(angle, dtype=float)
    out = np.zeros((*angle.shape, 3, 3))
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = 1.0
    out[..., j, j] = out[..., k, k] = np.cos(angle)
    out[..., k, j] = np.sin(angle)
    out[..., j, k] = -np.sin(angle)
    return out


def from_degrees(rotation_deg: Sequence[float]) -> Floats:
    """Rz(yaw)·Ry(pitch)·Rx(roll) of (roll, pitch, yaw) in degrees, (3, 3)."""
    roll, pitch, yaw = (math.radians(angle) for angle in rotation_deg)
    return elementary(Z, yaw) @ elementary(Y, pitch) @ elementary(X, roll)


@dataclass(frozen=True)
class BodyPath:
    """A body's path in six coordinates (E, N, U of the centre of mass, roll, pitch, yaw) as quintic
    splines of time."""

    place: BSpline
    velocity: BSpline
    acceleration: BSpline

    @classmethod
    def through(cls, t: Floats, coordinates: Floats) -> BodyPath:
        """coordinates : (N, 6) at t."""
        place = make_interp_spline(t, coordinates, k=5)
        return cls(place, place.derivative(1), place.derivative(2))

    def axes(self, t: Floats) -> Floats:
        """The body's axes as columns in the world, (N, 3, 3)."""
        q = self.place(t)
        return elementary(Z, q[:, YAW]) @ elementary(Y, q[:, PITCH]) @ elementary(X, q[:, ROLL])

    def point(self, t: Floats, arm: Sequence[float] | Floats) -> Floats:
        """World position of a point fixed in the body, (N, 3) m."""
        return np.asarray(self.place(t)[:, :3] + self.axes(t) @ np.asarray(arm, dtype=float))

    def point_velocity(self, t: Floats, arm: Sequence[float] | Floats) -> Floats:
        """World velocity of a point fixed in the body, (N, 3) m/s: v + R·(ω×r)."""
        rate, _ = self._turning(t)
        swept = np.cross(rate, np.asarray(arm, dtype=float))
        return np.asarray(self.velocity(t)[:, :3] + np.einsum("nij,nj->ni", self.axes(t), swept))

    def feel(self, t: Floats) -> Feel:
        """What an ideal unit at the centre of mass feels: f = Rᵀ(a + g·up)."""
        axes = self.axes(t)
        pull = self.acceleration(t)[:, :3] + np.array([0.0, 0.0, GRAVITY])
        rate, twist = self._turning(t)
        return Feel(_into(axes, pull), rate, twist, axes)

    def _turning(self, t: Floats) -> tuple[Floats, Floats]:
        """Angular velocity and acceleration in the body's axes, from Euler angles (Z-Y-X) and their
        derivatives."""
        (roll, pitch), (p, q, r) = self.place(t)[:, ROLL:YAW].T, self.velocity(t)[:, ROLL:].T
        pp, qq, rr = self.acceleration(t)[:, ROLL:].T
        sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
        rate = np.column_stack([p - r * sp, q * cr + r * sr * cp, -q * sr + r * cr * cp])
        twist = np.column_stack(
            [
                pp - rr * sp - r * q * cp,
                qq * cr - q * p * sr + rr * sr * cp + r * (p * cr * cp - q * sr * sp),
                -qq * sr - q * p * cr + rr * cr * cp - r * (p * sr * cp + q * cr * sp),
            ]
        )
        return rate, twist


def body_path(
    motion: PlanarMotion, attitude: Attitude, body: int, cog_height: float, roll_centre: float | None
) -> BodyPath:
    """A body's path in six coordinates. It tilts about an axis `roll_centre` above ground (None: its
    CoM), so that the CoM sways by R·(0, 0, cog_height − roll_centre) about the planar motion."""
    x, y, yaw = (motion.x1, motion.y1, motion.yaw1) if body == 1 else (motion.x2, motion.y2, motion.yaw2)
    centre = cog_height if roll_centre is None else roll_centre
    turn = elementary(Z, yaw) @ elementary(Y, attitude.pitch) @ elementary(X, attitude.roll)
    arm = turn[:, :, Z] * (cog_height - centre)
    coordinates = np.column_stack(
        [
            x + arm[:, X],
            y + arm[:, Y],
            attitude.height + centre + arm[:, Z],
            attitude.roll,
            attitude.pitch,
            yaw,
        ]
    )
    return BodyPath.through(motion.t, coordinates)


@dataclass(frozen=True)
class WheelPath:
    """One tractor wheel's steering angle, phase (positive rolling forward) and slip over time.

    hub : its centre in the body's frame, m; steer, phase : splines of time, rad; radius : m, the true one
    """

    hub: Floats
    steer: BSpline
    phase: BSpline
    radius: float
    slip: Floats

    def feel(self, body: BodyPath, t: Floats) -> Feel:
        """What an ideal unit in the hub's centre feels, in the turning wheel's axes."""
        carrier = body.feel(t).at(self.hub)
        carrier = carrier.turned(Z, *(self.steer(t, nu) for nu in range(3)))
        return carrier.turned(Y, *(self.phase(t, nu) for nu in range(3)))


def hub_position(tractor: Mapping[str, Any], wheel: str) -> Floats:
    """A wheel's hub in the tractor's frame: on its axle, half a track to its side, one radius above
    ground."""
    axle, side = wheel.split("_")
    ahead = tractor["front_axle"] if axle == "front" else -tractor["rear_axle"]
    left = 0.5 * tractor[f"{axle}_track"] * (1.0 if side == "left" else -1.0)
    return np.array([ahead, left, tractor[f"{axle}_wheel_radius"] - tractor["cog_height"]])


def wheel_angle(tractor: Mapping[str, Any], wheel: str, steer: Floats) -> Floats:
    """Steering angle of one wheel from the front wheels' mean, by Ackermann: cot δ_side = cot δ_c ∓
    track/(2·L).

    δ_c, the angle of a wheel midway, differs from the mean by third order; it is found by fixed-point
    iteration.
    """
    if wheel.startswith("rear"):
        return np.zeros_like(steer)
    half = 0.5 * tractor["front_track"] / (tractor["front_axle"] + tractor["rear_axle"])
    middle = steer.copy()
    for _ in range(30):
        middle += steer - 0.5 * (_ackermann(middle, half) + _ackermann(middle, -half))
    return _ackermann(middle, half if wheel.endswith("left") else -half)


def _ackermann(middle: Floats, half: float) -> Floats:
    return np.arctan2(np.sin(middle), np.cos(middle) - half * np.sin(middle))


def wheel_path(
    motion: PlanarMotion, tractor: Mapping[str, Any], wheel: str, radius: float, slip: Floats, phase0: float
) -> WheelPath:
    """A wheel that rolls: spin·radius·(1 − slip) is the hub's velocity along the wheel's heading."""
    hub = hub_position(tractor, wheel)
    angle = wheel_angle(tractor, wheel, motion.steer)
    vx, vy, w = planar_velocity(motion)
    along = (vx - w * hub[Y]) * np.cos(angle) + (vy + w * hub[X]) * np.sin(angle)
    spin = make_interp_spline(motion.t, along / (radius * (1.0 - slip)), k=3)
    phase = spin.antiderivative()
    phase.c = phase.c + phase0
    return WheelPath(hub, make_interp_spline(motion.t, angle, k=5), phase, radius, slip)


def planar_velocity(motion: PlanarMotion) -> tuple[Floats, Floats, Floats]:
    """The tractor's velocity along and left of its axis, m/s, and its yaw rate, rad/s, at the motion's
    times."""
    vx, vy, w = (np.gradient(q, STEP, edge_order=2) for q in (motion.x1, motion.y1, motion.yaw1))
    c, s = np.cos(motion.yaw1), np.sin(motion.yaw1)
    return vx * c + vy * s, -vx * s + vy * c, w
