"""Independent oracle: the equations of motion derived by sympy from the kinetic energy and virtual work.

Nothing of the package is used but the machine's numbers. The kinetic energy is that of two bodies whose
centres of mass are written down as positions; Lagrange's equations give M and h; every force enters as
F·∂r/∂q at its point.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import numpy as np
import sympy as sp

TIME = sp.Symbol("t")
COORDINATES = [sp.Function(name)(TIME) for name in ("x1", "y1", "p1", "p2")]
Q = sp.symbols("x1 y1 p1 p2")
QD = sp.symbols("vx vy w1 w2")
BODY = sp.symbols("m1 J1 l4 m2 J2 l5")


def _position(body: int, forward: sp.Expr, left: sp.Expr, q: list[sp.Expr]) -> sp.Matrix:
    _, _, l4, _, _, l5 = BODY
    x, y, p1, p2 = q
    centre = sp.Matrix([x, y])
    if body == 2:
        centre -= l4 * sp.Matrix([sp.cos(p1), sp.sin(p1)]) + l5 * sp.Matrix([sp.cos(p2), sp.sin(p2)])
    yaw = p1 if body == 1 else p2
    return centre + sp.Matrix(
        [forward * sp.cos(yaw) - left * sp.sin(yaw), forward * sp.sin(yaw) + left * sp.cos(yaw)]
    )


def _plain(expression: sp.Expr) -> sp.Expr:
    rates = {sp.diff(c, TIME): v for c, v in zip(COORDINATES, QD, strict=True)}
    return expression.subs(rates).subs(dict(zip(COORDINATES, Q, strict=True)))


@cache
def kinetic_energy() -> sp.Expr:
    m1, j1, _, m2, j2, _ = BODY
    first, second = (sp.diff(_position(b, 0, 0, COORDINATES), TIME) for b in (1, 2))
    turning = j1 * sp.diff(COORDINATES[2], TIME) ** 2 + j2 * sp.diff(COORDINATES[3], TIME) ** 2
    return (m1 * first.dot(first) + m2 * second.dot(second) + turning) / 2


@cache
def _compiled_left_side() -> tuple[Callable, Callable, Callable]:
    """M(q), h(q, q̇) and dT/dt as functions of numbers, from d/dt(∂T/∂q̇) − ∂T/∂q."""
    energy = _plain(kinetic_energy())
    momenta = [sp.diff(energy, v) for v in QD]
    mass = sp.Matrix(4, 4, lambda i, j: sp.diff(momenta[i], QD[j]))
    h = [sum(sp.diff(momenta[i], Q[j]) * QD[j] for j in range(4)) - sp.diff(energy, Q[i]) for i in range(4)]
    accelerations = sp.symbols("a1:5")
    power = sum(sp.diff(energy, Q[i]) * QD[i] + momenta[i] * accelerations[i] for i in range(4))
    arguments = (*BODY, *Q, *QD)
    return (
        sp.lambdify(arguments, mass),
        sp.lambdify(arguments, h),
        sp.lambdify((*arguments, *accelerations), power),
    )


def _numbers(machine) -> tuple[float, ...]:
    t, s = machine.tractor, machine.seeder
    return (t.mass, t.yaw_inertia, t.hitch, s.mass, s.yaw_inertia, s.hitch_to_com)


def mass_matrix(machine, state: np.ndarray) -> np.ndarray:
    return np.array(_compiled_left_side()[0](*_numbers(machine), *state), dtype=float)


def quadratic_terms(machine, state: np.ndarray) -> np.ndarray:
    return np.array(_compiled_left_side()[1](*_numbers(machine), *state), dtype=float)


def energy_rate(machine, state: np.ndarray, accelerations: np.ndarray) -> float:
    """dT/dt by the chain rule on the symbolic T."""
    return float(_compiled_left_side()[2](*_numbers(machine), *state, *accelerations))


@cache
def _compiled_point(body: int) -> tuple[Callable, Callable]:
    """Velocity (2,) and ∂r/∂q (2, 4) of a point of a body as functions of numbers."""
    forward, left = sp.symbols("forward left")
    place = _position(body, forward, left, list(Q))
    jacobian = place.jacobian(list(Q))
    arguments = (*BODY, *Q, *QD, forward, left)
    return sp.lambdify(arguments, jacobian * sp.Matrix(QD)), sp.lambdify(arguments, jacobian)


def _point(
    machine, state: np.ndarray, body: int, place: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    arguments = (*_numbers(machine), *state, *place)
    velocity, jacobian = _compiled_point(body)
    return np.array(velocity(*arguments), dtype=float).ravel(), np.array(jacobian(*arguments), dtype=float)


def wheels(machine, steer: float) -> list[dict]:
    """Every wheel from the machine's numbers, loads by solving the balance of forces and moments."""
    t, s, g = machine.tractor, machine.seeder, 9.80665
    axle = np.mean(s.com_to_axle)
    carried, hitch = np.linalg.solve([[1.0, 1.0], [axle, -s.hitch_to_com]], [s.mass * g, 0.0])
    front, rear = np.linalg.solve(
        [[1.0, 1.0], [t.front_axle, -t.rear_axle]], [t.mass * g + hitch, -hitch * t.hitch]
    )
    ratio = t.front_track / (t.front_axle + t.rear_axle)
    left, right = _ackermann(steer, ratio)
    stiff = [
        tyre.cornering_stiffness * (0.12 / 0.10) ** 0.5 for tyre in (machine.tyres.front, machine.tyres.rear)
    ]
    result = [
        {
            "body": 1,
            "place": (t.front_axle, t.front_track / 2),
            "angle": left,
            "load": front / 2,
            "c": stiff[0],
        },
        {
            "body": 1,
            "place": (t.front_axle, -t.front_track / 2),
            "angle": right,
            "load": front / 2,
            "c": stiff[0],
        },
        {"body": 1, "place": (-t.rear_axle, t.rear_track / 2), "angle": 0.0, "load": rear / 2, "c": stiff[1]},
        {
            "body": 1,
            "place": (-t.rear_axle, -t.rear_track / 2),
            "angle": 0.0,
            "load": rear / 2,
            "c": stiff[1],
        },
    ]
    for behind, track in zip(s.com_to_axle, s.track, strict=True):
        load = carried / len(s.com_to_axle) / 2
        for side in (1, -1):
            c = machine.tyres.seeder.cornering_stiffness
            result.append(
                {"body": 2, "place": (-behind, side * track / 2), "angle": 0.0, "load": load, "c": c}
            )
    return result


