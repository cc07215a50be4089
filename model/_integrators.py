"""Compiled runs: inputs at an instant, the driver, fixed-step Runge–Kutta 4, and batches of runs."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from . import _layout as at
from ._kernels import SLOWEST, derivative, interpolate
from ._layout import Floats, Options, Tables

FULL_SIZE, SLIP, VX1, VY1, W1, W2 = at.FULL_SIZE, at.SLIP, at.VX1, at.VY1, at.W1, at.W2
X1, Y1, YAW1, YAW2, DISTANCE = at.X1, at.Y1, at.YAW1, at.YAW2, at.DISTANCE
FORCE, FORCE_SIZE = at.FORCE, at.FORCE_SIZE
HITCH, L5 = at.HITCH, at.HITCH_TO_COM
WHEELS, WHEEL_SIZE = at.WHEELS, at.WHEEL_SIZE
STABLE = 1.5  # of h·λ: Runge–Kutta 4 is stable on the real axis up to 2.78
FASTEST_TURN = 50.0  # rad/s; a body that turns faster has diverged

# Place of the driver's own memory: progress along the path, last and next steering angle, time of the last
# tick, newest place in the ring of past commands, then the ring.
PROGRESS, FROM, TO, TICK, NEWEST, RING = range(6)
RING_SIZE = 256


@njit(cache=True)
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


@njit(cache=True)
def steering(t: float, memory: Floats, driver: Floats, change: Floats, tables: Tables, h: float) -> float:
    """Mean front angle at t: table (scaled, offset) plus the driver's ramp between its ticks."""
    place = (t - tables.t0) / tables.dt
    row = int(change[at.STEER_ROW])
    mean = change[at.STEER_OFFSET] + change[at.STEER_SCALE] * line(tables.steer[row], place)
    if driver[at.ACTIVE] > 0.0:
        part = (t - memory[TICK]) / (driver[at.PERIOD_STEPS] * h)
        mean += memory[FROM] + part * (memory[TO] - memory[FROM])
    return float(mean)


@njit(cache=True)
def line(table: Floats, place: float) -> float:
    """Linear interpolation in an equally spaced series, held beyond its ends."""
    last = table.shape[0] - 1
    if place <= 0.0:
        return float(table[0])
    if place >= last:
        return float(table[last])
    i = int(place)
    return float(table[i] + (place - i) * (table[i + 1] - table[i]))


@njit(cache=True)
def load_inputs(t: float, mean: float, p: Floats, change: Floats, tables: Tables, u: Floats) -> None:
    """Inputs u at time t for the mean front angle."""
    place = (t - tables.t0) / tables.dt
    half = inner_angles(mean, p[at.ACKERMANN])
    u[at.SIN_LEFT], u[at.COS_LEFT] = math.sin(mean + half), math.cos(mean + half)
    u[at.SIN_RIGHT], u[at.COS_RIGHT] = math.sin(mean - half), math.cos(mean - half)
    u[at.SPEED] = change[at.SPEED_SCALE] * line(tables.speed, place) + change[at.SPEED_OFFSET]
    u[at.ACCELERATION] = change[at.SPEED_SCALE] * line(tables.acceleration, place)
    if tables.time_force.shape[1] > 0:
        row = int(change[at.FORCE_ROW])
        for k in range(FORCE_SIZE):
            u[FORCE + k] = interpolate(tables.time_force[row], place, k)


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def substeps(s: Floats, p: Floats, h: float) -> int:
    """Parts of a step that keep Runge–Kutta 4 stable: sideways damping grows as 1/v towards standstill."""
    speed = max(abs(s[VX1] * math.cos(s[YAW1]) + s[VY1] * math.sin(s[YAW1])), SLOWEST)
    fastest = p[at.STIFF_RATE] / speed + p[at.SLIP_RATE] * speed
    return 1 + int(h * fastest / STABLE) if fastest < 1e6 else 1 + int(1e6 * h)


@njit(cache=True)
def finish_step(
    t: float, h: float, s: Floats, size: int, p: Floats, driver: Floats, memory: Floats, change: Floats,
    tables: Tables, options: Options, step: float, u: Floats, k: Floats, trial: Floats,
) -> None:  # fmt: skip
    """Runge–Kutta 4 from t to t + h, its first slope k[0] being known; leaves u at t + h."""
    row = int(change[at.FORCE_ROW])
    load_inputs(
        t + 0.5 * h, steering(t + 0.5 * h, memory, driver, change, tables, step), p, change, tables, u
    )
    for i in range(size):
        trial[i] = s[i] + 0.5 * h * k[0, i]
    derivative(trial, p, u, tables, row, options, k[1])
    for i in range(size):
        trial[i] = s[i] + 0.5 * h * k[1, i]
    derivative(trial, p, u, tables, row, options, k[2])
    for i in range(size):
        trial[i] = s[i] + h * k[2, i]
    load_inputs(t + h, steering(t + h, memory, driver, change, tables, step), p, change, tables, u)
    derivative(trial, p, u, tables, row, options, k[3])
    for i in range(size):
        s[i] += h / 6.0 * (k[0, i] + 2.0 * (k[1, i] + k[2, i]) + k[3, i])


