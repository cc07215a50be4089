"""The equations of motion in plain NumPy: M(q)·q̈ + h(q, q̇) = Q (the paper's eqs 1 to 5, corrected).

Written to be read and to test the compiled kernels against; `simulate` uses those. q = (x1, y1, yaw1, yaw2);
the seeder's CoM is x2 = x1 − l4·cos yaw1 − l5·cos yaw2, y2 = y1 − l4·sin yaw1 − l5·sin yaw2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .inputs import ackermann_angles
from .machine import Machine, Tyre
from .settings import SimulationSettings
from .tyres import lateral_force, law_code

Floats = NDArray[np.float64]
X1, Y1, YAW1, YAW2, VX1, VY1, W1, W2 = range(8)
FADE_SPEED = 0.05  # m/s, rolling resistance and draft fade in over this speed
SLOWEST = 0.02  # m/s, least rolling speed in the slip angle
DEFAULT = SimulationSettings()


@dataclass(frozen=True)
class Instant:
    """Inputs at one instant: steer rad (mean front angle); speed asked m/s and its rate m/s²; disturbance
    (F_O1 forward, F_O1 left, M_O1, the same at O2) in N and N·m, body frames."""

    steer: float = 0.0
    speed: float = 0.0
    acceleration: float = 0.0
    disturbance: tuple[float, float, float, float, float, float] = (0.0,) * 6


@dataclass(frozen=True)
class WheelForce:
    """One wheel: name, body (1 or 2), place in its body's frame (m), angle to it (rad), vertical load (N),
    slip angle (rad), and force along and across its heading (N)."""

    name: str
    body: int
    place: tuple[float, float]
    angle: float
    load: float
    slip: float
    along: float
    across: float

    @property
    def body_force(self) -> tuple[float, float]:
        """Force along the body's x and y axes, N."""
        sin, cos = math.sin(self.angle), math.cos(self.angle)
        return cos * self.along - sin * self.across, sin * self.along + cos * self.across


def _levers(machine: Machine) -> tuple[float, float, float, float, float, float]:
    """m1, J1, l4, m2, J2, l5; a tractor alone has a massless seeder of unit inertia that stays put."""
    t, s = machine.tractor, machine.seeder
    if s is None:
        return t.mass, t.yaw_inertia, t.hitch, 0.0, 1.0, 1.0
    return t.mass, t.yaw_inertia, t.hitch, s.mass, s.yaw_inertia, s.hitch_to_com


def mass_matrix(machine: Machine, q: Floats, settings: SimulationSettings = DEFAULT) -> Floats:
    """M(q), (4, 4): the paper's eq. (4). Exact: a34 = a43 = m2·l4·l5·cos(yaw1 − yaw2), as the kinetic energy
    demands; as printed: a34 = m2·l4·l5, which leaves M without its symmetry."""
    m1, inertia1, l4, m2, inertia2, l5 = _levers(machine)
    s1, c1, s2, c2 = math.sin(q[YAW1]), math.cos(q[YAW1]), math.sin(q[YAW2]), math.cos(q[YAW2])
    a43 = m2 * l4 * l5 * math.cos(q[YAW1] - q[YAW2])
    a34 = m2 * l4 * l5 if settings.equations == "as_printed" else a43
    return np.array(
        [
            [m1 + m2, 0.0, m2 * l4 * s1, m2 * l5 * s2],
            [0.0, m1 + m2, -m2 * l4 * c1, -m2 * l5 * c2],
            [m2 * l4 * s1, -m2 * l4 * c1, inertia1 + m2 * l4**2, a34],
            [m2 * l5 * s2, -m2 * l5 * c2, a43, inertia2 + m2 * l5**2],
        ]
    )


def quadratic_terms(machine: Machine, state: Floats, settings: SimulationSettings = DEFAULT) -> Floats:
    """h(q, q̇), (4,): h = m2·[l4·cos yaw1·w1² + l5·cos yaw2·w2², l4·sin yaw1·w1² + l5·sin yaw2·w2²,
    l4·l5·sin(yaw1 − yaw2)·w2², −l4·l5·sin(yaw1 − yaw2)·w1²]; zero in the equations as printed."""
    if settings.equations == "as_printed":
        return np.zeros(4)
    _, _, l4, m2, _, l5 = _levers(machine)
    p1, p2, w1, w2 = state[YAW1], state[YAW2], state[W1], state[W2]
    sine = l4 * l5 * math.sin(p1 - p2)
    return m2 * np.array(
        [
            l4 * math.cos(p1) * w1**2 + l5 * math.cos(p2) * w2**2,
            l4 * math.sin(p1) * w1**2 + l5 * math.sin(p2) * w2**2,
            sine * w2**2,
            -sine * w1**2,
        ]
    )


