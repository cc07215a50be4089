"""Whole passes through the fusion: accuracy against simulated truth, symmetries, faults, odd circumstances."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fusion_samples import Sample, changed, errors, make, plan_of, rms, sample
from smts_validate.pipeline.fusion.assemble import with_honest_zero
from smts_validate.pipeline.fusion.epochs import Epochs
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.fusion.ground import ground_slope
from smts_validate.pipeline.fusion.known import FusionError, prepare
from smts_validate.pipeline.fusion.motion import Motion, SteerInput
from smts_validate.pipeline.fusion.settings import FusionSettings
from smts_validate.pipeline.twin_plan import preset
from smts_validate.pipeline.wheels import wheel_motions
from smts_validate.sensors.geodesy import to_enu, to_geodetic
from smts_validate.sensors.manifest import parse
from smts_validate.sensors.mounting import to_body
from smts_validate.sensors.streams import FieldLog, GnssStream, ImuStream, Stream

DEG = np.pi / 180.0
SHORT = changed(preset("benign"), path__duration=40.0)


@pytest.fixture(scope="module")
def short() -> tuple[Sample, Motion]:
    """A plain pass of 40 s and its motion."""
    of = make(SHORT, 7)
    return of, fuse(of.log)


def test_a_plain_pass_is_followed_to_centimetres_and_hundredths_of_a_degree(
    short: tuple[Sample, Motion],
) -> None:
    of, motion = short
    e = {name: rms(error) for name, (error, _) in errors(motion, of).items()}
    # the figures to reach for benign RTK, with room for one pass's slow GNSS error (1 to 1.5 cm) and cross slope
    assert e["lateral1"] < 0.04
    assert e["along1"] < 0.04
    assert e["yaw1"] < 0.08 * DEG
    assert e["yaw2"] < 0.12 * DEG
    assert motion.consistent


def test_without_tilt_compensation_a_roof_antenna_ruins_the_track(short: tuple[Sample, Motion]) -> None:
    of, motion = short
    blind = fuse(of.log, FusionSettings(tilt_compensation=False))

    def scatter(m: Motion) -> float:
        return float(np.std(errors(m, of)["lateral1"][0]))

    assert scatter(blind) > 1.5 * scatter(motion)
    assert not blind.consistent


def test_stated_deviations_are_positive_finite_and_of_the_size_of_the_error(
    short: tuple[Sample, Motion],
) -> None:
    of, motion = short
    for name, (error, sd) in errors(motion, of).items():
        assert np.isfinite(sd).all(), name
        assert (sd > 0.0).all(), name
        assert rms(error / sd) < 3.0, name


def on_body_axes(log: FieldLog) -> FieldLog:
    """The same log without wheels, its inertial units mounted straight: for symmetries that turn vectors."""
    streams: dict[str, Stream] = {}
    sensors: dict[str, Any] = {}
    for name, sensor in log.manifest.sensors.items():
        stream = log.streams[name]
        if sensor.kind == "imd" and isinstance(stream, ImuStream):
            force, rate = to_body(stream, sensor)
            streams[name] = replace(stream, specific_force=force, angular_velocity=rate, magnetic_field=None)
            sensors[name] = sensor.model_copy(update={"rotation_deg": (0.0, 0.0, 0.0)})
        elif sensor.kind == "gps":
            streams[name], sensors[name] = stream, sensor
    return replace(log, streams=streams, manifest=log.manifest.model_copy(update={"sensors": sensors}))


def moved_gnss(stream: GnssStream, x: np.ndarray, y: np.ndarray, course: np.ndarray) -> GnssStream:
    """The receiver's epochs at other places of the plane at its own first position."""
    origin = Place(stream)
    _, _, up = to_enu(stream.lat, stream.lon, stream.alt, origin)
    lat, lon, alt = to_geodetic(x, y, up, origin)
    return replace(stream, lat=lat, lon=lon, alt=alt, course=course)


class Place:
    """The first position of a receiver."""

    def __init__(self, stream: GnssStream) -> None:
        self.lat, self.lon, self.alt = float(stream.lat[0]), float(stream.lon[0]), float(stream.alt[0])


def gnss_of(log: FieldLog) -> tuple[str, GnssStream]:
    """The log's receiver."""
    return next(iter(log.of_type(GnssStream).items()))  # type: ignore[return-value]


PLAIN = FusionSettings(adapt=False, draws=2)