@njit(cache=True)
def start_slips(s: Floats, p: Floats, u: Floats) -> None:
    """Slip states of the first instant: the slip angles of rolling without relaxation."""
    s1, c1, s2, c2 = math.sin(s[YAW1]), math.cos(s[YAW1]), math.sin(s[YAW2]), math.cos(s[YAW2])
    vx2 = s[VX1] + p[HITCH] * s1 * s[W1] + p[L5] * s2 * s[W2]
    vy2 = s[VY1] - p[HITCH] * c1 * s[W1] - p[L5] * c2 * s[W2]
    for i in range(at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS])):
        px, py = p[WHEELS + i * WHEEL_SIZE + at.WHEEL_X], p[WHEELS + i * WHEEL_SIZE + at.WHEEL_Y]
        sin, cos = (u[2 * i], u[2 * i + 1]) if i < 2 else (0.0, 1.0)
        if i < at.TRACTOR_WHEELS:
            forward, sideways = c1 * s[VX1] + s1 * s[VY1] - s[W1] * py, c1 * s[VY1] - s1 * s[VX1] + s[W1] * px
        else:
            forward, sideways = c2 * vx2 + s2 * vy2 - s[W2] * py, c2 * vy2 - s2 * vx2 + s[W2] * px
        along, across = cos * forward + sin * sideways, cos * sideways - sin * forward
        s[SLIP + i] = math.atan2(across, max(abs(along), SLOWEST))


@njit(cache=True)
def has_diverged(s: Floats) -> bool:
    """Whether the state is no longer finite, or a body spins as no machine does."""
    return not (
        math.isfinite(s[X1])
        and math.isfinite(s[Y1])
        and abs(s[W1]) < FASTEST_TURN
        and abs(s[W2]) < FASTEST_TURN
    )


@njit(cache=True)
def write_sample(s: Floats, rate: Floats, mean: float, sample: Floats) -> None:
    """One output sample: state, second derivatives, steering angle."""
    for i in range(at.STATE_SIZE):
        sample[i] = s[i]
    for i in range(4):
        sample[at.AX1 + i] = rate[VX1 + i]
    sample[at.STEER] = mean


@njit(cache=True, nogil=True)
def run(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, options: Options,
    h: float, every: int, memory: Floats, out: Floats,
) -> int:  # fmt: skip
    """One run at fixed step h, a sample every `every` steps into out (n, 13); gives how many samples are
    good."""
    size = SLIP + at.TRACTOR_WHEELS + int(p[at.SEEDER_WHEELS])
    s, u, trial, k = (
        np.zeros(FULL_SIZE),
        np.zeros(at.INPUT_SIZE),
        np.zeros(FULL_SIZE),
        np.zeros((4, FULL_SIZE)),
    )
    s[: at.STATE_SIZE] = initial
    start, row, period = change[at.START], int(change[at.FORCE_ROW]), max(int(driver[at.PERIOD_STEPS]), 1)
    memory[TICK] = start
    load_inputs(start, steering(start, memory, driver, change, tables, h), p, change, tables, u)
    start_slips(s, p, u)
    for step in range((out.shape[0] - 1) * every + 1):
        t = start + step * h
        if driver[at.ACTIVE] > 0.0 and step % period == 0:
            tick(t, s, p, driver, memory, tables, h)
        derivative(s, p, u, tables, row, options, k[0])
        if step % every == 0:
            if has_diverged(s):
                return step // every
            write_sample(s, k[0], steering(t, memory, driver, change, tables, h), out[step // every])
        parts = substeps(s, p, h)
        for part in range(parts):
            if part > 0:
                derivative(s, p, u, tables, row, options, k[0])
            finish_step(
                t + part * h / parts,
                h / parts,
                s,
                size,
                p,
                driver,
                memory,
                change,
                tables,
                options,
                h,
                u,
                k,
                trial,
            )
    return int(out.shape[0])


@njit(cache=True, nogil=True)
def run_batch(
    initial: Floats, p: Floats, driver: Floats, change: Floats, tables: Tables, options: Options,
    h: float, every: int, memory: Floats, out: Floats, good: Floats,
) -> None:  # fmt: skip
    """`run` for every row of initial; p, driver may hold one row for all."""
    for b in range(initial.shape[0]):
        good[b] = run(
            initial[b], p[b % p.shape[0]], driver[b % driver.shape[0]], change[b], tables, options,
            h, every, memory[b], out[b],
        )  # fmt: skip
