"""Compiled right-hand side of the equations of motion (`dynamics` holds the same in plain NumPy).

Numbers in, numbers out: places in the arrays are named in `_layout`. Forces are summed in each body's frame
and turned into the world's; the 4 x 4 system is reduced by hand to the two yaws, since M's upper left block
is (m1+m2)·I.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from . import _layout as at
from ._layout import Floats, Options
from .parts import part
from .tyres import lateral_force

FADE_SPEED = 0.05  # m/s, rolling resistance and draft fade in over this speed
SLOWEST = (
    0.02  # m/s, least rolling speed in the slip angle: below it a wheel resists sideways motion like a damper
)

(X1, Y1, YAW1, YAW2, VX1, VY1, W1, W2, DISTANCE, SLIP) = (
    at.X1, at.Y1, at.YAW1, at.YAW2, at.VX1, at.VY1, at.W1, at.W2, at.DISTANCE, at.SLIP
)  # fmt: skip
(MASS1, INERTIA1, HITCH, MASS2, INERTIA2, L5) = (
    at.MASS1, at.INERTIA1, at.HITCH, at.MASS2, at.INERTIA2, at.HITCH_TO_COM
)  # fmt: skip
(WHEELS, WHEEL_SIZE, WHEEL_X, WHEEL_Y) = (at.WHEELS, at.WHEEL_SIZE, at.WHEEL_X, at.WHEEL_Y)
(STIFFNESS, LIMIT, ROLLING, RELAXATION, SHARE) = (at.STIFFNESS, at.LIMIT, at.ROLLING, at.RELAXATION, at.SHARE)
(SIN_LEFT, COS_LEFT, SIN_RIGHT, COS_RIGHT) = (at.SIN_LEFT, at.COS_LEFT, at.SIN_RIGHT, at.COS_RIGHT)
FORCE, FORCE_NOW = at.FORCE, at.FORCE_NOW


@njit(cache=True, error_model="numpy", inline="always")
def fade(speed: float) -> float:
    """tanh(v / 0.05 m/s): a force against the motion that is gone at standstill."""
    if abs(speed) > 20.0 * FADE_SPEED:  # tanh(20) is 1 in double precision
        return math.copysign(1.0, speed)
    return math.tanh(speed / FADE_SPEED)


@njit(cache=True, error_model="numpy", inline="always")
def wheel_force(
    forward: float,
    sideways: float,
    p: Floats,
    base: int,
    traction: float,
    slip_state: float,
    options: Options,
) -> tuple[float, float, float]:
    """Force of one wheel along and across its heading, N, and the rate of its slip state, rad/s.

    forward, sideways: velocity of the contact point in the wheel's frame, m/s; traction: the whole
    machine's, N.
    """
    rolling = max(abs(forward), SLOWEST)
    slip = math.atan(sideways / rolling)
    rate = 0.0
    if p[base + RELAXATION] > 0.0:
        rate = rolling / p[base + RELAXATION] * (slip - slip_state)
        slip = slip_state
    limit = p[base + LIMIT]
    drive = min(max(traction * p[base + SHARE], -limit), limit)
    if options.ellipse == 1:
        limit = math.sqrt(limit * limit - drive * drive)
    across = lateral_force(options.law, slip, p[base + STIFFNESS], limit)
    return drive - p[base + ROLLING] * fade(forward), across, rate


@part
def traction_demand(speed: float, p: Floats, u: Floats) -> float:
    """Traction that the speed controller asks for, N: mass·(a + (v_asked − v)/T) and the known
    resistances."""
    mass = p[MASS1] + p[MASS2]
    asked = u[at.SPEED]
    wanted = u[at.ACCELERATION] + (asked - speed) * p[at.SPEED_RATE]
    return float(mass * wanted + p[at.RESISTANCE] * fade(asked))


@njit(cache=True, error_model="numpy", inline="always")
def tractor_force(
    v: float, sideways: float, w: float, s: Floats, p: Floats, u: Floats, options: Options, rate: Floats
) -> tuple[float, float, float]:
    """Sum of the four wheels' forces in the tractor's frame, N, and their moment about O1, N·m."""
    traction = traction_demand(v, p, u)
    sum_x, sum_y, moment = 0.0, 0.0, 0.0
    for i in range(4):
        base = WHEELS + i * WHEEL_SIZE
        px, py = p[base + WHEEL_X], p[base + WHEEL_Y]
        vx, vy = v - w * py, sideways + w * px
        sin, cos = (u[SIN_LEFT + 2 * i], u[COS_LEFT + 2 * i]) if i < 2 else (0.0, 1.0)
        along, across, slope = wheel_force(
            cos * vx + sin * vy, cos * vy - sin * vx, p, base, traction, s[SLIP + i], options
        )
        fx, fy = cos * along - sin * across, sin * along + cos * across
        rate[SLIP + i] = slope
        sum_x += fx
        sum_y += fy
        moment += px * fy - py * fx
    return sum_x, sum_y, moment


@njit(cache=True, error_model="numpy", inline="always")
def draft_force(
    v: float, sideways: float, w: float, p: Floats, options: Options
) -> tuple[float, float, float]:
    """Traction resistance P2 in the seeder's frame, N, and its moment about O2, N·m."""
    point = p[at.DRAFT_POINT]
    lateral = 0.0 if options.draft_on_axis == 1 else sideways - w * point
    speed = math.hypot(v, lateral)
    size = p[at.DRAFT] * fade(speed) / max(speed, 1e-9)
    fx = -size * (v * p[at.COS_DRAFT] - lateral * p[at.SIN_DRAFT])
    fy = -size * (v * p[at.SIN_DRAFT] + lateral * p[at.COS_DRAFT])
    return fx, fy, -point * fy