def test_a_mirrored_pass_gives_the_mirrored_motion(short: tuple[Sample, Motion]) -> None:
    log = on_body_axes(short[0].log)
    name, gnss = gnss_of(log)
    x, y, _ = to_enu(gnss.lat, gnss.lon, gnss.alt, Place(gnss))
    streams: dict[str, Stream] = {}
    sensors: dict[str, Any] = {}
    for key, stream in log.streams.items():
        sensor = log.manifest.sensors[key]
        position = (sensor.position[0], -sensor.position[1], sensor.position[2])
        sensors[key] = sensor.model_copy(update={"position": position})
        if isinstance(stream, ImuStream):
            streams[key] = replace(
                stream,
                specific_force=stream.specific_force * [1.0, -1.0, 1.0],
                angular_velocity=stream.angular_velocity * [-1.0, 1.0, -1.0],
            )
    streams[name] = moved_gnss(gnss, x, -y, -gnss.course)
    mirrored = replace(log, streams=streams, manifest=log.manifest.model_copy(update={"sensors": sensors}))
    a, b = fuse(log, PLAIN), fuse(mirrored, PLAIN)
    for one, other in zip(a.bodies, b.bodies, strict=True):
        np.testing.assert_allclose(other.x, one.x, rtol=0, atol=2e-4)
        np.testing.assert_allclose(other.y, -one.y, rtol=0, atol=2e-4)
        np.testing.assert_allclose(other.yaw, -one.yaw, rtol=0, atol=2e-5)


def test_a_turned_field_gives_the_turned_motion(short: tuple[Sample, Motion]) -> None:
    log = on_body_axes(short[0].log)
    name, gnss = gnss_of(log)
    x, y, _ = to_enu(gnss.lat, gnss.lon, gnss.alt, Place(gnss))
    angle = 2.4  # carries the heading of this pass beyond ±π on the way back
    c, s = np.cos(angle), np.sin(angle)
    turned = replace(
        log,
        streams={**log.streams, name: moved_gnss(gnss, c * x - s * y, s * x + c * y, gnss.course + angle)},
    )
    a, b = fuse(log, PLAIN), fuse(turned, PLAIN)
    for one, other in zip(a.bodies, b.bodies, strict=True):
        np.testing.assert_allclose(other.x, c * one.x - s * one.y, rtol=0, atol=5e-4)
        np.testing.assert_allclose(other.y, s * one.x + c * one.y, rtol=0, atol=5e-4)
        difference = other.yaw - one.yaw - angle
        np.testing.assert_allclose(
            np.remainder(difference + np.pi, 2 * np.pi) - np.pi, 0.0, rtol=0, atol=5e-5
        )


def test_the_same_pass_on_another_day_gives_the_same_motion(short: tuple[Sample, Motion]) -> None:
    log = on_body_axes(short[0].log)
    later = {k: replace(v, t=v.t + 86400.0, t_arrival=v.t_arrival + 86400.0) for k, v in log.streams.items()}
    a, b = fuse(log, PLAIN), fuse(replace(log, streams=later), PLAIN)
    np.testing.assert_allclose(b.t, a.t + 86400.0, rtol=0, atol=1e-6)
    np.testing.assert_allclose(b.tractor.x, a.tractor.x, rtol=0, atol=1e-5)
    np.testing.assert_allclose(b.tractor.yaw, a.tractor.yaw, rtol=0, atol=1e-6)


def test_a_jump_of_the_receiver_for_three_seconds_is_refused(short: tuple[Sample, Motion]) -> None:
    of = make(changed(SHORT, gnss__spikes=((20.0, 3.0, 0.4),)), 7)
    motion = fuse(of.log)
    plain = errors(short[1], short[0])["lateral1"][0]
    hurt = errors(motion, of)["lateral1"][0]
    assert sum(c.rejected for c in motion.consistency if c.channel.startswith("gnss position")) > 20
    assert np.abs(hurt).max() < np.abs(plain).max() + 0.03


def test_an_outage_is_bridged_with_growing_doubt() -> None:
    of = sample("outage", 3)
    motion = fuse(of.log)
    lateral, sd = errors(motion, of)["lateral1"]
    assert rms(lateral) < 0.06
    assert rms(lateral / sd) < 2.5
    during = (motion.t > of.truth[0, 0] + 28.0) & (motion.t < of.truth[0, 0] + 31.0)
    doubt = motion.tractor.sd(0)
    assert doubt[during].max() > 1.2 * np.median(doubt)
    assert any("without a position" in w.what for w in motion.warnings)


