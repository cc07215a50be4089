"""The twin's physics against what mechanics says, with derivatives and integrals taken independently."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from smts_validate.model.inputs import ackermann_angles
from smts_validate.pipeline import twin, twin_ground, twin_inertial, twin_path, twin_rigid
from smts_validate.pipeline.twin_plan import TwinPlan, changed, preset

G = 9.80665
SHORT = changed(preset("benign"), {"path": {"duration": 30.0}})


@pytest.fixture(scope="module")
def world() -> twin.World:
    return twin.make_world(SHORT, 3)


def _instants(world: twin.World) -> np.ndarray:
    return np.linspace(0.5, world.duration - 0.5, 1500)


def _rate_of(axes_before: np.ndarray, axes: np.ndarray, axes_after: np.ndarray, h: float) -> np.ndarray:
    """Angular velocity in the frame's own axes from rotation matrices: the skew part of Rᵀ·dR/dt."""
    skew = np.einsum("nji,njk->nik", axes, (axes_after - axes_before) / (2.0 * h))
    return np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], axis=1)


def test_a_unit_at_rest_feels_gravity_whatever_its_tilt(world: twin.World) -> None:
    t = np.linspace(0.1, 4.5, 200)
    for body in world.bodies.values():
        force = body.feel(t).at((0.7, -1.1, 0.4)).force
        assert np.linalg.norm(force, axis=1) == pytest.approx(G, abs=1e-9)


def test_specific_force_on_a_body_is_the_second_difference_of_its_position_less_gravity(
    world: twin.World,
) -> None:
    t, h, arm = _instants(world), 1e-3, np.array([0.4, -0.9, 1.3])
    for body in world.bodies.values():
        before, here, after = (body.point(t + k * h, arm) for k in (-1, 0, 1))
        pull = (after - 2.0 * here + before) / h**2 + np.array([0.0, 0.0, G])
        felt = body.feel(t).at(arm)
        assert np.abs(np.einsum("nij,nj->ni", body.axes(t), felt.force) - pull).max() < 5e-3
        rate = _rate_of(body.axes(t - h), body.axes(t), body.axes(t + h), h)
        assert np.abs(felt.rate - rate).max() < 2e-4


