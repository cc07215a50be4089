"""Sensor frame to body frame, and where things sit on a body."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .manifest import Imd, Machine, Wds, Wheel
from .streams import ImuStream

Floats = NDArray[np.float64]


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Floats:
    """R = Rz(yaw)·Ry(pitch)·Rx(roll), (3, 3); angles in rad, right-handed.

    It turns vectors of the sensor's frame into the body's: v_body = R·v_sensor.
    """
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def mounting_matrix(rotation_deg: Sequence[float]) -> Floats:
    """R of a manifest's `rotation_deg` (roll, pitch, yaw in degrees)."""
    roll, pitch, yaw = (math.radians(angle) for angle in rotation_deg)
    return rotation_matrix(roll, pitch, yaw)


def to_body(stream: ImuStream, sensor: Imd | Wds) -> tuple[Floats, Floats]:
    """Specific force and angular velocity, (N, 3) each, along the axes of the sensor's body.

    For a wheel's unit the body is the wheel, whose frame turns with it.
    """
    turn = mounting_matrix(sensor.rotation_deg)
    return turned(stream.specific_force, turn), turned(stream.angular_velocity, turn)


def turned(vectors: Floats, matrix: Floats) -> Floats:
    """Each row v of (N, 3) as matrix·v, without BLAS: its threads take longer to gather than to multiply."""
    return np.asarray(np.einsum("kj,nj->nk", matrix, vectors))


def wheel_hub(machine: Machine, wheel: Wheel) -> Floats:
    """Centre of a tractor wheel's hub in the tractor's frame, m, (3,).

    On its axle, half the track to its side, one wheel radius above ground: the CoM is `cog_height` above it.
    """
    tractor = machine.tractor
    side = 0.5 if wheel.endswith("left") else -0.5
    if wheel.startswith("front"):
        x, track, radius = tractor.front_axle, tractor.front_track, tractor.front_wheel_radius
    else:
        x, track, radius = -tractor.rear_axle, tractor.rear_track, tractor.rear_wheel_radius
    return np.array([x, side * track, radius - tractor.cog_height])
