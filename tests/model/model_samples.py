"""Machines and states for the model's tests; round numbers, no machine in particular."""

from __future__ import annotations

import numpy as np
from smts_validate.model.machine import Machine

TABLE = {
    "tractor": {
        "mass": 4800.0,
        "yaw_inertia": 8600.0,
        "front_track": 1.9,
        "rear_track": 1.8,
        "front_axle": 1.4,
        "rear_axle": 1.1,
        "hitch": 2.0,
    },
    "seeder": {
        "mass": 2900.0,
        "yaw_inertia": 4500.0,
        "hitch_to_com": 2.7,
        "com_to_axle": 0.3,
        "track": 3.6,
        "draft": 7800.0,
        "draft_angle_deg": 4.0,
        "draft_point": 0.4,
    },
    "tyres": {
        "front": {"cornering_stiffness": 55e3},
        "rear": {"cornering_stiffness": 90e3},
        "seeder": {"cornering_stiffness": 50e3},
    },
}


def trailed() -> Machine:
    return Machine.from_mapping(TABLE, 0.12)


def tandem() -> Machine:
    return trailed().replace_parameters({"seeder.com_to_axle": (0.1, 0.9), "seeder.track": (3.6, 3.2)})


def alone() -> Machine:
    table = {"tractor": TABLE["tractor"], "tyres": {k: TABLE["tyres"][k] for k in ("front", "rear")}}
    return Machine.from_mapping(table, 0.12)


def frictionless(machine: Machine) -> Machine:
    """Without draft and rolling resistance, so that no traction is needed to roll on."""
    names = ["tyres.front", "tyres.rear"] + (["tyres.seeder"] if machine.seeder else [])
    values = {f"{name}.rolling_resistance": 0.0 for name in names}
    return machine.replace_parameters(values | ({"seeder.draft": 0.0} if machine.seeder else {}))


def random_states(count: int, seed: int = 1) -> np.ndarray:
    """States with any yaws, rates up to 1 rad/s and velocities up to 4 m/s."""
    generator = np.random.default_rng(seed)
    scale = np.array([50.0, 50.0, 3.0, 3.0, 4.0, 4.0, 1.0, 1.0])
    return generator.uniform(-1.0, 1.0, (count, 8)) * scale
