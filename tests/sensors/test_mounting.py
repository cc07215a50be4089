"""Mountings: against composition of elementary rotations, and against scipy's."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raw_samples import MANIFEST
from scipy.spatial.transform import Rotation
from smts_validate.sensors import manifest, mounting
from smts_validate.sensors.manifest import Imd
from smts_validate.sensors.streams import ImuStream

angles = st.floats(-7.0, 7.0)


@given(angles, angles, angles)
def test_a_mounting_is_scipys_intrinsic_zyx(roll: float, pitch: float, yaw: float) -> None:
    oracle = Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
    assert mounting.rotation_matrix(roll, pitch, yaw) == pytest.approx(oracle, abs=1e-12)


def test_a_sensor_turned_left_by_a_quarter_feels_forward_as_its_minus_y() -> None:
    matrix = mounting.rotation_matrix(0.0, 0.0, math.pi / 2)
    assert matrix @ [0.0, -1.0, 0.0] == pytest.approx([1.0, 0.0, 0.0], abs=1e-15)


def test_an_upside_down_unit_at_rest_reads_gravity_upward_in_the_body() -> None:
    sensor = Imd(
        kind="imd", body="tractor", file="x", position=(0, 0, 0), rate=100.0, rotation_deg=(180.0, 0.0, 0.0)
    )
    down = np.array([[0.1, 0.2, -9.81]])
    stream = ImuStream("imd1", np.zeros(1), np.zeros(1), down, np.array([[0.0, 0.0, -0.5]]))
    force, turn = mounting.to_body(stream, sensor)
    assert force[0] == pytest.approx([0.1, -0.2, 9.81])
    assert turn[0] == pytest.approx([0.0, 0.0, 0.5])


@pytest.mark.parametrize(
    ("wheel", "hub"),
    [
        ("front_left", [1.45, 0.95, -0.38]),
        ("front_right", [1.45, -0.95, -0.38]),
        ("rear_left", [-1.15, 0.90, -0.20]),
        ("rear_right", [-1.15, -0.90, -0.20]),
    ],
)
def test_a_hub_is_on_its_axle_half_a_track_aside_one_radius_above_ground(
    wheel: manifest.Wheel, hub: list[float]
) -> None:
    machine = manifest.parse(MANIFEST.format(id="x", imd1="", rest="")).machine
    assert mounting.wheel_hub(machine, wheel) == pytest.approx(hub)