def kinetic_energy(machine: Machine, state: Floats) -> float:
    """T = ½·q̇ᵀ·M·q̇ with the exact M, in J (the paper's eq. 3)."""
    rates = state[VX1:]
    return float(0.5 * rates @ mass_matrix(machine, state) @ rates)


def point_jacobian(machine: Machine, q: Floats, body: int, place: tuple[float, float]) -> Floats:
    """∂r/∂q, (2, 4), of a point fixed to a body at (forward, left) of its CoM; its velocity is J·q̇."""
    _, _, l4, _, _, l5 = _levers(machine)
    yaw = q[YAW1] if body == 1 else q[YAW2]
    turn = np.array(
        [
            -place[0] * math.sin(yaw) - place[1] * math.cos(yaw),
            place[0] * math.cos(yaw) - place[1] * math.sin(yaw),
        ]
    )
    jacobian = np.zeros((2, 4))
    jacobian[:, :2] = np.eye(2)
    if body == 1:
        jacobian[:, YAW1] = turn
        return jacobian
    jacobian[:, YAW1] = l4 * math.sin(q[YAW1]), -l4 * math.cos(q[YAW1])
    jacobian[:, YAW2] = turn + np.array([l5 * math.sin(yaw), -l5 * math.cos(yaw)])
    return jacobian


def _turned(vector: Floats, angle: float) -> Floats:
    """A plane vector turned counter-clockwise."""
    sin, cos = math.sin(angle), math.cos(angle)
    return np.array([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])


def _places(machine: Machine) -> list[tuple[str, int, tuple[float, float], float, Tyre, float]]:
    """Name, body, place, load, tyre and cornering stiffness of every wheel, the paper's 11 to 14, 21, 22 …"""
    t, loads, tyres = machine.tractor, machine.wheel_loads(), machine.tyres
    pressure = machine.tyre_pressure_mpa
    wheels = [
        (f"{axle}_{side}", 1, (x, sign * track / 2.0), load, tyre, tyre.stiffness_at(pressure))
        for axle, x, track, load, tyre in (
            ("front", t.front_axle, t.front_track, loads.front, tyres.front),
            ("rear", -t.rear_axle, t.rear_track, loads.rear, tyres.rear),
        )
        for side, sign in (("left", 1.0), ("right", -1.0))
    ]
    if machine.seeder is None or tyres.seeder is None:
        return wheels
    axles = zip(machine.seeder.com_to_axle, machine.seeder.track, loads.seeder, strict=True)
    return wheels + [
        (
            f"seeder{i}_{side}",
            2,
            (-x, sign * track / 2.0),
            load,
            tyres.seeder,
            tyres.seeder.cornering_stiffness,
        )
        for i, (x, track, load) in enumerate(axles)
        for side, sign in (("left", 1.0), ("right", -1.0))
    ]


def traction_demand(machine: Machine, state: Floats, inputs: Instant, settings: SimulationSettings) -> float:
    """Traction of all driven wheels together, N: (m1 + m2)·(a + (v_asked − v)/T) + rolling resistances +
    draft."""
    m1, _, _, m2, _, _ = _levers(machine)
    v = math.cos(state[YAW1]) * state[VX1] + math.sin(state[YAW1]) * state[VY1]
    resistance = sum(tyre.rolling_resistance * load for _, _, _, load, tyre, _ in _places(machine))
    if machine.seeder is not None:
        resistance += machine.seeder.draft * math.cos(math.radians(machine.seeder.draft_angle_deg))
    wanted = inputs.acceleration + (inputs.speed - v) / settings.speed_time_constant
    return float((m1 + m2) * wanted + resistance * math.tanh(inputs.speed / FADE_SPEED))


def traction_share(machine: Machine, name: str) -> float:
    """Share of the traction that a wheel takes: by vertical load over the driven wheels."""
    loads, all_driven = machine.wheel_loads(), machine.tractor.driven == "all"
    driven = 2.0 * (loads.rear + (loads.front if all_driven else 0.0))
    if name.startswith("rear"):
        return loads.rear / driven
    return loads.front / driven if name.startswith("front") and all_driven else 0.0