def test_a_metre_level_receiver_says_that_it_knows_metres() -> None:
    of = sample("metre_gps", 1)
    motion = fuse(of.log)
    lateral, sd = errors(motion, of)["lateral1"]
    assert np.median(sd) > 0.3
    assert rms(lateral / sd) < 2.5
    assert rms(errors(motion, of)["yaw1"][0]) < 1.5 * DEG


def test_a_metre_level_receivers_rest_is_seen_with_and_without_wheels() -> None:
    of = sample("metre_gps", 1)  # it stands for 5 s, while its positions wander by 0.1 to 0.5 m/s
    for log in (of.log, on_body_axes(of.log)):
        known = prepare(log, wheel_motions(log))
        standing = of.truth[0, 0] + 4.5
        assert known.bias is not None
        assert known.still[known.t < standing].mean() > 0.8
        assert not known.still[known.t > standing + 1.5].any()


@pytest.mark.slow
def test_a_headland_turn_keeps_both_yaws() -> None:
    of = sample("headland", 2)
    e = errors(fuse(of.log), of)
    assert rms(e["yaw1"][0]) < 0.15 * DEG
    assert rms(e["yaw2"][0]) < 0.20 * DEG


def test_a_pass_that_starts_in_motion_is_fused(short: tuple[Sample, Motion]) -> None:
    of = short[0]
    begin = of.truth[0, 0] + 15.0
    late = {k: tail(v, begin) for k, v in of.log.streams.items()}
    motion = fuse(replace(of.log, streams=late))
    e = errors(motion, replace(of, truth=of.truth[of.truth[:, 0] > begin]))
    assert rms(e["lateral1"][0]) < 0.05
    assert rms(e["yaw1"][0]) < 0.15 * DEG
    assert any("no rest" in w.what for w in motion.warnings)


def tail(stream: Stream, begin: float) -> Stream:
    """A stream from an instant on."""
    keep = stream.t >= begin
    changes = {
        name: value[keep]
        for name, value in vars(stream).items()
        if isinstance(value, np.ndarray) and value.shape[0] == keep.size
    }
    return replace(stream, **changes)


def test_the_southern_hemisphere_is_like_the_northern() -> None:
    of = make(changed(SHORT, place__lat=-33.9, place__lon=-60.6, place__heading_deg=178.0), 7)
    e = errors(fuse(of.log), of)
    assert rms(e["lateral1"][0]) < 0.04
    assert rms(e["yaw1"][0]) < 0.08 * DEG


def test_a_tractor_alone_has_one_body(short: tuple[Sample, Motion]) -> None:
    log = short[0].log
    text = "\n".join(
        drop_tables(
            log.manifest_text, ("machine.seeder", "machine.tyres.seeder", "sensors.imd2", "sensors.imd3")
        )
    )
    manifest = parse(text)
    alone = replace(log, manifest=manifest, streams={k: log.streams[k] for k in manifest.sensors})
    motion = fuse(alone)
    assert motion.seeder is None
    assert motion.draws.shape[2] == 3
    assert rms(errors(motion, short[0])["yaw1"][0]) < 0.08 * DEG


def drop_tables(text: str, names: tuple[str, ...]) -> list[str]:
    """Lines of a TOML text without some tables."""
    kept, keep = [], True
    for line in text.splitlines():
        if line.startswith("["):
            keep = line.strip().strip("[]") not in names
        if keep:
            kept.append(line)
    return kept


def test_without_wheels_the_steering_follows_from_the_path_and_may_not_drive_the_replay(
    short: tuple[Sample, Motion],
) -> None:
    log = on_body_axes(short[0].log)
    motion = fuse(log)
    assert motion.steer_input is None
    error, sd = errors(motion, short[0])["steer"]
    assert rms(error) < 0.6 * DEG
    assert rms(error / sd) < 2.0


def test_a_log_without_positions_is_refused_in_one_line(short: tuple[Sample, Motion]) -> None:
    log = short[0].log
    name, gnss = gnss_of(log)
    nothing = replace(gnss, lat=np.full(gnss.t.size, np.nan), lon=np.full(gnss.t.size, np.nan))
    with pytest.raises(FusionError, match="no position") as caught:
        fuse(replace(log, streams={**log.streams, name: nothing}))
    assert "\n" not in str(caught.value)