@njit(cache=True, error_model="numpy", inline="always")
def seeder_force(
    v: float, sideways: float, w: float, s: Floats, p: Floats, options: Options, rate: Floats
) -> tuple[float, float, float]:
    """Draft and wheels' forces in the seeder's frame, N, and their moment about O2, N·m."""
    sum_x, sum_y, moment = draft_force(v, sideways, w, p, options)
    for i in range(4, 4 + int(p[at.SEEDER_WHEELS])):
        base = WHEELS + i * WHEEL_SIZE
        px, py = p[base + WHEEL_X], p[base + WHEEL_Y]
        fx, fy, slope = wheel_force(v - w * py, sideways + w * px, p, base, 0.0, s[SLIP + i], options)
        rate[SLIP + i] = slope
        sum_x += fx
        sum_y += fy
        moment += px * fy - py * fx
    return sum_x, sum_y, moment


@part
def determinant3(
    a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, i: float
) -> float:
    """Determinant of [[a, b, c], [d, e, f], [g, h, i]]."""
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


@part
def determinant4(m: Floats) -> float:
    """Determinant of a (4, 4) matrix by its first row."""
    total, sign = 0.0, 1.0
    for k in range(4):
        j0, j1, j2 = (1 if k < 1 else 0), (2 if k < 2 else 1), (3 if k < 3 else 2)
        total += sign * m[0, k] * determinant3(
            m[1, j0], m[1, j1], m[1, j2], m[2, j0], m[2, j1], m[2, j2], m[3, j0], m[3, j1], m[3, j2]
        )  # fmt: skip
        sign = -sign
    return total


@part
def solve_cramer(m: Floats, r1: float, r2: float, r3: float, r4: float, rate: Floats) -> None:
    """rate[VX1..W2] = m⁻¹·r by Cramer's rule, the paper's way; m (4, 4) is left as it was."""
    whole = determinant4(m)
    for k in range(4):
        m0, m1, m2, m3 = m[0, k], m[1, k], m[2, k], m[3, k]
        m[0, k], m[1, k], m[2, k], m[3, k] = r1, r2, r3, r4
        rate[VX1 + k] = determinant4(m) / whole
        m[0, k], m[1, k], m[2, k], m[3, k] = m0, m1, m2, m3


@part
def solve_by_cramer(
    p: Floats, s1: float, c1: float, s2: float, c2: float, a34: float, a43: float,
    r1: float, r2: float, r3: float, r4: float, rate: Floats,
) -> None:  # fmt: skip
    """Accelerations by Cramer's rule on the whole (4, 4) system."""
    lever4, lever5 = p[MASS2] * p[HITCH], p[MASS2] * p[L5]
    m = np.zeros((4, 4))
    m[0, 0] = m[1, 1] = p[MASS1] + p[MASS2]
    m[0, 2] = m[2, 0] = lever4 * s1
    m[0, 3] = m[3, 0] = lever5 * s2
    m[1, 2] = m[2, 1] = -lever4 * c1
    m[1, 3] = m[3, 1] = -lever5 * c2
    m[2, 2] = p[INERTIA1] + lever4 * p[HITCH]
    m[3, 3] = p[INERTIA2] + lever5 * p[L5]
    m[2, 3], m[3, 2] = a34, a43
    solve_cramer(m, r1, r2, r3, r4, rate)


@njit(cache=True, error_model="numpy", inline="always")
def solve_by_elimination(
    p: Floats, s1: float, c1: float, s2: float, c2: float, a34: float, a43: float,
    r1: float, r2: float, r3: float, r4: float, rate: Floats,
) -> None:  # fmt: skip
    """Accelerations by eliminating rows 1 and 2 and solving the (2, 2) system of the yaws."""
    mass, m2, l4, l5 = p[MASS1] + p[MASS2], p[MASS2], p[HITCH], p[L5]
    cross = m2 * m2 * l4 * l5 * (c1 * c2 + s1 * s2) / mass
    b33 = p[INERTIA1] + m2 * l4 * l4 * (p[MASS1] / mass)
    b44 = p[INERTIA2] + m2 * l5 * l5 * (p[MASS1] / mass)
    b34, b43 = a34 - cross, a43 - cross
    e3 = r3 - m2 * l4 * (s1 * r1 - c1 * r2) / mass
    e4 = r4 - m2 * l5 * (s2 * r1 - c2 * r2) / mass
    determinant = b33 * b44 - b34 * b43
    alpha1 = (e3 * b44 - b34 * e4) / determinant
    alpha2 = (b33 * e4 - b43 * e3) / determinant
    rate[VX1] = (r1 - m2 * (l4 * s1 * alpha1 + l5 * s2 * alpha2)) / mass
    rate[VY1] = (r2 + m2 * (l4 * c1 * alpha1 + l5 * c2 * alpha2)) / mass
    rate[W1] = alpha1
    rate[W2] = alpha2