def _ackermann(mean: float, ratio: float) -> tuple[float, float]:
    """Left and right angle by bisection on the difference until cot right − cot left is track/wheelbase."""
    if mean == 0.0:
        return 0.0, 0.0
    low, high = 0.0, abs(mean)
    for _ in range(200):
        half = 0.5 * (low + high)
        inner, outer = abs(mean) + half, abs(mean) - half
        if outer <= 0.0 or 1.0 / math.tan(outer) - 1.0 / math.tan(inner) > ratio:
            high = half
        else:
            low = half
    return (abs(mean) + low, abs(mean) - low) if mean > 0.0 else (-abs(mean) + low, -abs(mean) - low)


def accelerations(machine, state, steer, speed, acceleration, disturbance, time_constant=0.5) -> np.ndarray:
    """q̈ of the exact equations with the tanh tyre, traction shared over all wheels by load."""
    todo = wheels(machine, steer)
    weight = sum(w["load"] for w in todo if w["body"] == 1)
    s, mass = machine.seeder, machine.tractor.mass + machine.seeder.mass
    v = math.cos(state[2]) * state[4] + math.sin(state[2]) * state[5]
    gamma = math.radians(s.draft_angle_deg)
    resistance = 0.08 * sum(w["load"] for w in todo) + s.draft * math.cos(gamma)
    traction = mass * (acceleration + (speed - v) / time_constant) + resistance * math.tanh(speed / 0.05)
    force = np.zeros(4)
    for w in todo:
        velocity, jacobian = _point(machine, state, w["body"], w["place"])
        heading = state[1 + w["body"]] + w["angle"]
        along = np.array([math.cos(heading), math.sin(heading)])
        across = np.array([-along[1], along[0]])
        slip = math.atan2(velocity @ across, max(abs(velocity @ along), 0.02))
        limit = 0.6 * w["load"]
        drive = np.clip(traction * w["load"] / weight, -limit, limit) if w["body"] == 1 else 0.0
        rolling = 0.08 * w["load"] * math.tanh(velocity @ along / 0.05)
        force += jacobian.T @ ((drive - rolling) * along - limit * math.tanh(w["c"] * slip / limit) * across)
    velocity, jacobian = _point(machine, state, 2, (-s.draft_point, 0.0))
    backwards = -velocity / np.linalg.norm(velocity) * s.draft * math.tanh(np.linalg.norm(velocity) / 0.05)
    turn = np.array([[math.cos(gamma), -math.sin(gamma)], [math.sin(gamma), math.cos(gamma)]])
    force += jacobian.T @ (turn @ backwards)
    for body in (1, 2):
        yaw, (fx, fy, moment) = state[1 + body], disturbance[3 * body - 3 : 3 * body]
        _, jacobian = _point(machine, state, body, (0.0, 0.0))
        world = [fx * math.cos(yaw) - fy * math.sin(yaw), fx * math.sin(yaw) + fy * math.cos(yaw)]
        force += jacobian.T @ np.array(world)
        force[1 + body] += moment
    return np.linalg.solve(mass_matrix(machine, state), force - quadratic_terms(machine, state))