@pytest.mark.parametrize("wheel", ["front_left", "front_right", "rear_left", "rear_right"])
def test_a_wheel_unit_feels_the_second_difference_of_its_own_place(world: twin.World, wheel: str) -> None:
    t, h, offset = _instants(world), 1e-3, np.array([-0.08, 0.03, 0.04])
    body, path = world.bodies["tractor"], world.wheels[wheel]

    def pose(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        delta, phase = path.steer(at), path.phase(at)
        c, s, cp, sp, zero, one = (
            np.cos(delta), np.sin(delta), np.cos(phase), np.sin(phase), np.zeros_like(at), np.ones_like(at)
        )  # fmt: skip
        steered = np.moveaxis(np.array([[c, -s, zero], [s, c, zero], [zero, zero, one]]), 2, 0)
        rolled = np.moveaxis(np.array([[cp, zero, sp], [zero, one, zero], [-sp, zero, cp]]), 2, 0)
        axes = body.axes(at) @ steered @ rolled
        return body.point(at, path.hub) + axes @ offset, axes

    (before, axes_before), (here, axes), (after, axes_after) = (pose(t + k * h) for k in (-1, 0, 1))
    pull = (after - 2.0 * here + before) / h**2 + np.array([0.0, 0.0, G])
    felt = path.feel(body, t).at(offset)
    assert np.abs(np.einsum("nij,nj->ni", axes, felt.force) - pull).max() < 2e-2  # of 15 m/s²
    assert np.abs(felt.rate - _rate_of(axes_before, axes, axes_after, h)).max() < 2e-3  # of 5 rad/s


def test_yaw_is_the_integral_of_what_the_gyros_see_with_tilt_undone(world: twin.World) -> None:
    t = np.linspace(0.1, world.duration - 0.1, 30000)
    for body in world.bodies.values():
        rate = body.feel(t).rate
        roll, pitch, yaw = body.place(t)[:, 3:].T
        turning = (np.sin(roll) * rate[:, 1] + np.cos(roll) * rate[:, 2]) / np.cos(pitch)
        turned = np.concatenate([[0.0], np.cumsum(0.5 * (turning[1:] + turning[:-1]) * np.diff(t))])
        assert np.abs(turned - (yaw - yaw[0])).max() < 1e-5


def test_spin_times_radius_less_slip_is_the_speed_over_ground_of_the_hub(world: twin.World) -> None:
    motion = world.motion
    t = motion.t[2000:-200]
    for wheel, path in world.wheels.items():
        hub = path.hub
        x = motion.x1 + hub[0] * np.cos(motion.yaw1) - hub[1] * np.sin(motion.yaw1)
        y = motion.y1 + hub[0] * np.sin(motion.yaw1) + hub[1] * np.cos(motion.yaw1)
        heading = motion.yaw1 + path.steer(motion.t)
        along = np.gradient(x, motion.t) * np.cos(heading) + np.gradient(y, motion.t) * np.sin(heading)
        rolled = path.phase(t, 1) * path.radius * (1.0 - path.slip[2000:-200])
        assert np.abs(rolled - along[2000:-200]).max() < 2e-3, wheel


def test_wheels_stand_still_at_rest_and_roll_forward_positively(world: twin.World) -> None:
    for path in world.wheels.values():
        assert np.ptp(path.phase(np.linspace(0.0, 4.5, 100))) < 1e-3
        assert float(path.phase(29.0, 1)) > 2.5


def test_front_wheels_keep_ackermanns_geometry_and_their_mean() -> None:
    mean = np.radians(np.linspace(-35.0, 35.0, 71))
    tractor = preset("benign").machine["tractor"]
    left, right = (twin_rigid.wheel_angle(tractor, w, mean) for w in ("front_left", "front_right"))
    assert 0.5 * (left + right) == pytest.approx(mean, abs=1e-12)
    wheelbase = tractor["front_axle"] + tractor["rear_axle"]
    closed_left, closed_right = ackermann_angles(mean, tractor["front_track"], wheelbase)
    assert left == pytest.approx(closed_left, abs=1e-9)
    assert right == pytest.approx(closed_right, abs=1e-9)


def test_the_hitch_joins_the_bodies(world: twin.World) -> None:
    motion, machine = world.motion, SHORT.machine
    l4, l5 = machine["tractor"]["hitch"], machine["seeder"]["hitch_to_com"]
    for first, second, angle in ((motion.x1, motion.x2, np.cos), (motion.y1, motion.y2, np.sin)):
        assert first - l4 * angle(motion.yaw1) == pytest.approx(second + l5 * angle(motion.yaw2), abs=1e-9)


def test_a_roll_centre_under_the_centre_of_mass_makes_it_sway_with_the_roll() -> None:
    plan = replace(SHORT, errors=replace(SHORT.errors, roll_centre_tractor=0.2))
    swaying, still = twin.make_world(plan, 3), twin.make_world(SHORT, 3)
    t = np.linspace(12.0, 29.0, 900)
    moved = swaying.bodies["tractor"].place(t) - still.bodies["tractor"].place(t)
    roll, pitch, yaw = swaying.bodies["tractor"].place(t)[:, 3:].T
    left = -np.sin(yaw) * moved[:, 0] + np.cos(yaw) * moved[:, 1]
    along = np.cos(yaw) * moved[:, 0] + np.sin(yaw) * moved[:, 1]
    assert left == pytest.approx(-0.8 * np.sin(roll), abs=1e-6)
    assert along == pytest.approx(0.8 * np.sin(pitch) * np.cos(roll), abs=1e-6)


def test_a_crabbing_machine_holds_its_angle_to_its_course() -> None:
    forces = ("side_force_tractor", "side_force_seeder", "yaw_moment_tractor", "yaw_moment_seeder")
    soil = {**dict.fromkeys(forces, 0.0), "crab_tractor_deg": 0.5, "crab_seeder_deg": -0.4}
    steady = {"driver": {"noise_deg": 0.0, "speed_sd": 0.0}, "path": {"duration": 60.0}}
    plan = changed(SHORT, {"soil": soil, **steady})
    motion = twin.make_world(plan, 0).motion
    late = motion.t > 45.0
    for body, crab in ((1, 0.5), (2, -0.4)):
        x, y, yaw = (getattr(motion, f"{name}{body}") for name in ("x", "y", "yaw"))
        course = np.arctan2(np.gradient(y), np.gradient(x))
        assert np.degrees((course - yaw)[late].mean()) == pytest.approx(crab, rel=0.2)  # the pull is skew too


def test_a_headland_turn_turns_by_half_a_circle_and_comes_to_rest() -> None:
    world = twin.make_world(preset("headland"), 1)
    motion = world.motion
    assert motion.yaw1[-1] - motion.yaw1[0] == pytest.approx(math.pi, abs=math.radians(2.0))
    assert motion.yaw2[-1] - motion.yaw2[0] == pytest.approx(math.pi, abs=math.radians(2.0))
    assert world.speed[motion.t > world.duration - 1.0].max() < 0.01
    assert motion.steer.max() > math.radians(10.0)


def test_a_plane_slope_tilts_the_machine_by_its_grade_along_and_across() -> None:
    soil = {"roughness": 1e-12, "slope_east": 0.05, "slope_north": -0.03}
    plan = changed(SHORT, {"soil": soil, "place": {"heading_deg": 0.0}})
    body = twin.make_world(plan, 0).bodies["tractor"]
    _, _, up, roll, pitch, _ = body.place(np.array([1.0]))[0]
    assert pitch == pytest.approx(-math.atan(0.05), abs=1e-3)  # nose up
    assert roll == pytest.approx(math.atan(-0.03), abs=1e-3)  # left side down
    east, north = body.place(np.array([25.0]))[0, :2]
    start = body.place(np.array([1.0]))[0]
    rise = body.place(np.array([25.0]))[0, 2] - up
    assert rise == pytest.approx(0.05 * (east - start[0]) - 0.03 * (north - start[1]), abs=5e-3)


def test_the_truth_of_a_wrong_machine_differs_and_its_manifest_does_not() -> None:
    plan = preset("wrong_machine")
    true = twin.true_machine(plan)
    assert true["seeder"]["hitch_to_com"] == pytest.approx(1.4 * plan.machine["seeder"]["hitch_to_com"])
    assert true["tyres"]["front"]["cornering_stiffness"] == pytest.approx(0.35 * 6.0e4)
    assert twin.manifest_text(plan) == twin.manifest_text(replace(plan, truth={}))
    relaxed = twin.true_machine(replace(plan, truth={}, truth_set={"tyres.front.relaxation_length": 0.6}))
    assert relaxed["tyres"]["front"]["relaxation_length"] == 0.6
    assert plan.machine["tyres"]["front"]["relaxation_length"] == 0.0
    motion = twin.make_world(plan, 0).motion
    reach = np.hypot(motion.x1 - motion.x2, motion.y1 - motion.y2)
    assert reach[0] == pytest.approx(2.05 + 4.2, abs=1e-6)


def test_a_wheel_track_has_the_spectral_density_of_its_class() -> None:
    rng, roughness, spacing = np.random.default_rng(5), 1024e-6, twin_ground.SPACING
    heights = np.array([twin_ground.profile(8192, roughness, rng) for _ in range(60)])
    spectrum = 2.0 * spacing / 8192 * np.abs(np.fft.rfft(heights * np.hanning(8192), axis=1)) ** 2 / 0.375
    n = np.fft.rfftfreq(8192, spacing)
    for low, high in ((0.08, 0.125), (0.2, 0.3), (0.4, 0.6)):  # cycles/m, longer than the contact patch
        band = (n > low) & (n < high)
        patch = np.sinc(n[band] * twin_ground.PATCH) ** 4
        knee = n[band] ** 2 / (n[band] ** 2 + 1.0 / twin_ground.LONGEST**2)
        expected = roughness * (n[band] / 0.1) ** -2 * patch * knee
        assert spectrum[:, band].mean() == pytest.approx(expected.mean(), rel=0.1)


@pytest.mark.parametrize("make", [twin_path.wander, twin_path.smooth_wander])
def test_wandering_has_unit_variance_and_the_planned_correlation_time(
    make: Callable[..., np.ndarray],
) -> None:
    series = make(2_000_000, 0.01, 0.5, np.random.default_rng(7))
    assert series.std() == pytest.approx(1.0, abs=0.02)
    lag = 50  # one correlation time: e^-1 for one pole; (1 + 1)·e^-1 for two equal poles
    expected = math.exp(-1.0) * (1.0 if make is twin_path.wander else 2.0)
    assert np.mean(series[lag:] * series[:-lag]) == pytest.approx(expected, abs=0.03)


def test_the_earths_field_dips_down_in_the_north_and_up_in_the_south() -> None:
    east, north, up = twin_inertial.earth_field(50.0)
    assert (east, up < 0.0, north > 0.0) == (0.0, True, True)
    assert 45e-6 < np.linalg.norm(twin_inertial.earth_field(50.0)) < 60e-6
    assert twin_inertial.earth_field(-35.0)[2] > 0.0


def test_a_converter_saturates_and_counts_in_whole_steps() -> None:
    reach = math.radians(250.0)
    out = twin_inertial.converted(np.array([-9.0, 0.1, 0.1 + 1e-6, 9.0]), reach)
    step = reach / 32768
    assert out[0] == pytest.approx(-reach)
    assert out[3] == pytest.approx(reach - step)
    assert out[1] == out[2]
    assert abs(out[1] - 0.1) <= 0.5 * step


def test_rolling_without_the_models_equations_is_a_truth_of_its_own() -> None:
    plan = replace(SHORT, dynamics="kinematic")
    world = twin.make_world(plan, 3)
    motion = world.motion
    late = motion.t > 12.0
    wheelbase = 1.45 + 1.15
    rate = np.gradient(motion.yaw1, motion.t)
    slip = rate * wheelbase / np.maximum(world.speed, 0.1) - np.tan(motion.steer)
    assert np.abs(slip[late]).max() < 0.06  # a side slip of a few degrees explains all of the turning
    assert isinstance(plan, TwinPlan)
