"""Compiled inputs at an instant: steering from a table and a driver, speed, disturbance over time."""

from __future__ import annotations

import math

from numba import njit

from . import _layout as at
from ._kernels import interpolate
from ._layout import Floats, Tables
from .parts import part

X1, Y1, YAW1 = at.X1, at.Y1, at.YAW1
FORCE, FORCE_SIZE = at.FORCE, at.FORCE_SIZE

# Place of the driver's own memory: progress along the path, last and next steering angle, time of the last
# tick, newest place in the ring of past commands, then the ring.
PROGRESS, FROM, TO, TICK, NEWEST, RING = range(6)
RING_SIZE = 256


@njit(cache=True, error_model="numpy", inline="always")
def inner_angles(mean: float, ratio: float) -> float:
    """Half the difference of left and right front angle, so that their mean is `mean`, rad.

    Ackermann: cot right − cot left = track/wheelbase = k, hence
    2·d = atan(k/2) − asin(k·cos(2·mean)/√(4 + k²)) with left = mean + d, right = mean − d.
    """
    if ratio == 0.0:
        return 0.0
    return 0.5 * (
        math.atan(0.5 * ratio) - math.asin(ratio * math.cos(2.0 * mean) / math.sqrt(4.0 + ratio * ratio))
    )


@njit(cache=True, error_model="numpy", inline="always")
def steering(t: float, memory: Floats, driver: Floats, change: Floats, tables: Tables, h: float) -> float:
    """Mean front angle at t: table (scaled, offset) plus the driver's ramp between its ticks."""
    place = t / tables.dt
    row = int(change[at.STEER_ROW])
    mean = change[at.STEER_OFFSET] + change[at.STEER_SCALE] * line(tables.steer[row], place)
    if driver[at.ACTIVE] > 0.0:
        part = (t - memory[TICK]) / (driver[at.PERIOD_STEPS] * h)
        mean += memory[FROM] + part * (memory[TO] - memory[FROM])
    return float(mean)


@njit(cache=True, error_model="numpy", inline="always")
def line(table: Floats, place: float) -> float:
    """Linear interpolation in an equally spaced series, held beyond its ends."""
    last = table.shape[0] - 1
    if place <= 0.0:
        return float(table[0])
    if place >= last:
        return float(table[last])
    i = int(place)
    return float(table[i] + (place - i) * (table[i + 1] - table[i]))


@njit(cache=True, error_model="numpy", inline="always")
def load_inputs(t: float, mean: float, p: Floats, change: Floats, tables: Tables, u: Floats) -> None:
    """Inputs u at time t for the mean front angle."""
    place = t / tables.dt
    half = inner_angles(mean, p[at.ACKERMANN])
    u[at.SIN_LEFT], u[at.COS_LEFT] = math.sin(mean + half), math.cos(mean + half)
    u[at.SIN_RIGHT], u[at.COS_RIGHT] = math.sin(mean - half), math.cos(mean - half)
    u[at.SPEED] = change[at.SPEED_SCALE] * line(tables.speed, place) + change[at.SPEED_OFFSET]
    u[at.ACCELERATION] = change[at.SPEED_SCALE] * line(tables.acceleration, place)
    if tables.time_force.shape[1] > 0:
        row = int(change[at.FORCE_ROW])
        for k in range(FORCE_SIZE):
            u[FORCE + k] = interpolate(tables.time_force[row], place, k)


@part
def inputs_at(
    t: float, memory: Floats, driver: Floats, change: Floats, tables: Tables, h: float, p: Floats, u: Floats
) -> float:
    """Inputs u at time t; gives the mean front angle."""
    mean = steering(t, memory, driver, change, tables, h)
    load_inputs(t, mean, p, change, tables, u)
    return float(mean)


@part
def path_point(progress: float, tables: Tables) -> tuple[float, float, float]:
    """x, y and heading of the path at a distance along it, going straight on beyond its ends."""
    last = tables.path.shape[0] - 1
    place = progress / tables.pitch
    i = min(max(int(place), 0), last - 1)
    a, b = tables.path[i], tables.path[i + 1]
    part = min(max(place - i, 0.0), 1.0)
    yaw = a[at.PATH_YAW] + part * (b[at.PATH_YAW] - a[at.PATH_YAW])
    beyond = (place - i - part) * tables.pitch
    x = a[at.PATH_X] + part * (b[at.PATH_X] - a[at.PATH_X]) + beyond * math.cos(yaw)
    y = a[at.PATH_Y] + part * (b[at.PATH_Y] - a[at.PATH_Y]) + beyond * math.sin(yaw)
    return x, y, yaw


@part
def pursuit_angle(s: Floats, p: Floats, driver: Floats, memory: Floats, tables: Tables) -> float:
    """Front angle that aims O1 at the path `preview` ahead: γ = gain·atan(2·L·y_aim/preview²) (pure
    pursuit)."""
    for _ in range(2):
        x, y, yaw = path_point(memory[PROGRESS], tables)
        memory[PROGRESS] += (s[X1] - x) * math.cos(yaw) + (s[Y1] - y) * math.sin(yaw)
    x, y, _ = path_point(memory[PROGRESS] + driver[at.PREVIEW], tables)
    aim = math.cos(s[YAW1]) * (y - s[Y1]) - math.sin(s[YAW1]) * (x - s[X1])
    angle = driver[at.GAIN] * math.atan(2.0 * p[at.WHEELBASE] * aim / driver[at.PREVIEW] ** 2)
    return float(min(max(angle, -driver[at.MAX_ANGLE]), driver[at.MAX_ANGLE]))


@part
def delayed(angle: float, memory: Floats, ticks: float) -> float:
    """Store a command in the ring and give the one of `ticks` (a fraction is interpolated) ago."""
    newest = (int(memory[NEWEST]) + 1) % RING_SIZE
    memory[NEWEST] = newest
    memory[RING + newest] = angle
    whole = int(ticks)
    part = ticks - whole
    late = memory[RING + (newest - whole) % RING_SIZE]
    later = memory[RING + (newest - whole - 1) % RING_SIZE]
    return float(late + part * (later - late))


@part
def tick(t: float, s: Floats, p: Floats, driver: Floats, memory: Floats, tables: Tables, h: float) -> None:
    """One decision of the driver: aim, delay, first-order lag and limited rate of the wheels until the
    next."""
    period = driver[at.PERIOD_STEPS] * h
    angle = delayed(pursuit_angle(s, p, driver, memory, tables), memory, driver[at.DELAY] / period)
    move = angle - memory[TO]
    if driver[at.LAG] > 0.0:
        move *= 1.0 - math.exp(-period / driver[at.LAG])
    most = driver[at.MAX_RATE] * period
    memory[FROM] = memory[TO]
    memory[TO] += min(max(move, -most), most)
    memory[TICK] = t
