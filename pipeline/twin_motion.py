"""Planar motion of a twin: a driver keeps a machine on its path over disturbing soil; truth on a fine,
regular grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from .twin_path import PITCH, Path, make_path, smooth_wander, speed_limit, speed_profile
from .twin_plan import DriverPlan, TwinPlan

Floats = NDArray[np.float64]

STEP = 0.005  # s, grid of the truth
CREEP = 0.3  # m/s, below which nobody turns the wheel


@dataclass(frozen=True)
class PlanarMotion:
    """True planar motion every STEP s, of the points that the planar equations move (the bodies' CoM
    without sway).

    t : (N,) s after the pass's start; x1, y1, yaw1, x2, y2, yaw2 : m, rad, world (yaw unwrapped; body 2
    NaN when absent); steer : (N,) rad, mean of the front wheels
    """

    t: Floats
    x1: Floats
    y1: Floats
    yaw1: Floats
    x2: Floats
    y2: Floats
    yaw2: Floats
    steer: Floats


def planned(plan: TwinPlan, rng: np.random.Generator) -> tuple[Path, Floats]:
    """The path, and the speed asked for every STEP s, a little unsteady."""
    path = make_path(plan.path, math.radians(plan.place.heading_deg))
    speed = speed_profile(speed_limit(path, plan.path), plan.path, STEP)
    unsteady = plan.driver.speed_sd * smooth_wander(speed.size, STEP, plan.driver.speed_time, rng)
    return path, speed * (1.0 + unsteady)


def kinematic(
    plan: TwinPlan, machine: Mapping[str, Any], path: Path, speed: Floats, rng: np.random.Generator
) -> PlanarMotion:
    """Motion by rolling with side slip: no equations of `model` in it.

    Tractor: rear axle's lateral velocity v·σr, front axle's v·σf along its wheel's normal, so that
    yaw_rate = v·(tan(δ) + σf − σr)/L; seeder: its axle's lateral velocity v·σs, so that
    yaw_rate2 = (lateral velocity of the hitch in the seeder's frame − v·σs)/(l5 + l6).
    The slips σ are coloured over time, of the soil's side forces over the tyres' cornering stiffness.
    """
    n = speed.size
    slips = _slips(plan, machine, n, rng)
    added = hand(plan.driver, speed, rng)
    geometry = _geometry(machine)
    start = _start(path, plan.path.start_offset, geometry)
    out = np.empty((n, 5))
    driver = plan.driver
    _roll(
        start, speed, slips, added, path.x, path.y, geometry,
        np.array([driver.preview, driver.delay, driver.lag, math.radians(driver.limit_deg)]), out,
    )  # fmt: skip
    return _bodies(out, machine)


def _geometry(machine: Mapping[str, Any]) -> Floats:
    tractor, seeder = machine["tractor"], machine.get("seeder")
    axle = 0.0 if seeder is None else float(np.mean(seeder["com_to_axle"]))
    tail = 1.0 if seeder is None else seeder["hitch_to_com"] + axle
    return np.array(
        [tractor["front_axle"] + tractor["rear_axle"], tractor["hitch"] - tractor["rear_axle"], tail]
    )


def _start(path: Path, offset: float, geometry: Floats) -> Floats:
    """Rear axle at the path's start, `offset` to its left, both bodies along it."""
    heading = path.heading[0]
    return np.array(
        [path.x[0] - offset * math.sin(heading), path.y[0] + offset * math.cos(heading), heading, heading]
    )


def _slips(plan: TwinPlan, machine: Mapping[str, Any], n: int, rng: np.random.Generator) -> Floats:
    """Slip ratios (lateral over forward velocity) of front, rear and seeder axle, (n, 3)."""
    soil, tyres = plan.soil, machine["tyres"]
    time = max(soil.correlation_length / plan.path.speed, 4.0 * STEP)
    size = [
        0.5 * soil.side_force_tractor / tyres["front"]["cornering_stiffness"],
        0.5 * soil.side_force_tractor / tyres["rear"]["cornering_stiffness"],
        0.5 * soil.side_force_seeder / tyres.get("seeder", tyres["rear"])["cornering_stiffness"],
    ]
    crab = np.radians([soil.crab_tractor_deg, soil.crab_tractor_deg, soil.crab_seeder_deg])
    return np.column_stack(
        [c + k * smooth_wander(n, STEP, time, rng) for c, k in zip(crab, size, strict=True)]
    )


def hand(driver: DriverPlan, speed: Floats, rng: np.random.Generator) -> Floats:
    """What the driver adds to the steering that the path asks for, rad: his hand, and the weave; none at
    rest."""
    last = driver.weave_period if driver.weave_period_end is None else driver.weave_period_end
    frequency = np.linspace(1.0 / driver.weave_period, 1.0 / last, speed.size)
    weave = math.radians(driver.weave_deg) * np.sin(2.0 * math.pi * STEP * np.cumsum(frequency))
    noise = math.radians(driver.noise_deg) * smooth_wander(speed.size, STEP, driver.noise_time, rng)
    return np.asarray((noise + weave) * np.tanh(speed / CREEP))


@njit(cache=True)
def _nearest(px: Floats, py: Floats, x: float, y: float, near: int) -> int:
    """Index of the path's point nearest to (x, y), searched onward from `near`."""
    best = (px[near] - x) ** 2 + (py[near] - y) ** 2
    while near + 1 < px.size:
        ahead = (px[near + 1] - x) ** 2 + (py[near + 1] - y) ** 2
        if ahead > best:
            break
        near, best = near + 1, ahead
    return near


@njit(cache=True)
def _preview_angle(
    px: Floats, py: Floats, near: int, x: float, y: float, yaw: float, reach: float, wheelbase: float
) -> float:
    """Steering that puts the rear axle on a circle through the path's point `reach` m ahead (pure
    pursuit)."""
    goal = min(near + int(reach / PITCH), px.size - 1)
    dx, dy = px[goal] - x, py[goal] - y
    left = -math.sin(yaw) * dx + math.cos(yaw) * dy
    return math.atan(2.0 * wheelbase * left / max(dx * dx + dy * dy, 1.0))


@njit(cache=True)
def _roll(
    start: Floats, speed: Floats, slips: Floats, hand: Floats, px: Floats, py: Floats, geometry: Floats,
    driver: Floats, out: Floats,
) -> None:  # fmt: skip
    """Fill out (n, 5): rear axle's x, y, yaw1, yaw2, steering angle; semi-implicit steps of STEP."""
    wheelbase, behind, tail = geometry[0], geometry[1], geometry[2]
    preview, delay, lag, limit = driver[0], int(driver[1] / STEP), driver[2], driver[3]
    x, y, yaw, yaw2, steer, near = start[0], start[1], start[2], start[3], 0.0, 0
    asked = np.zeros(speed.size)
    for k in range(speed.size):
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = x, y, yaw, yaw2, steer
        v = speed[k]
        near = _nearest(px, py, x, y, near)
        asked[k] = _preview_angle(px, py, near, x, y, yaw, max(preview * v, 2.5), wheelbase) + hand[k]
        moving = math.tanh(v / CREEP)
        target = min(max(asked[max(k - delay, 0)], -limit), limit)
        steer += STEP / lag * moving * (target - steer)
        w = v * (math.tan(steer) + slips[k, 0] - slips[k, 1]) / wheelbase
        middle = yaw + 0.5 * STEP * w
        side = v * slips[k, 1]
        x += STEP * (v * math.cos(middle) - side * math.sin(middle))
        y += STEP * (v * math.sin(middle) + side * math.cos(middle))
        bend = yaw2 - yaw
        hitch = -v * math.sin(bend) + (side - behind * w) * math.cos(bend)
        yaw += STEP * w
        yaw2 += STEP * (hitch - v * slips[k, 2]) / tail


def _bodies(rolled: Floats, machine: Mapping[str, Any]) -> PlanarMotion:
    rear_x, rear_y, yaw1, yaw2, steer = rolled.T.copy()
    tractor = machine["tractor"]
    x1, y1 = rear_x + tractor["rear_axle"] * np.cos(yaw1), rear_y + tractor["rear_axle"] * np.sin(yaw1)
    return joined(np.arange(x1.size) * STEP, x1, y1, yaw1, yaw2, steer, machine)


def joined(
    t: Floats, x1: Floats, y1: Floats, yaw1: Floats, yaw2: Floats, steer: Floats, machine: Mapping[str, Any]
) -> PlanarMotion:
    """The seeder hung on the tractor: x2 = x1 − l4·cos(yaw1) − l5·cos(yaw2), and y2 likewise."""
    seeder = machine.get("seeder")
    hitch = machine["tractor"]["hitch"]
    if seeder is None:
        gone = np.full_like(x1, np.nan)
        return PlanarMotion(t, x1, y1, yaw1, gone, gone, gone, steer)
    l5 = seeder["hitch_to_com"]
    x2 = x1 - hitch * np.cos(yaw1) - l5 * np.cos(yaw2)
    y2 = y1 - hitch * np.sin(yaw1) - l5 * np.sin(yaw2)
    return PlanarMotion(t, x1, y1, yaw1, x2, y2, yaw2, steer)
