"""The machine and the sensors that a twin has unless its plan says otherwise (tables of run.toml).

Mass, tracks and wheel radii are of the class of an MTZ-1025 with a trailed seeder (maker's data: 4480 kg
unballasted, tracks 1.43 to 2.10 m); inertias, stiffnesses and draft are the assumptions of the format page.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def _tyre(stiffness: float) -> dict[str, float]:
    return {
        "cornering_stiffness": stiffness,
        "reference_pressure_mpa": 0.10,
        "pressure_exponent": 0.5,
        "friction": 0.6,
        "rolling_resistance": 0.08,
        "relaxation_length": 0.0,
    }


def _imd(name: str, body: str, position: list[float], rotation_deg: list[float]) -> dict[str, Any]:
    return {
        "kind": "imd",
        "body": body,
        "file": f"{name}.csv",
        "position": position,
        "rotation_deg": rotation_deg,
        "rate": 100.0,
    }


def _wds(name: str, wheel: str, offset: list[float], rotation_deg: list[float]) -> dict[str, Any]:
    return {
        "kind": "wds",
        "wheel": wheel,
        "file": f"{name}.csv",
        "offset": offset,
        "rotation_deg": rotation_deg,
        "rate": 100.0,
    }


MACHINE: Mapping[str, Any] = {
    "tractor": {
        "mass": 5200.0,
        "yaw_inertia": 9500.0,
        "front_track": 1.90,
        "rear_track": 1.80,
        "front_axle": 1.45,
        "rear_axle": 1.15,
        "hitch": 2.05,
        "cog_height": 1.0,
        "front_wheel_radius": 0.62,
        "rear_wheel_radius": 0.80,
        "driven": "all",
    },
    "seeder": {
        "mass": 3300.0,
        "yaw_inertia": 5200.0,
        "hitch_to_com": 3.0,
        "com_to_axle": 0.35,
        "track": 3.60,
        "cog_height": 0.9,
        "wheel_radius": 0.50,
        "draft": 9000.0,
        "draft_angle_deg": 0.0,
    },
    "tyres": {"front": _tyre(6.0e4), "rear": _tyre(9.5e4), "seeder": _tyre(5.5e4)},
}

SENSORS: Mapping[str, Any] = {
    "imd1": _imd("imd1", "tractor", [0.30, 0.05, -0.20], [0.0, 0.0, 0.0]),
    "imd2": _imd("imd2", "seeder", [0.20, 0.0, 0.10], [0.0, 0.0, 90.0]),
    "imd3": _imd("imd3", "seeder", [-0.60, 1.60, 0.15], [180.0, 0.0, 0.0]),
    "wds1": _wds("wds1", "front_right", [0.05, 0.02, 0.10], [0.0, 0.0, 0.0]),
    "wds2": _wds("wds2", "front_left", [-0.08, 0.03, 0.04], [0.0, 0.0, 180.0]),
    "wds3": _wds("wds3", "rear_right", [0.10, -0.02, 0.06], [0.0, 0.0, 0.0]),
    "wds4": _wds("wds4", "rear_left", [0.0, 0.02, 0.12], [0.0, 45.0, 0.0]),
    "gps": {"kind": "gps", "body": "tractor", "file": "gps.nmea", "position": [0.0, 0.0, 2.10], "rate": 10.0},
}

STEER_SENSOR: Mapping[str, Any] = {"kind": "steer", "file": "steer.csv", "rate": 50.0}
GPS2: Mapping[str, Any] = {
    "kind": "gps", "body": "seeder", "file": "gps2.nmea", "position": [-0.5, 0.0, 1.6], "rate": 10.0,
}  # fmt: skip