def test_a_filter_whose_noise_is_misstated_says_so(short: tuple[Sample, Motion]) -> None:
    log = short[0].log
    name, gnss = gnss_of(log)
    rng = np.random.default_rng(0)
    x, y, _ = to_enu(gnss.lat, gnss.lon, gnss.alt, Place(gnss))
    rough = moved_gnss(
        gnss, x + rng.normal(size=x.size) * 0.08, y + rng.normal(size=x.size) * 0.08, gnss.course
    )
    motion = fuse(replace(log, streams={**log.streams, name: rough}), FusionSettings(adapt=False))
    assert not motion.consistent
    assert any("innovations" in w.what for w in motion.warnings)


@pytest.mark.parametrize("latency", [0.02, 0.3])
def test_the_receivers_latency_is_found_from_the_motion(latency: float) -> None:
    of = make(changed(SHORT, gnss__latency=latency), 7)
    motion = fuse(of.log)
    lag = motion.calibration["lag"]
    # inertial time runs ahead of UTC by what the assumed 0.1 s is more than the latency, less the units' own 1 ms
    assert lag["value"] == pytest.approx(0.1 - latency, abs=0.008)
    assert rms(errors(motion, of)["yaw1"][0]) < 0.08 * DEG


def test_a_draft_that_pulls_aside_is_a_doubt_of_the_seeders_yaw(short: tuple[Sample, Motion]) -> None:
    machine = {**SHORT.machine, "seeder": {**SHORT.machine["seeder"], "draft_angle_deg": 15.0}}
    of = make(replace(SHORT, machine=machine), 7)
    motion = fuse(of.log)
    error, sd = errors(motion, of)["yaw2"]
    assert rms(error) > 0.4 * DEG  # it does crab
    assert rms(error / sd) < 2.0
    spread = motion.draws[:, :, 5].std()
    assert spread == pytest.approx(float(np.median(sd)), rel=0.4)


@pytest.mark.full
def test_stated_deviations_cover_the_error_over_two_hundred_twins() -> None:
    """Coverage of 1.96 standard deviations, pooled over seeds with all that is only doubted drawn from its doubt."""
    inside: dict[str, list[float]] = {}
    squares: dict[str, list[float]] = {}
    for seed in range(200):
        of = make(plan_of(seed)[1], 1000 + seed)
        for name, (error, sd) in errors(fuse(of.log), of).items():
            inside.setdefault(name, []).append(float(np.mean(np.abs(error) < 1.96 * sd)))
            squares.setdefault(name, []).append(float(np.mean((error / sd) ** 2)))
    coverage = {name: float(np.mean(values)) for name, values in inside.items()}
    for name in ("lateral1", "along1", "yaw1", "lateral2", "along2", "yaw2", "steer"):
        assert 0.93 < coverage[name] < 0.97, coverage
        assert 0.6 < np.mean(squares[name]) < 1.5, name  # deviations twice or half as large give 0.25 and 4


def test_an_altitude_of_zero_in_a_high_field_is_no_slope() -> None:
    t = np.arange(0.0, 40.0, 0.1)
    nothing = np.full(t.size, np.nan)
    z = 150.0 + 0.01 * 2.8 * t
    z[[0, 200]] = 0.0  # fixes in two dimensions
    epochs = Epochs(
        "gps", "tractor", True, t, 2.8 * t, 0.0 * t, z, np.full(t.size, 0.011), np.ones(t.size, dtype=bool),
        nothing, nothing, nothing, True,
    )  # fmt: skip
    slope = ground_slope(epochs)
    assert slope.gradient[0] == pytest.approx(0.01, abs=0.002)
    assert math.sqrt(slope.covariance[0, 0]) < 0.005


def test_a_steering_sensor_whose_zero_is_far_off_is_told_of_and_doubted_that_much() -> None:
    true = 0.01 * np.sin(np.arange(500) / 50.0)
    honest = SteerInput(true + math.radians(0.5), np.full(500, 0.002), 0.0, math.radians(0.3), 0.01, "sensor")
    bent = replace(honest, angle=true + math.radians(2.0))
    assert with_honest_zero(honest, true) == (honest, ())
    doubted, (warn,) = with_honest_zero(bent, true)
    assert "2.0° off" in warn.what
    assert doubted is not None
    assert doubted.zero_sd == pytest.approx(math.radians(2.0), rel=1e-6)
    np.testing.assert_array_equal(doubted.angle, bent.angle)
    assert with_honest_zero(None, true) == (None, ())
