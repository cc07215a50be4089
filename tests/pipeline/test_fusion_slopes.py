"""Slopes, creeping and headings across ±π: what unseen fields do to the first guesses and to the tilt."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from fusion_samples import changed, errors, make, rms
from scipy.signal import lfilter
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.engine_compiled import Smoothed
from smts_validate.pipeline.fusion.epochs import Epochs
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.fusion.ground import (
    STEEPEST,
    Leaning,
    ground_slope,
    leaning,
    rough_mean,
    rough_pitch,
    standstills,
    undulation,
)
from smts_validate.pipeline.fusion.known import prepare
from smts_validate.pipeline.fusion.settings import ROUGH, SLOPE
from smts_validate.pipeline.fusion.unseen import cross_slope
from smts_validate.pipeline.twin_plan import TwinPlan, preset
from smts_validate.pipeline.wheels import wheel_motions

DEG = math.pi / 180.0
SHORT = changed(preset("benign"), path__duration=40.0)


def gauss_markov(n: int, step: float, rng: np.random.Generator) -> np.ndarray:
    """A series (n,) of unit variance, correlated over 1 s."""
    keep = math.exp(-step)
    drive = math.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    drive[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -keep], drive))


def across(plan: TwinPlan, slope: float) -> TwinPlan:
    """The plan on ground that rises by `slope` to the left of its row."""
    heading = math.radians(plan.place.heading_deg)
    return changed(
        plan, soil__slope_east=-math.sin(heading) * slope, soil__slope_north=math.cos(heading) * slope
    )


def read(heading: float, rolls: tuple[float, ...], biases: tuple[float, ...]) -> list[Leaning]:
    """What two bodies' accelerometers read on a straight row."""
    yaw = np.full(3000, heading)
    return [leaning(yaw, np.full(3000, r), b, 60.0) for r, b in zip(rolls, biases, strict=True)]


def told(bodies: list[Leaning]) -> tuple[np.ndarray, np.ndarray]:
    """Gradient by all readings, the tractor's too, and its covariance; what a filter makes of it."""
    slope = ground_slope(epochs(np.zeros(1), np.zeros(1), 0.0, 0.0, 1.0), bodies)
    information = np.linalg.inv(slope.covariance) + bodies[0].matrix
    vector = np.linalg.solve(slope.covariance, slope.gradient) + bodies[0].vector
    np.testing.assert_allclose(np.linalg.inv(information), slope.known, rtol=1e-6, atol=1e-12)
    return np.linalg.solve(information, vector), slope.known + slope.doubt


@pytest.mark.parametrize("heading", [0.3, 2.0, -3.0])
def test_a_cross_slope_far_beyond_the_biases_is_taken_as_read(heading: float) -> None:
    gradient, covariance = told(read(heading, (0.080, 0.088), (0.02, 0.015)))
    left = np.array([-math.sin(heading), math.cos(heading)])
    lean = 0.02**2 * 2.0 / 60.0  # rough ground, mean over 60 s
    weights = np.array([1.0 / (0.02**2 + lean), 1.0 / (0.015**2 + lean)])
    variance = 1.0 / weights.sum()
    assert left @ gradient == pytest.approx(weights @ [0.080, 0.088] * variance, rel=0.1)
    assert left @ covariance @ left == pytest.approx(variance, rel=0.4)


def test_readings_within_the_biases_leave_a_field_as_level_as_fields_are() -> None:
    gradient, covariance = told(read(1.0, (0.015, 0.010), (0.02, 0.015)))
    assert np.hypot(*gradient) < 0.005
    assert (
        math.sqrt(np.array([-math.sin(1.0), math.cos(1.0)]) @ covariance @ [-math.sin(1.0), math.cos(1.0)])
        < 0.015
    )


def test_a_slope_that_changes_sides_with_the_heading_is_told_from_a_bias() -> None:
    yaw = np.concatenate([np.zeros(1500), np.full(1500, math.pi)])
    both = leaning(yaw, np.where(yaw == 0.0, 0.05, -0.05) + 0.02, 0.02, 60.0)
    assert told([both])[0][1] == pytest.approx(0.05, rel=0.03)
    assert abs(told([leaning(yaw, np.full(3000, 0.05), 0.02, 60.0)])[0][1]) < 0.002


def test_slopes_drawn_as_steep_as_fields_are_lie_within_their_stated_doubt() -> None:
    """Simulation-based calibration: steepness, slope, biases and rough ground from their priors."""
    rng = np.random.default_rng(8)
    biases, normalised = (0.02, 0.0145), []
    for _ in range(3000):
        steep = SLOPE * math.tan(rng.uniform() * math.atan(STEEPEST / SLOPE))
        slope = steep * rng.standard_normal()
        rolls = tuple(
            slope + b * rng.standard_normal() + math.sqrt(rough_mean(60.0)) * rng.standard_normal()
            for b in biases
        )
        gradient, covariance = told(read(0.0, rolls, biases))
        normalised.append((gradient[1] - slope) / math.sqrt(covariance[1, 1]))
    assert 0.93 < np.mean(np.abs(normalised) < 1.96) < 0.975
    assert 0.85 < np.mean(np.square(normalised)) < 1.15


