"""Slopes, creeping and headings across ±π: what unseen fields do to the first guesses and to the tilt."""

from __future__ import annotations

import math

import numpy as np
import pytest
from fusion_samples import changed, errors, make, rms
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.fusion.known import prepare
from smts_validate.pipeline.fusion.problem import leaning, sloping
from smts_validate.pipeline.twin_plan import TwinPlan, preset
from smts_validate.pipeline.wheels import wheel_motions

DEG = math.pi / 180.0
SHORT = changed(preset("benign"), path__duration=40.0)


def across(plan: TwinPlan, slope: float) -> TwinPlan:
    """The plan on ground that rises by `slope` to the left of its row."""
    heading = math.radians(plan.place.heading_deg)
    return changed(
        plan, soil__slope_east=-math.sin(heading) * slope, soil__slope_north=math.cos(heading) * slope
    )


@pytest.mark.parametrize(
    "heading",
    [0.3, 2.0, -3.0],
)
def test_a_cross_slope_that_two_bodies_read_is_as_large_as_beyond_their_biases(heading: float) -> None:
    yaw = np.full(3000, heading)
    bias1, bias2, read1, read2 = 0.02, 0.015, 0.050, 0.058
    lean = 0.02**2 * 2.0 / 60.0  # rough ground, mean over 60 s
    bodies = [
        leaning(yaw, np.full(3000, read1), bias1, 60.0),
        leaning(yaw, np.full(3000, read2), bias2, 60.0),
    ]
    # the weighted mean of two readings, and its variance; a wide prior hardly shrinks it
    weights = np.array([1.0 / (bias1**2 + lean), 1.0 / (bias2**2 + lean)])
    mean, variance = weights @ [read1, read2] / weights.sum(), 1.0 / weights.sum()
    assert sloping(bodies) == pytest.approx(math.sqrt(mean**2 - variance), rel=0.03)


def test_readings_within_the_biases_say_nothing_of_the_slope() -> None:
    yaw = np.full(3000, 1.0)
    assert sloping([leaning(yaw, np.full(3000, 0.015), 0.02, 60.0)]) == 0.0
    assert sloping([]) == 0.0


def test_a_slope_that_changes_sides_with_the_heading_is_told_from_a_bias() -> None:
    yaw = np.concatenate([np.zeros(1500), np.full(1500, math.pi)])
    slope = np.where(yaw == 0.0, 0.05, -0.05)
    there_and_back = sloping([leaning(yaw, slope + 0.02, 0.02, 60.0)])
    assert there_and_back == pytest.approx(0.05, rel=0.02)
    assert sloping([leaning(yaw, np.full(3000, 0.05), 0.02, 60.0)]) < 0.005


@pytest.mark.parametrize("slope", [-0.05, 0.03])
def test_the_track_on_a_cross_slope_is_right_within_its_stated_doubt(slope: float) -> None:
    ratios, sizes = [], []
    for seed in (3, 4, 5):
        of = make(across(changed(SHORT, place__heading_deg=40.0 * seed), slope), seed)
        error, sd = errors(fuse(of.log), of)["lateral1"]
        ratios.append(rms(error / sd))
        sizes.append(rms(error))
    assert max(ratios) < 2.0
    assert rms(np.array(sizes)) < 0.035


def test_a_creeping_machine_has_its_heading_from_its_course() -> None:
    of = make(changed(preset("benign"), path__speed=0.7, path__duration=80.0, place__heading_deg=115.0), 3)
    found = {name: rms(error) for name, (error, _) in errors(fuse(of.log), of).items()}
    assert found["yaw1"] < 0.15 * DEG
    assert found["lateral1"] < 0.04


@pytest.mark.parametrize("heading", [179.6, 180.0, -179.8])
def test_both_bodies_of_a_pass_due_west_start_on_the_same_turn(heading: float) -> None:
    for seed in (1, 2):
        of = make(changed(preset("benign"), path__duration=20.0, place__heading_deg=heading), seed)
        known = prepare(of.log, wheel_motions(of.log))
        assert np.abs(known.yaw[0] - known.yaw[1]).max() < 0.3
