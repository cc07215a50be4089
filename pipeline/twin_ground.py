"""Rough ground: what roll, pitch and heave a machine makes of the tracks that its wheels run over.

Each wheel track is a random profile of spectral density G(n) = G0·(n/n0)^-2, n0 = 0.1 cycles/m (ISO
8608), levelled off above 20 m wavelength and averaged over a tyre's contact patch; the rear wheels meet
what the front wheels have passed. Roll, pitch and heave follow the ground as damped oscillators on the
tyres' springs. A plane slope lies under all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter, lfilter_zi

from .twin_motion import STEP, PlanarMotion
from .twin_path import wander
from .twin_plan import TwinPlan

Floats = NDArray[np.float64]

SPACING = 0.05  # m between points of a profile
PATCH = 0.4  # m, length of a tyre's contact with the ground
LONGEST = 20.0  # m, wavelength above which the profile is level (the slope has the rest)
REFERENCE = 0.1  # cycles/m, n0 of ISO 8608
ROLL_HZ, PITCH_HZ, HEAVE_HZ, DAMPING = (
    2.0,
    2.6,
    2.4,
    0.15,
)  # tyre-sprung tractors: 1.5 to 3 Hz, lightly damped
LEAN = 0.006  # rad of roll, outwards, for 1 m/s² of lateral acceleration
SQUAT = 0.004  # rad of pitch, nose up, for 1 m/s² of acceleration


@dataclass(frozen=True)
class Attitude:
    """Roll, pitch (rad; roll about x, pitch about y: nose down positive) and height of the ground under
    a body's centre of mass, with its heave (m), on the grid of its PlanarMotion; all (N,)."""

    roll: Floats
    pitch: Floats
    height: Floats


def attitudes(
    plan: TwinPlan, machine: Mapping[str, Any], motion: PlanarMotion, rng: np.random.Generator
) -> tuple[Attitude, Attitude | None]:
    """Attitude of the tractor and, where there is one, of the seeder. machine: the true [machine] table."""
    tractor, seeder = machine["tractor"], machine.get("seeder")
    wheels = _Wheels(plan, motion, rng)
    base = tractor["front_axle"] + tractor["rear_axle"]
    front, rear = wheels.axle(tractor["front_axle"]), wheels.axle(-tractor["rear_axle"])
    roll = 0.5 * (
        (front[0] - front[1]) / tractor["front_track"] + (rear[0] - rear[1]) / tractor["rear_track"]
    )
    pitch = (_mean(rear) - _mean(front)) / base
    heave = (_mean(front) * tractor["rear_axle"] + _mean(rear) * tractor["front_axle"]) / base
    first = _on_slope(plan, motion.x1, motion.y1, motion.yaw1, roll, pitch, heave)
    if seeder is None:
        return first, None
    return first, _seeder(plan, tractor, seeder, motion, wheels, pitch, heave)


def _seeder(
    plan: TwinPlan, tractor: Mapping[str, Any], seeder: Mapping[str, Any], motion: PlanarMotion,
    wheels: _Wheels, pitch1: Floats, heave1: Floats,
) -> Attitude:  # fmt: skip
    """The seeder rolls on its wheels, and pitches between its axle and the hitch."""
    axle, track = float(np.mean(seeder["com_to_axle"])), float(np.mean(seeder["track"]))
    length = seeder["hitch_to_com"] + axle
    own = wheels.axle(-tractor["hitch"] - length)
    hitch = heave1 + tractor["hitch"] * pitch1
    roll, pitch = (own[0] - own[1]) / track, (_mean(own) - hitch) / length
    heave = hitch + (_mean(own) - hitch) * seeder["hitch_to_com"] / length
    return _on_slope(plan, motion.x2, motion.y2, motion.yaw2, roll, pitch, heave)


class _Wheels:
    """Ground height under the wheels of any axle, from one pair of wheel tracks along the distance driven."""

    def __init__(self, plan: TwinPlan, motion: PlanarMotion, rng: np.random.Generator) -> None:
        self.distance = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(motion.x1), np.diff(motion.y1)))])
        self.before = 20.0
        n = math.ceil((self.before + self.distance[-1] + 10.0) / SPACING) + 1
        s = np.arange(n) * SPACING - self.before
        self.tracks = [CubicSpline(s, profile(n, plan.soil.roughness, rng)) for _ in range(2)]

    def axle(self, ahead: float) -> tuple[Floats, Floats]:
        """Height under the left and right wheel of an axle `ahead` of the tractor's CoM, m."""
        place = self.distance + ahead
        return self.tracks[0](place), self.tracks[1](place)


def profile(n: int, roughness: float, rng: np.random.Generator) -> Floats:
    """Height of a wheel track every SPACING m: G(n) = G0·n0²/(n² + 1/LONGEST²) is a Gauss-Markov series of
    variance π·G0·n0²·LONGEST (one-sided density) and correlation length LONGEST/(2π); then the contact
    patch."""
    sigma = math.sqrt(0.5 * math.pi * roughness * REFERENCE**2 * LONGEST)
    patch = round(PATCH / SPACING)
    window = np.convolve(np.full(patch, 1.0 / patch), np.full(patch, 1.0 / patch))
    raw = wander(n + window.size - 1, SPACING, LONGEST / (2.0 * math.pi), rng)
    return sigma * np.convolve(raw, window, mode="valid")


def _mean(axle: tuple[Floats, Floats]) -> Floats:
    return 0.5 * (axle[0] + axle[1])


def _on_slope(
    plan: TwinPlan, x: Floats, y: Floats, yaw: Floats, roll: Floats, pitch: Floats, heave: Floats
) -> Attitude:
    """Oscillators over the rough ground, leaning in bends, on the plane slope."""
    east, north = plan.soil.slope_east, plan.soil.slope_north
    along, left = _body_acceleration(x, y, yaw)
    up_ahead = east * np.cos(yaw) + north * np.sin(yaw)
    up_left = -east * np.sin(yaw) + north * np.cos(yaw)
    return Attitude(
        roll=followed(roll + LEAN * left, ROLL_HZ) + np.arctan(up_left),
        pitch=followed(pitch - SQUAT * along, PITCH_HZ) - np.arctan(up_ahead),
        height=followed(heave, HEAVE_HZ) + east * x + north * y,
    )


def _body_acceleration(x: Floats, y: Floats, yaw: Floats) -> tuple[Floats, Floats]:
    ax, ay = (np.gradient(np.gradient(c, STEP), STEP) for c in (x, y))
    return ax * np.cos(yaw) + ay * np.sin(yaw), -ax * np.sin(yaw) + ay * np.cos(yaw)


def followed(ground: Floats, frequency: float) -> Floats:
    """A body on its tyres over moving ground: q̈ + 2ζω(q̇ − u̇) + ω²(q − u) = 0, from rest on u[0]."""
    w = 2.0 * math.pi * frequency
    b, a = bilinear([2.0 * DAMPING * w, w * w], [1.0, 2.0 * DAMPING * w, w * w], 1.0 / STEP)
    out, _ = lfilter(b, a, ground, zi=lfilter_zi(b, a) * ground[0])
    return np.asarray(out)