def test_pitch_on_rough_ground_is_as_level_as_the_track_from_end_to_end() -> None:
    rng = np.random.default_rng(2)
    means, rolls = [], []
    for _ in range(400):
        # a track whose slope has the deviation ROUGH and 1 s of correlation: heights are stationary, 60 s are driven
        height = ROUGH * gauss_markov(3001, 0.02, rng)
        means.append((height[-1] - height[0]) / 60.0)
        rolls.append(np.mean(ROUGH * gauss_markov(3001, 0.02, rng)))
    assert np.std(means) == pytest.approx(math.sqrt(rough_pitch(60.0, np.zeros(0))), rel=0.15)
    assert np.std(rolls) == pytest.approx(math.sqrt(rough_mean(60.0)), rel=0.15)
    assert rough_pitch(60.0, np.array([60.0])) == pytest.approx(ROUGH**2)


def test_a_way_that_stands_is_rest() -> None:
    way = np.concatenate([np.zeros(250), np.linspace(0.01, 50.0, 1000), np.full(100, 50.0)])
    assert standstills(way, 0.02) == pytest.approx([5.0, 2.0], abs=0.03)


def test_altitudes_of_a_float_solution_are_no_slope() -> None:
    t = np.arange(0.0, 60.0, 0.02)
    fixed = epochs(t, 2.5 * t, 0.8, 0.01, 0.011)
    fixed = replace(fixed, z=0.01 * 2.5 * fixed.t)
    loose = fixed.t > 45.0
    worse = replace(fixed, z=fixed.z + 0.4 * loose, sd=np.where(loose, 0.2, 0.011), fixed=~loose)
    plain, mixed = ground_slope(fixed), ground_slope(worse)
    np.testing.assert_allclose(mixed.gradient, plain.gradient, atol=0.001)
    left = np.array([-math.sin(0.8), math.cos(0.8)])
    assert left @ mixed.covariance @ left < 1.3 * (left @ plain.covariance @ left)


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


def test_a_machine_that_crabs_on_a_slope_says_that_its_yaw_is_in_doubt() -> None:
    plan = across(changed(SHORT, soil__weight_pulls=True), 0.05)
    of = make(plan, 3)
    found = errors(fuse(of.log), of)
    for name in ("yaw1", "yaw2"):
        error, sd = found[name]
        assert rms(error) > 0.3 * DEG  # tyres hold the weight's part along the ground by slip angles
        assert rms(error / sd) < 2.0
    flat = make(across(SHORT, 0.0), 3)
    level = errors(fuse(flat.log), flat)
    assert np.median(level["yaw1"][1]) < 0.25 * np.median(found["yaw1"][1])


def hilly(way: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Height and slope of hills 80 m long and 2 degrees steep on a plane that rises by 1 %, m."""
    k, height = 2.0 * math.pi / 80.0, 0.035 / (2.0 * math.pi / 80.0)
    return 0.01 * way + height * np.sin(k * way), 0.01 + 0.035 * np.cos(k * way)


def epochs(t: np.ndarray, way: np.ndarray, heading: float, noise: float, sd: float) -> Epochs:
    """Positions each 0.1 s along a line, with the hills' heights."""
    rng = np.random.default_rng(1)
    some = slice(None, None, 5)
    n = t[some].size
    z = hilly(way[some])[0] + noise * rng.standard_normal(n)
    x, y = way[some] * math.cos(heading), way[some] * math.sin(heading)
    unknown = np.full(n, np.nan)
    return Epochs(
        "gps", "tractor", True, t[some], x, y, z, np.full(n, sd), np.ones(n, dtype=bool),
        unknown, unknown, unknown, True,
    )  # fmt: skip


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_hills_along_the_path_are_seen_by_altitudes_forwards_and_backwards(direction: float) -> None:
    t = np.arange(0.0, 80.0, 0.02)
    way = direction * np.cumsum(np.where((t > 10.0) & (t < 70.0), 2.5, 0.0)) * 0.02
    heading = np.full(t.size, 0.8)
    plane = 0.01 * np.array([math.cos(0.8), math.sin(0.8)])
    seen = undulation(epochs(t, way, 0.8, 0.02, 0.015), plane, way, t, heading)
    inside = (t > 14.0) & (t < 66.0)  # the first and the last 10 m of way have less of a window
    truth = hilly(way)[1] - 0.01
    assert rms(seen[inside] - truth[inside]) < 0.25 * rms(truth[inside])
    far = undulation(epochs(t, way, 0.8, 1.5, 1.5), plane, way, t, heading)
    assert rms(far) < 0.1 * rms(truth[inside])  # a metre-level receiver sees no hills, and says none


def test_a_turn_on_a_plane_turns_the_slope_across_the_path_over() -> None:
    n = 3000
    yaw = np.concatenate([np.zeros(1400), np.linspace(0.0, math.pi, 200), np.full(1400, math.pi)])
    x = np.zeros((n, s.SIZE))
    x[:, s.YAW1] = yaw
    x[:, s.ROLL], x[:, s.PITCH] = 0.05 * np.cos(yaw), -0.05 * np.sin(yaw)  # ground that rises northwards
    slope = cross_slope(Smoothed(x, np.zeros((n, len(s.KEPT), len(s.KEPT)))))
    assert slope == pytest.approx(slope[0] * np.cos(yaw), rel=1e-2, abs=1e-4)
    assert slope[0] == pytest.approx(0.05, rel=0.05)
