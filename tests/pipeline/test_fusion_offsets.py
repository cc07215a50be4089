"""How large accelerometers' offsets are, by the axes where the truth is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fusion_samples import sample
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.epochs import Epochs
from smts_validate.pipeline.fusion.known import build, mean_offset, prepare
from smts_validate.pipeline.fusion.offsets import FACTOR, Reading, along, offset_sd, risen, upwards
from smts_validate.pipeline.fusion.settings import ACCEL_BIAS, MOUNT_SD, FusionSettings, Levels
from smts_validate.pipeline.wheels import wheel_motions
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


@pytest.mark.parametrize("tilt", [0.0, 0.15])
def test_what_a_unit_at_rest_reads_beyond_gravity_is_its_offset_on_a_slope_too(tilt: float) -> None:
    axis = np.array([0.0, math.sin(tilt), math.cos(tilt)])
    found = upwards(np.tile((GRAVITY - 0.08) * axis, (100, 1)), 2)
    assert found.value == pytest.approx(-0.08)
    assert found.units == 2


def test_the_mean_of_two_units_errs_by_what_is_stated_and_by_what_is_learnt_of_the_other() -> None:
    log = sample("benign", 3).log
    first = next(n for n, u in log.manifest.sensors.items() if u.kind == "imd" and u.body == "tractor")
    unit = log.manifest.sensors[first]
    pair = {"stated": 0.05, "silent": None}
    sensors = {name: u for name, u in log.manifest.sensors.items() if name != first}
    sensors |= {name: unit.model_copy(update={"accel_bias": bias}) for name, bias in pair.items()}
    streams = {name: stream for name, stream in log.streams.items() if name != first}
    streams |= {name: replace(log.streams[first], name=name) for name in pair}
    manifest = log.manifest.model_copy(update={"sensors": sensors})
    changed = replace(log, manifest=manifest, streams=streams)
    known = replace(prepare(changed, wheel_motions(changed)), offset=0.12)
    assert mean_offset(known, "tractor") == pytest.approx(0.5 * math.hypot(0.05, 0.12))
    task = build(known, FusionSettings(), Levels(), 0.0)
    assert task.P0[s.BAY, s.BAY] == pytest.approx(0.25 * (0.05**2 + 0.12**2))


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