def wheel_forces(
    machine: Machine,
    state: Floats,
    inputs: Instant,
    settings: SimulationSettings = DEFAULT,
    slips: Sequence[float] | None = None,
) -> tuple[WheelForce, ...]:
    """Forces of all wheels; `slips` are the relaxed slip angles (rad) in place of those of rolling."""
    traction = traction_demand(machine, state, inputs, settings)
    track = machine.tractor.front_track if settings.ackermann else 0.0
    left, right = ackermann_angles(inputs.steer, track, machine.tractor.wheelbase)
    angles = {"front_left": float(left), "front_right": float(right)}
    result = []
    for i, (name, body, place, load, tyre, stiffness) in enumerate(_places(machine)):
        angle = angles.get(name, 0.0)
        heading = (state[YAW1] if body == 1 else state[YAW2]) + angle
        velocity = _turned(point_jacobian(machine, state, body, place) @ state[VX1:], -heading)
        slip = math.atan2(velocity[1], max(abs(velocity[0]), SLOWEST)) if slips is None else slips[i]
        limit = tyre.friction * load
        drive = min(max(traction * traction_share(machine, name), -limit), limit)
        lateral_limit = math.sqrt(limit**2 - drive**2) if settings.friction_ellipse else limit
        along = drive - tyre.rolling_resistance * load * math.tanh(velocity[0] / FADE_SPEED)
        across = lateral_force(law_code(settings.tyre_law), slip, stiffness, lateral_limit)
        result.append(WheelForce(name, body, place, angle, load, slip, along, across))
    return tuple(result)


def draft_force(machine: Machine, state: Floats, settings: SimulationSettings = DEFAULT) -> Floats:
    """The seeder's traction resistance P2, N, world frame: against the velocity of its point of action (or of
    that velocity's part along the seeder's axis), turned counter-clockwise by γ21; it fades in from
    standstill."""
    seeder = machine.seeder
    if seeder is None:
        return np.zeros(2)
    velocity = point_jacobian(machine, state, 2, (-seeder.draft_point, 0.0)) @ state[VX1:]
    if settings.draft_direction == "axis":
        axis = np.array([math.cos(state[YAW2]), math.sin(state[YAW2])])
        velocity = axis * float(axis @ velocity)
    speed = math.hypot(*velocity)
    size = seeder.draft * math.tanh(speed / FADE_SPEED) / max(speed, 1e-9)
    return _turned(-size * velocity, math.radians(seeder.draft_angle_deg))


def generalised_forces(
    machine: Machine,
    state: Floats,
    inputs: Instant,
    settings: SimulationSettings = DEFAULT,
    slips: Sequence[float] | None = None,
) -> Floats:
    """Q, (4,), by virtual work: Q = Σ (∂r/∂q)ᵀ·F of every force at its point, plus the moments M_O1, M_O2."""
    total = np.zeros(4)
    for wheel in wheel_forces(machine, state, inputs, settings, slips):
        force = _turned(np.array(wheel.body_force), state[YAW1] if wheel.body == 1 else state[YAW2])
        total += point_jacobian(machine, state, wheel.body, wheel.place).T @ force
    if machine.seeder is not None:
        point = (-machine.seeder.draft_point, 0.0)
        total += point_jacobian(machine, state, 2, point).T @ draft_force(machine, state, settings)
    for body, yaw, start in ((1, YAW1, 0), (2, YAW2, 3)):
        force = _turned(np.array(inputs.disturbance[start : start + 2]), state[yaw])
        if body == 1 or machine.seeder is not None:
            total += point_jacobian(machine, state, body, (0.0, 0.0)).T @ force
            total[yaw] += inputs.disturbance[start + 2]
    return total


def solve_cramer(matrix: Floats, right: Floats) -> Floats:
    """x of matrix·x = right by Cramer's rule, the paper's way."""
    whole = np.linalg.det(matrix)
    columns = range(len(right))
    replaced = [np.where(np.arange(len(right)) == k, right[:, None], matrix) for k in columns]
    return np.array([np.linalg.det(part) / whole for part in replaced])


def right_hand_side(
    machine: Machine,
    state: Floats,
    inputs: Instant,
    settings: SimulationSettings = DEFAULT,
    slips: Sequence[float] | None = None,
) -> Floats:
    """d(state)/dt in Cauchy form, (8,): q̇ and q̈ = M⁻¹·(Q − h)."""
    matrix = mass_matrix(machine, state, settings)
    force = generalised_forces(machine, state, inputs, settings, slips)
    force -= quadratic_terms(machine, state, settings)
    solve = solve_cramer if settings.solver == "cramer" else np.linalg.solve
    return np.concatenate((state[VX1:], solve(matrix, force)))
