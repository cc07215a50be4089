"""How large accelerometers' offsets are, by the axes where the truth is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from smts_validate.pipeline.fusion.epochs import Epochs
from smts_validate.pipeline.fusion.offsets import FACTOR, Reading, along, offset_sd, risen, upwards
from smts_validate.pipeline.fusion.settings import ACCEL_BIAS, MOUNT_SD
from smts_validate.sensors.manifest import GRAVITY

STEP = 0.02


def drive(direction: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Way, speed, forward force of a unit without offset, and height gained, over a hill and from rest to a run."""
    t = np.arange(0.0, 60.0, STEP)
    speed = 2.5 * np.clip((t - 5.0) / 5.0, 0.0, 1.0)
    way = direction * np.cumsum(speed) * STEP
    slope = 0.02 + 0.03 * np.sin(way / 15.0)
    force = direction * np.gradient(speed, STEP) + GRAVITY * np.sin(np.arctan(slope))
    return way, speed, force, float(np.sum(np.gradient(way) * slope))


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_hills_and_gathering_speed_are_no_offset_along_the_way(direction: float) -> None:
    way, speed, force, rise = drive(direction)
    found = along(force + 0.15, way, speed, (rise, 0.03), 1)
    assert found is not None
    assert found.value == pytest.approx(0.15, abs=0.005)


def test_too_short_a_way_tells_nothing_along() -> None:
    way, speed, force, rise = drive(1.0)
    assert along(force[:800], way[:800], speed[:800], (rise, 0.03), 1) is None


def test_what_a_vertical_axis_reads_beyond_gravity_is_its_offset() -> None:
    found = upwards(np.full(100, GRAVITY - 0.08), 2)
    assert found.value == pytest.approx(-0.08)
    assert found.units == 2


def test_height_gained_is_from_end_to_end_and_unknown_without_altitudes() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    nothing, some = np.full(t.size, np.nan), np.ones(t.size, dtype=bool)
    z = np.interp(t, [3.0, 57.0], [0.0, 1.8])
    e = Epochs(
        "gps", "tractor", True, t, t, 0.0 * t, z, np.full(t.size, 0.01), some, nothing, nothing, nothing, True
    )
    found = risen(e)
    assert found is not None
    assert found[0] == pytest.approx(1.8, abs=1e-9)
    assert found[1] == pytest.approx(2.0 * 0.01 * math.sqrt(2.0), rel=1e-6)
    blind = Epochs(
        "gps", "tractor", True, t, t, 0.0 * t, nothing, np.full(t.size, 0.01), some, nothing, nothing, nothing, True
    )  # fmt: skip
    assert risen(blind) is None


def test_units_that_are_good_along_and_up_are_taken_for_good_across() -> None:
    def of(value: float) -> list[Reading]:
        return [Reading(value, 1, 0.05**2), Reading(-value, 2, 0.05**2)]

    good, usual, bad = (offset_sd(of(v)) for v in (0.01, 0.2, 0.6))
    assert good < 0.8 * ACCEL_BIAS < usual < 2.0 * ACCEL_BIAS < bad
    assert good > GRAVITY * MOUNT_SD  # a bracket stays as crooked as it is


def test_offsets_drawn_from_the_prior_are_as_large_as_is_said() -> None:
    """Simulation-based calibration of the variance: one axis' offset over the deviation that the others tell."""
    rng = np.random.default_rng(4)
    mount, normalised = GRAVITY * MOUNT_SD, []
    for _ in range(4000):
        size = ACCEL_BIAS * math.exp(math.log(FACTOR) * rng.standard_normal())
        up, ahead = size * rng.standard_normal(2)
        ahead += mount * rng.standard_normal()
        readings = [
            Reading(up + 0.05 * rng.standard_normal(), 1, 0.05**2),
            Reading(ahead + 0.05 * rng.standard_normal(), 1, 0.05**2 + mount**2),
        ]
        across = size * rng.standard_normal() + mount * rng.standard_normal()
        normalised.append(across / offset_sd(readings))
    assert np.mean(np.square(normalised)) == pytest.approx(1.0, abs=0.12)
    assert 0.93 < np.mean(np.abs(normalised) < 1.96) < 0.97
