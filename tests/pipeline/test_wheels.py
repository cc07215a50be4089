"""Wheel-mounted units: phase, spin, the wheel's yaw rate, and the steering angle from them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from smts_validate.pipeline.wheel_steer import mean_angle
from smts_validate.pipeline.wheel_unit import GYRO_SCALES, trusted
from smts_validate.pipeline.wheels import (
    WheelMotion,
    choose_steer_input,
    nominal_radius,
    steer_from_sensor,
    steer_from_wheels,
    wheel_motion,
)
from smts_validate.sensors.streams import (
    FieldLog,
    GnssStream,
    ImuStream,
    SteerStream,
    StreamError,
    WheelStream,
)
from wheel_samples import (
    FINE,
    RADIUS,
    RATE,
    START,
    Drive,
    Flaws,
    Floats,
    Scene,
    body_rate,
    integral,
    scene,
    thinned,
    unit,
    weaving,
)

DEG = np.pi / 180.0


def motions(given: Scene, names: tuple[str, ...] = ("wds1", "wds2", "wds3")) -> dict[str, WheelMotion]:
    sensors = given.manifest.of_kind("wds")
    return {
        name: wheel_motion(
            given.streams[name],
            sensors[name],
            nominal_radius(given.manifest.machine, sensors[name]),
            given.carrier,
        )
        for name in names
    }


def grid_of(given: Scene) -> Floats:
    return np.arange(START + 0.5, START + given.drive.t[-1] - 0.5, 0.02)


def true_steer(given: Scene, grid: Floats) -> Floats:
    return np.interp(grid, START + given.drive.t, given.drive.steer)


def steering(given: Scene, wheels: dict[str, WheelMotion]) -> tuple[Floats, Floats]:
    """Estimated and true angle on a grid."""
    grid = grid_of(given)
    found = steer_from_wheels(wheels, given.carrier.t, given.carrier.angular_velocity[:, 2], grid)
    assert found is not None
    return found.angle, true_steer(given, grid)


def windowed(error: Floats) -> float:
    """Standard deviation of an error within windows of 10 s, each about its own mean."""
    size = 10 * 50
    count = max(error.size // size, 1)
    return float(np.sqrt(np.mean([np.var(part) for part in np.array_split(error, count)])))


@pytest.fixture(scope="module")
def perfect() -> tuple[Scene, dict[str, WheelMotion]]:
    given = scene(weaving())
    return given, motions(given)


@pytest.fixture(scope="module")
def rough() -> tuple[Scene, dict[str, WheelMotion]]:
    given = scene(weaving(), seed=3, level=3.0)
    return given, motions(given)


@pytest.mark.parametrize("name", ["wds1", "wds2", "wds3"])
def test_phase_of_a_flawless_unit_is_the_wheels_phase_against_gravity(perfect, name):
    given, wheels = perfect
    every = slice(None, None, FINE // RATE)
    # Pitch turns the wheel against gravity too: to first order it adds to the phase against the body.
    error = wheels[name].phase - given.truths[name].phase - given.drive.pitch[every]
    error -= 2.0 * np.pi * np.round(np.median(error) / (2.0 * np.pi))
    assert np.abs(error).max() < 0.1 * DEG


@pytest.mark.parametrize("name", ["wds1", "wds2", "wds3"])
def test_spin_of_a_flawless_unit_is_the_hubs_speed_over_the_radius_despite_pitching(perfect, name):
    given, wheels = perfect
    assert np.std(body_rate(given.drive)[:, 1]) > 0.05
    assert np.abs(wheels[name].spin - given.truths[name].spin).max() < 0.01


@pytest.mark.parametrize("name", ["wds1", "wds2", "wds3"])
def test_yaw_rate_of_a_flawless_unit_is_the_wheels_own(perfect, name):
    given, wheels = perfect
    assert np.std(given.truths[name].yaw_rate) > 0.7 * DEG
    assert np.abs(wheels[name].yaw_rate - given.truths[name].yaw_rate).max() < 0.15 * DEG


def test_steering_of_flawless_units_is_followed_to_a_hundredth_of_a_degree(perfect):
    angle, truth = steering(*perfect)
    assert np.std(truth) > 0.5 * DEG
    assert np.std(angle - truth) < 0.01 * DEG


def test_bad_units_reach_the_figures_that_the_design_asks_for(rough):
    given, wheels = rough
    every = slice(None, None, FINE // RATE)
    for name, wheel in wheels.items():
        moving = ~wheel.rest
        phase = (wheel.phase - given.truths[name].phase - given.drive.pitch[every])[moving]
        assert np.std(phase) < 0.3 * DEG
        speed = (wheel.spin - given.truths[name].spin)[moving] * RADIUS[wheel.wheel.split("_")[0]]
        assert np.sqrt(np.mean(speed**2)) < 0.005
        assert np.std((wheel.yaw_rate - given.truths[name].yaw_rate)[moving]) < 0.36 * DEG
    angle, truth = steering(given, wheels)
    assert windowed(angle - truth) < 0.1 * DEG


def test_tilt_of_the_unit_against_the_axle_is_found():
    given = scene(weaving())
    sensor = given.manifest.of_kind("wds")["wds1"]
    tilt_deg = (0.7, 0.0, -0.4)
    stream, _ = unit(given.drive, sensor, Flaws(tilt_deg=tilt_deg))
    axle = Rotation.from_euler("ZYX", tilt_deg[::-1], degrees=True).inv().apply([0.0, 1.0, 0.0])
    found = wheel_motion(stream, sensor, 0.62, given.carrier).calibration
    assert found["tilt_x"][0] == pytest.approx(axle[0], abs=2e-4)
    assert found["tilt_z"][0] == pytest.approx(axle[2], abs=2e-4)


def test_a_unit_that_sits_elsewhere_than_stated_is_found_out_and_phase_stays_true():
    given = scene(weaving(60.0))
    sensor = given.manifest.of_kind("wds")["wds1"]
    displaced = (0.02, 0.0, -0.015)
    stream, truth = unit(given.drive, sensor, Flaws(displaced=displaced))
    moved = wheel_motion(stream, sensor, 0.62, given.carrier)
    exact = wheel_motion(given.streams["wds1"], sensor, 0.62, given.carrier)
    for axis, wrong in zip("xz", (displaced[0], displaced[2]), strict=True):
        assert exact.calibration[f"offset_error_{axis}"][0] == pytest.approx(0.0, abs=2e-3)
        assert moved.calibration[f"offset_error_{axis}"][0] == pytest.approx(wrong, abs=2e-3)
    error = moved.phase - truth.phase - given.drive.pitch[:: FINE // RATE]
    assert np.std(error) < 0.1 * DEG


def test_reversing_turns_the_wheel_backwards_and_keeps_the_sign_of_steering():
    forward = weaving()
    given = scene(replace(forward, speed=-forward.speed), seed=5)
    wheels = motions(given)
    assert wheels["wds3"].phase[-1] - wheels["wds3"].phase[0] == pytest.approx(
        given.truths["wds3"].phase[-1] - given.truths["wds3"].phase[0], abs=0.5 * DEG
    )
    assert np.median(wheels["wds1"].spin) < -2.0
    angle, truth = steering(given, wheels)
    assert windowed(angle - truth) < 0.1 * DEG


def test_mirroring_what_the_units_feel_mirrors_the_steering_exactly():
    given = scene(weaving(), seed=7)
    flip = np.array([-1.0, 1.0, -1.0])
    turned = {
        name: WheelStream(name, s.t, s.t_arrival, s.specific_force * [1, -1, 1], s.angular_velocity * flip)
        for name, s in given.streams.items()
    }
    body = replace(given.carrier, angular_velocity=given.carrier.angular_velocity * flip)
    angle, _ = steering(given, motions(given))
    other = replace(given, streams=turned, carrier=body)
    mirrored, _ = steering(other, motions(other))
    np.testing.assert_allclose(mirrored, -angle, atol=1e-9)


def test_the_units_clock_may_begin_anywhere():
    given = scene(weaving(), seed=8)
    later = {
        name: WheelStream(name, s.t + 4096.0, s.t_arrival + 4096.0, s.specific_force, s.angular_velocity)
        for name, s in given.streams.items()
    }
    body = replace(given.carrier, t=given.carrier.t + 4096.0)
    first, second = motions(given), motions(replace(given, streams=later, carrier=body))
    np.testing.assert_allclose(second["wds1"].yaw_rate, first["wds1"].yaw_rate, atol=1e-6)


def test_steering_without_a_rest_at_either_end_is_followed():
    drive = weaving(50.0)
    inside = slice(9 * FINE, 41 * FINE)
    cut = Drive(*(getattr(drive, name)[inside] for name in ("t", "speed", "yaw", "steer", "roll", "pitch")))
    given = scene(replace(cut, t=cut.t - cut.t[0]), seed=11)
    wheels = motions(given)
    assert not wheels["wds1"].rest.any()
    angle, truth = steering(given, wheels)
    assert windowed(angle - truth) < 0.1 * DEG


def stop_and_steer() -> Drive:
    """Drives, stands from 20 to 32 s while the front wheels are turned by 4°, drives on."""
    drive = weaving(56.0)
    t = drive.t
    stop = np.clip(np.abs(t - 26.0) - 6.0, 0.0, 3.0) / 3.0
    stop = stop * stop * (3.0 - 2.0 * stop)
    turn = np.clip((t - 24.0) / 2.0, 0.0, 1.0)
    speed, steer = (
        drive.speed * stop,
        drive.steer * stop + 4.0 * DEG * (turn * turn * (3.0 - 2.0 * turn)) * (t < 40.0),
    )
    steer = np.where(t < 36.0, steer, drive.steer * stop + 4.0 * DEG * np.clip((40.0 - t) / 4.0, 0.0, 1.0))
    yaw = 0.4 + integral(speed * np.tan(steer) / 2.55)
    return Drive(t, speed, yaw, steer, drive.roll * stop + 0.01, drive.pitch * stop)


def test_wheels_steered_at_a_standstill_keep_their_angle():
    given = scene(stop_and_steer(), seed=13)
    wheels = motions(given)
    at = wheels["wds1"].t - START
    assert wheels["wds1"].rest[(at > 22.0) & (at < 31.0)].all()
    angle, truth = steering(given, wheels)
    error = angle - truth
    assert windowed(error) < 0.1 * DEG
    assert abs(error[(33 * 50)] - error[(20 * 50)]) < 0.15 * DEG


def headland() -> Drive:
    """Two rows with a half turn between them on a side slope."""
    t = np.arange(60 * FINE) / FINE
    start = np.clip((t - 3.0) / 3.0, 0.0, 1.0)
    start = start * start * (3.0 - 2.0 * start)
    bend = np.clip((t - 24.0) / 3.0, 0.0, 1.0) * np.clip((41.6 - t) / 3.0, 0.0, 1.0)
    bend = bend * bend * (3.0 - 2.0 * bend)
    steer = start * 0.015 * np.sin(1.3 * t) + 0.3 * bend
    speed = start * (2.4 - 0.8 * bend)
    yaw = integral(speed * np.tan(steer) / 2.55)
    slope = 0.03
    swing = 0.01 * start * np.sin(7.0 * t)
    return Drive(t, speed, yaw, steer, slope * np.cos(yaw) + swing, slope * np.sin(yaw) + 0.7 * swing)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_headland_turn_on_a_slope_leaves_the_phase_true(seed):
    given = scene(headland(), seed=seed)
    assert given.drive.yaw[-1] > 2.5
    wheel = motions(given, ("wds3",))["wds3"]
    error = wheel.phase - given.truths["wds3"].phase - given.drive.pitch[:: FINE // RATE]
    # Left in, the turn about an axle that leans by 3 % moves the gyro's integral by 1.7° and the phase by
    # 0.11°.
    assert np.std(error) < 0.08 * DEG


def test_gyros_of_unlike_scale_do_not_leave_a_step_of_steering_after_a_headland_turn():
    given = scene(headland(), seed=17)
    streams = {
        name: WheelStream(name, s.t, s.t_arrival, s.specific_force, s.angular_velocity * scale)
        for (name, s), scale in zip(given.streams.items(), (1.006, 1.010, 0.994), strict=True)
    }
    angle, truth = steering(given, motions(replace(given, streams=streams)))
    error = angle - truth
    before, after = error[50 * 5 : 50 * 22], error[50 * 44 :]
    # 0.8 % of 155° between the front units and the body's gyro is 1.2°.
    assert abs(after.mean() - before.mean()) < 0.3 * DEG
    assert windowed(error) < 0.2 * DEG


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_slow_wheel_whose_biases_hide_in_steering_says_so(seed):
    given = scene(weaving(60.0, speed=0.5), seed=seed)
    grid = grid_of(given)
    found = steer_from_wheels(motions(given), given.carrier.t, given.carrier.angular_velocity[:, 2], grid)
    assert found is not None
    error = found.angle - true_steer(given, grid)
    assert np.sqrt(np.mean(((error - error.mean()) / found.sd) ** 2)) < 2.0


def test_lost_samples_and_a_gap_are_bridged_with_a_doubt_that_covers_them():
    given = scene(weaving(60.0), seed=19)
    rng = np.random.default_rng(1)
    streams = {}
    for name, stream in given.streams.items():
        keep = rng.random(stream.t.size) > 0.05
        if name == "wds1":
            keep &= np.abs(stream.t - START - 30.0) > 1.5
        streams[name] = thinned(stream, keep)
    given = replace(given, streams=streams)
    wheels = motions(given)
    grid = grid_of(given)
    found = steer_from_wheels(wheels, given.carrier.t, given.carrier.angular_velocity[:, 2], grid)
    assert found is not None
    error = found.angle - true_steer(given, grid)
    assert windowed(error) < 0.1 * DEG
    assert np.mean(np.abs(error - error.mean()) < 3.0 * found.sd) > 0.95


def test_without_any_front_unit_for_a_while_the_doubt_grows_to_cover_the_error():
    given = scene(weaving(60.0), seed=23)
    gap = np.abs(given.streams["wds1"].t - START - 30.0) < 4.0
    streams = {n: thinned(s, ~gap) if n in ("wds1", "wds2") else s for n, s in given.streams.items()}
    given = replace(given, streams=streams)
    grid = grid_of(given)
    found = steer_from_wheels(motions(given), given.carrier.t, given.carrier.angular_velocity[:, 2], grid)
    assert found is not None
    inside = (np.abs(grid - START - 30.0) < 4.0)[1:]
    jump = np.sum(np.diff(found.angle - true_steer(given, grid))[inside])
    allowed = np.sqrt(np.sum((found.rate_sd[1:][inside] * 0.02) ** 2))
    assert abs(jump) < 3.0 * allowed
    assert allowed > 3.0 * found.walk * np.sqrt(8.0)


def test_the_body_gyros_bias_is_found_against_the_rear_wheels_without_any_rest():
    drive = weaving(60.0)
    inside = slice(9 * FINE, 51 * FINE)
    cut = Drive(*(getattr(drive, name)[inside] for name in ("t", "speed", "yaw", "steer", "roll", "pitch")))
    given = scene(replace(cut, t=cut.t - cut.t[0]), seed=29)
    rate = given.carrier.angular_velocity[:, 2]
    grid = grid_of(given)
    wheels = motions(given)
    plain = steer_from_wheels(wheels, given.carrier.t, rate, grid)
    biased = steer_from_wheels(wheels, given.carrier.t, rate + 1.0 * DEG, grid)
    assert plain is not None
    assert biased is not None
    found = biased.calibration["body_gyro_bias"][0] - plain.calibration["body_gyro_bias"][0]
    assert found == pytest.approx(1.0 * DEG, rel=0.02)
    assert np.abs(biased.angle - plain.angle).max() < 0.05 * DEG


def test_one_front_wheel_alone_gives_the_mean_of_both_by_the_linkages_geometry():
    # cot δ_left = cot δ − w/(2L), cot δ_right = cot δ + w/(2L): the mean of both is what is asked for.
    half, base = 0.5 * 1.9, 1.38 + 1.17
    middle = np.array([0.25, 0.1, -0.2, -0.3])
    left, right = (np.arctan(1.0 / (1.0 / np.tan(middle) + side * half / base)) for side in (-1.0, 1.0))
    tractor = scene(weaving(8.0)).manifest.machine.tractor
    for angle, wheel in ((left, "front_left"), (right, "front_right")):
        np.testing.assert_allclose(mean_angle(angle, tractor, wheel), 0.5 * (left + right), atol=0.25 * DEG)


def test_too_few_samples_are_refused_with_the_units_name():
    given = scene(weaving(8.0))
    stream = given.streams["wds1"]
    short = thinned(stream, np.arange(stream.t.size) < 50)
    with pytest.raises(StreamError, match="wds: 50 samples are too few"):
        wheel_motion(short, given.manifest.of_kind("wds")["wds1"], 0.62)


def test_clipped_and_wild_samples_are_left_out_and_said():
    given = scene(weaving(), seed=31)
    stream = given.streams["wds1"]
    rate = stream.angular_velocity.copy()
    rate[1500:1540, 2] = np.radians(250.0)
    rate[2000, 0] = 30.0
    broken = WheelStream("wds1", stream.t, stream.t_arrival, stream.specific_force, rate)
    sensor = given.manifest.of_kind("wds")["wds1"]
    clean, hurt = (wheel_motion(s, sensor, 0.62, given.carrier) for s in (stream, broken))
    assert clean.warnings == ()
    assert "41 samples" in hurt.warnings[0].what
    assert np.abs(hurt.yaw_rate - clean.yaw_rate).max() < 3.0 * DEG
    assert np.std((hurt.turned - clean.turned)[1600:]) < 0.2 * DEG


def test_a_quiet_gyro_at_rest_is_not_taken_for_a_clipped_one():
    assert trusted(np.zeros(500), GYRO_SCALES).all()
    assert trusted(np.full(500, np.radians(100.0)), GYRO_SCALES).all()


def test_wheels_alone_without_the_bodys_rates_still_give_phase_and_yaw_rate():
    given = scene(weaving(), seed=37)
    sensor = given.manifest.of_kind("wds")["wds3"]
    wheel = wheel_motion(given.streams["wds3"], sensor, 0.8)
    every = slice(None, None, FINE // RATE)
    assert np.std(wheel.phase - given.truths["wds3"].phase - given.drive.pitch[every]) < 0.3 * DEG
    assert np.std(wheel.yaw_rate - given.truths["wds3"].yaw_rate) < 0.36 * DEG


# --- which series drives the replay


def steer_stream(drive: Drive, share: float = 1.0) -> SteerStream:
    every = slice(None, None, FINE // 50)
    t, angle = START + drive.t[every], drive.steer[every]
    use = slice(None, int(share * t.size))
    noise = 0.1 * DEG * np.random.default_rng(2).standard_normal(t.size)
    return SteerStream("steer", t[use], t[use] + 0.01, (angle + noise + 0.2 * DEG)[use])


STEER = '\n[sensors.steer]\nkind = "steer"\nfile = "steer.csv"\nrate = 50.0\n'


def gnss(given: Scene, seed: int) -> GnssStream:
    t = START + np.arange(0.0, given.drive.t[-1], 0.1)
    wild = {name: np.random.default_rng(seed).standard_normal(t.size) for name in GnssStream.ARRAYS}
    return GnssStream("gps", t, t + 0.1, **wild)


def log_of(given: Scene, steer: SteerStream | None = None, wheels: bool = True, seed: int = 0) -> FieldLog:
    t, rate = given.carrier.t, given.carrier.angular_velocity
    body = ImuStream("imd1", t, t, np.zeros_like(rate), rate)
    streams = {"imd1": body, "gps": gnss(given, seed), **(given.streams if wheels else {})}
    return FieldLog(given.manifest, "", streams | ({} if steer is None else {"steer": steer}))


def test_the_steering_sensor_is_preferred_where_it_covers_the_pass():
    given = scene(weaving(), seed=41, extra=STEER)
    grid = grid_of(given)
    whole = choose_steer_input(log_of(given, steer_stream(given.drive)), grid)
    most = choose_steer_input(log_of(given, steer_stream(given.drive, 0.7)), grid)
    only = choose_steer_input(log_of(given, steer_stream(given.drive, 0.7), wheels=False), grid)
    assert whole is not None
    assert most is not None
    assert only is not None
    assert [whole.source, most.source, only.source] == ["sensor", "wheels", "sensor"]


def test_without_sensor_and_wheels_there_is_no_series():
    given = scene(weaving(12.0))
    assert choose_steer_input(log_of(given, wheels=False), grid_of(given)) is None


def test_no_position_reaches_the_series_that_drives_the_replay():
    given = scene(weaving(), seed=43)
    grid = grid_of(given)
    first, second = (choose_steer_input(log_of(given, seed=seed), grid) for seed in (1, 2))
    assert first is not None
    assert second is not None
    np.testing.assert_array_equal(first.angle, second.angle)


def test_kinematics_of_steering_do_not_reach_the_series_that_drives_the_replay():
    # The same units on a tractor that turns by another law: the angle must follow the wheels, not the path.
    drive = weaving(60.0)
    given = scene(replace(drive, yaw=0.4 + 0.5 * (drive.yaw - 0.4)), seed=47)
    angle, truth = steering(given, motions(given))
    assert windowed(angle - truth) < 0.1 * DEG


def test_the_sensors_series_states_its_own_error():
    given = scene(weaving(60.0), extra=STEER)
    sensor = given.manifest.of_kind("steer")["steer"]
    grid = grid_of(given)
    found = steer_from_sensor(steer_stream(given.drive), sensor, grid)
    error = found.angle - true_steer(given, grid) - 0.2 * DEG
    assert np.std(error) < 0.07 * DEG
    assert 0.8 < np.sqrt(np.mean((error / found.sd) ** 2)) < 1.25
    assert found.zero_sd == pytest.approx(0.3 * DEG)
    assert found.scale_sd == pytest.approx(0.01)


def test_a_wild_reading_of_the_steering_sensor_is_left_out():
    given = scene(weaving(), extra=STEER)
    sensor = given.manifest.of_kind("steer")["steer"]
    stream, grid = steer_stream(given.drive), grid_of(given)
    angle = stream.angle.copy()
    angle[700] = 0.6
    wild = steer_from_sensor(SteerStream("steer", stream.t, stream.t_arrival, angle), sensor, grid)
    assert np.abs(wild.angle - steer_from_sensor(stream, sensor, grid).angle).max() < 0.2 * DEG
