"""Magnetometers: which prove consistent, and that those that are used cannot bias the yaw."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fusion_samples import Sample, changed, errors, make, rms
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.fusion.magnetic import Seconds, judged, levelled
from smts_validate.pipeline.fusion.motion import Motion
from smts_validate.pipeline.fusion.settings import FusionSettings
from smts_validate.pipeline.twin_plan import preset
from smts_validate.sensors.mounting import rotation_matrix
from smts_validate.sensors.streams import FieldLog, ImuStream

DEG = np.pi / 180.0
EARTH = np.array([2e-6, 19e-6, -44e-6])  # T, east, north, up
T = np.arange(0.0, 80.0)
ROW = 0.3 + 0.02 * np.sin(0.7 * T)
ROWS = np.where(T < 38.0, ROW, ROW + np.pi)


def seconds(yaw: np.ndarray, iron: tuple[float, float, float] = (8e-6, -5e-6, 3e-6)) -> Seconds:
    """The field on a level body that turns with `yaw`, its own iron and 0.1 µT of noise added; it stands for 5 s."""
    c, s = np.cos(yaw), np.sin(yaw)
    field = np.column_stack(
        [c * EARTH[0] + s * EARTH[1], -s * EARTH[0] + c * EARTH[1], np.full(yaw.size, EARTH[2])]
    )
    noise = 0.1e-6 * np.random.default_rng(0).standard_normal(field.shape)
    return Seconds(T, field + np.array(iron) + noise, yaw, T < 5.0)


def judge(x: Seconds) -> str:
    """Why a magnetometer on a row is not used."""
    return judged("imd", "tractor", x, np.arange(0.0, 80.0, 0.02)).reason


@pytest.mark.parametrize("yaw", [ROW, ROWS])
def test_a_field_that_keeps_still_is_consistent_whatever_iron_is_fixed_to_the_body(yaw: np.ndarray) -> None:
    assert judge(seconds(yaw)) == ""


def test_on_rows_both_ways_the_hard_iron_is_told_from_the_earths_field() -> None:
    found = judged("imd", "tractor", seconds(ROWS), np.arange(0.0, 80.0, 0.02))
    assert np.abs(found.offset).max() < 0.5 * DEG  # left in, iron of 8 µT beside 19 would turn a row by 20°


def test_what_is_not_noise_about_a_constant_is_not_used() -> None:
    x = seconds(ROW)
    switched = np.where((T > 30.0) & (T < 55.0), 4e-6, 0.0)[:, None] * np.array([0.0, 0.0, 1.0])
    drifting = np.column_stack([0.0 * T, 0.9e-6 * T / T[-1], 0.0 * T])
    engine = np.where(T < 5.0, 0.0, 1.2e-6)[:, None] * np.array([1.0, -1.0, 0.0]) / math.sqrt(2.0)
    assert "strength varies" in judge(replace(x, field=x.field + switched))
    assert judge(replace(x, field=x.field + drifting)) != ""
    assert judge(replace(x, field=x.field + engine)) != ""
    assert "too few" in judge(Seconds(T[:20], x.field[:20], ROW[:20], x.still[:20]))
    foreign = seconds(ROWS)
    assert "not the earth's" in judge(replace(foreign, field=3.0 * foreign.field))


def test_all_readings_together_know_the_yaw_no_better_than_soft_iron_lets_them() -> None:
    found = judged("imd", "tractor", seconds(ROW), np.arange(0.0, 80.0, 0.02))
    assert found.sd / math.sqrt(found.offset.size) >= 0.5 * DEG * (1.0 - 1e-12)


def test_the_field_is_levelled_by_roll_and_pitch() -> None:
    roll, pitch = 0.11, -0.07
    level = np.array([15e-6, -9e-6, -44e-6])
    tilted = rotation_matrix(roll, pitch, 0.0).T @ level  # what a unit on the tilted body feels
    got = levelled(tilted[None], np.array([roll]), np.array([pitch]))
    np.testing.assert_allclose(got[0], level, rtol=0, atol=1e-18)


SHORT = changed(preset("benign"), path__duration=60.0)
PLAIN = FusionSettings(adapt=False, draws=2)


@pytest.fixture(scope="module")
def twin() -> Sample:
    """A plain pass."""
    return make(SHORT, 2)


def turned_units(log: FieldLog, degrees: float) -> FieldLog:
    """The same log with every magnetometer's field turned about the vertical: another declination."""
    turn = rotation_matrix(0.0, 0.0, math.radians(degrees))
    streams = dict(log.streams)
    for name, stream in log.of_type(ImuStream).items():
        assert stream.magnetic_field is not None
        mounting = log.manifest.sensors[name].rotation_deg
        body = rotation_matrix(*(math.radians(a) for a in mounting))
        streams[name] = replace(stream, magnetic_field=stream.magnetic_field @ (body.T @ turn @ body).T)
    return replace(log, streams=streams)


def used(motion: Motion) -> list[str]:
    """Names of the magnetometers that were used."""
    return [name for name, entry in motion.noise.items() if "value" in entry.get("magnetometer", {})]


def test_declination_and_mounting_leave_the_yaw_alone(twin: Sample) -> None:
    here, there = fuse(twin.log, PLAIN), fuse(turned_units(twin.log, 40.0), PLAIN)
    assert "imd1" in used(here)
    assert used(there) == used(here)
    for one, other in zip(here.bodies, there.bodies, strict=True):
        np.testing.assert_allclose(other.yaw, one.yaw, rtol=0, atol=0.003 * DEG)


@pytest.mark.parametrize("current", [0.0, 1e-6, 4e-6])
def test_a_magnetised_machine_is_measured_no_worse(current: float) -> None:
    of = make(changed(SHORT, errors__soft_iron=0.05, errors__current_field=current), 2)
    with_them, without = fuse(of.log, PLAIN), fuse(of.log, replace(PLAIN, magnetometers=False))
    for name in ("yaw1", "yaw2"):
        (error, sd), (before, sd_before) = errors(with_them, of)[name], errors(without, of)[name]
        assert rms(error) < 1.05 * rms(before) + 0.001 * DEG
        assert rms(sd) > 0.9 * rms(sd_before)
    assert with_them.consistent == without.consistent


def test_a_pass_says_of_every_magnetometer_what_became_of_it(twin: Sample) -> None:
    motion = fuse(twin.log, PLAIN)
    for name in twin.log.of_type(ImuStream):
        told = motion.noise[name]["magnetometer"]
        assert told["source"].startswith(("consistent", "not used: "))