@njit(cache=True, error_model="numpy", inline="always")
def accelerate(
    s: Floats, p: Floats, s1: float, c1: float, s2: float, c2: float,
    q1: float, q2: float, q3: float, q4: float, options: Options, rate: Floats,
) -> None:  # fmt: skip
    """Solve M·q̈ = Q − h into rate[VX1..W2]; as printed: h = 0 and a34 without its cosine."""
    m2, l4, l5, w1, w2 = p[MASS2], p[HITCH], p[L5], s[W1], s[W2]
    a43 = m2 * l4 * l5 * (c1 * c2 + s1 * s2)
    a34 = a43
    if options.as_printed == 1:
        a34 = m2 * l4 * l5
    else:
        sine = m2 * l4 * l5 * (s1 * c2 - c1 * s2)
        q1 -= m2 * (l4 * c1 * w1 * w1 + l5 * c2 * w2 * w2)
        q2 -= m2 * (l4 * s1 * w1 * w1 + l5 * s2 * w2 * w2)
        q3 -= sine * w2 * w2
        q4 += sine * w1 * w1
    if options.cramer == 1:
        solve_by_cramer(p, s1, c1, s2, c2, a34, a43, q1, q2, q3, q4, rate)
    else:
        solve_by_elimination(p, s1, c1, s2, c2, a34, a43, q1, q2, q3, q4, rate)


@part
def interpolate(table: Floats, place: float, column: int) -> float:
    """Linear interpolation in a column of an equally spaced table at a fractional row, held beyond its
    ends."""
    last = table.shape[0] - 1
    if place <= 0.0:
        return float(table[0, column])
    if place >= last:
        return float(table[last, column])
    i = int(place)
    return float(table[i, column] + (place - i) * (table[i + 1, column] - table[i, column]))


@njit(cache=True, error_model="numpy", inline="always")
def add_distance_force(distance: float, p: Floats, ground: Floats, spacing: float, u: Floats) -> None:
    """Disturbance of this instant into u[FORCE_NOW..]: over time plus over distance; the seeder meets the
    latter when its own CoM gets there."""
    factor = u[at.FORCE_FACTOR]
    for i in range(at.FORCE_SIZE):
        u[at.FORCE_NOW + i] = factor * u[FORCE + i]
    if ground.shape[0] == 0:
        return
    here, behind = distance / spacing, (distance - p[HITCH] - p[L5]) / spacing
    for i in range(at.FORCE_SIZE):
        u[at.FORCE_NOW + i] += factor * interpolate(ground, here if i < 3 else behind, i)


@njit(cache=True, error_model="numpy")
def derivative(
    s: Floats, p: Floats, u: Floats, ground: Floats, spacing: float, options: Options, rate: Floats
) -> None:
    """Rate of the full state for the inputs u of this instant; ground: disturbance over distance, (n, 6)."""
    s1, c1, s2, c2 = math.sin(s[YAW1]), math.cos(s[YAW1]), math.sin(s[YAW2]), math.cos(s[YAW2])
    vx, vy, w1, w2, l4, l5 = s[VX1], s[VY1], s[W1], s[W2], p[HITCH], p[L5]
    vx2 = vx + l4 * s1 * w1 + l5 * s2 * w2
    vy2 = vy - l4 * c1 * w1 - l5 * c2 * w2
    v1, v2 = c1 * vx + s1 * vy, c2 * vx2 + s2 * vy2
    bx1, by1, moment1 = tractor_force(v1, c1 * vy - s1 * vx, w1, s, p, u, options, rate)
    bx2, by2, moment2 = seeder_force(v2, c2 * vy2 - s2 * vx2, w2, s, p, options, rate)
    add_distance_force(s[DISTANCE], p, ground, spacing, u)
    bx1, by1, moment1 = bx1 + u[FORCE_NOW], by1 + u[FORCE_NOW + 1], moment1 + u[FORCE_NOW + 2]
    bx2, by2, moment2 = bx2 + u[FORCE_NOW + 3], by2 + u[FORCE_NOW + 4], moment2 + u[FORCE_NOW + 5]
    fx2, fy2 = c2 * bx2 - s2 * by2, s2 * bx2 + c2 * by2
    q1 = c1 * bx1 - s1 * by1 + fx2
    q2 = s1 * bx1 + c1 * by1 + fy2
    q3 = moment1 + l4 * (s1 * fx2 - c1 * fy2)
    q4 = moment2 + l5 * (s2 * fx2 - c2 * fy2)
    rate[X1], rate[Y1], rate[YAW1], rate[YAW2], rate[DISTANCE] = vx, vy, w1, w2, v1
    accelerate(s, p, s1, c1, s2, c2, q1, q2, q3, q4, options, rate)
