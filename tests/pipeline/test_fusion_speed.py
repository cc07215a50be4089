"""Speed sensors of a bus in the fusion: worth something without GNSS, never believed more than they deserve."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fusion_samples import Sample, changed, errors, make, rms
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.fuse import fuse, insisting
from smts_validate.pipeline.fusion.motion import Motion
from smts_validate.pipeline.fusion.rolling import UNTOLD, at_middle, by_sensors, forwards_of, own_nodes
from smts_validate.pipeline.fusion.settings import FusionSettings
from smts_validate.pipeline.source import read_source
from smts_validate.pipeline.twin_plan import TwinPlan, preset
from smts_validate.sensors.manifest import Speed, Tractor
from smts_validate.sensors.streams import FieldLog, SpeedStream

OUTAGE = (20.0, 30.0)  # s, from the pass's start; how long
QUICK = FusionSettings(draws=2)


def plan(name: str, wheels: bool = False) -> TwinPlan:
    """A preset without positions for half a minute, and (unless told) without units in the wheels."""
    given = changed(preset(name), gnss__outages=[OUTAGE], gnss__floats=[])
    kept = {k: v for k, v in given.sensors.items() if wheels or v["kind"] != "wds"}
    return replace(given, sensors=kept)


def with_speed(of: Sample, scale: float, seed: int, **keys: object) -> FieldLog:
    """The log with the gearbox's speed at 10 Hz: truth times 1 + scale and a wandering slip, noise of 3 cm/s,
    steps of 1 cm/s, 20 ms late."""
    rng, truth = np.random.default_rng(seed), of.truth
    t = np.arange(truth[0, 0] + 0.03, truth[-1, 0] - 0.05, 0.1)
    slip = 0.001 * np.cumsum(rng.normal(size=t.size)) * np.sqrt(0.1)
    speed = (1.0 + scale) * (1.0 + slip) * np.interp(t, truth[:, 0], truth[:, 4])
    told = np.round((speed + rng.normal(0.0, 0.03, t.size)) / 0.01) * 0.01
    sensor = Speed.model_validate({"kind": "speed", "file": "speed.csv", "rate": 10.0, **keys})
    sensors = {**of.log.manifest.sensors, "gearbox": sensor}
    return replace(
        of.log,
        streams={**of.log.streams, "gearbox": SpeedStream("gearbox", t + 0.02, t + 0.03, told)},
        manifest=of.log.manifest.model_copy(update={"sensors": sensors}),
    )


def along_in_outage(motion: Motion, of: Sample) -> tuple[np.ndarray, np.ndarray]:
    """Errors along the way while there were no positions, and their stated deviations, m."""
    error, sd = errors(motion, of)["along1"]
    t = motion.t[(motion.t > of.truth[0, 0] + 2.0) & (motion.t < of.truth[-1, 0] - 2.0)] - of.truth[0, 0]
    inside = (t > OUTAGE[0]) & (t < sum(OUTAGE))
    return error[inside], sd[inside]


@pytest.fixture(scope="module")
def passes() -> list[Sample]:
    """Three passes with ordinary MEMS units."""
    return [make(plan("bad_sensors"), seed) for seed in (1, 2, 3)]


@pytest.fixture(scope="module")
def bridged(passes: list[Sample]) -> list[Motion]:
    """Their motion with a speed sensor that reads 3 % too much."""
    return [fuse(with_speed(of, 0.03, 10 + i), QUICK) for i, of in enumerate(passes)]


def test_an_outage_is_bridged_better_along_the_way_with_a_speed_sensor(
    passes: list[Sample], bridged: list[Motion]
) -> None:
    without = [along_in_outage(fuse(of.log, QUICK), of) for of in passes]
    having = [along_in_outage(motion, of) for motion, of in zip(bridged, passes, strict=True)]
    assert rms(np.concatenate([e for e, _ in having])) < 0.5 * rms(np.concatenate([e for e, _ in without]))
    for (_, sd), (_, sd_without) in zip(having, without, strict=True):
        assert sd.max() < 0.5 * sd_without.max()
    assert max(float(np.abs(e / sd).max()) for e, sd in having) < 3.0


def test_a_scale_error_of_three_percent_is_found(bridged: list[Motion]) -> None:
    for motion in bridged:
        found = motion.calibration["wheel_scale"]
        assert found["sd"] < 0.025
        # what is found is the scale at the end of the pass: the slip has wandered by 0.001·√60 s till then
        assert abs(found["value"] - 0.03) < 3.0 * np.hypot(found["sd"], 0.008)
    assert np.mean([m.calibration["wheel_scale"]["value"] for m in bridged]) > 0.01


def test_its_innovations_are_told_and_its_noise_is_the_passs_own(bridged: list[Motion]) -> None:
    for motion in bridged:
        channel = next(c for c in motion.consistency if c.channel == "wheel speed")
        assert channel.consistent
        assert channel.count > 200
        assert "wheel speed" in motion.innovations
        assert motion.noise["gearbox"]["speed"]["source"] == "assumed, at least"
        assert motion.noise["levels"]["wheel"]["value"] == pytest.approx(0.03, rel=0.4)


def test_a_sensor_in_the_wrong_unit_is_refused_and_told_of(passes: list[Sample]) -> None:
    of = passes[0]
    alone, wrong = fuse(of.log, QUICK), fuse(with_speed(of, 2.6, 10), QUICK)
    error, other = along_in_outage(alone, of)[0], along_in_outage(wrong, of)[0]
    assert rms(other) < 1.5 * rms(error) + 0.05
    assert not wrong.consistent
    assert any("wheel speed" in warn.what for warn in wrong.warnings)


def test_units_in_the_rear_wheels_come_before_the_bus() -> None:
    of = make(changed(plan("benign", wheels=True), path__duration=30.0, gnss__outages=[]), 4)
    motions = [fuse(log, FusionSettings(adapt=False, draws=2)) for log in (of.log, with_speed(of, 0.2, 5))]
    np.testing.assert_array_equal(motions[0].tractor.x, motions[1].tractor.x)


ROOT = Path(__file__).resolve().parents[2]
HUSKY = ROOT.parent / "shared" / "real" / "husky" / "husky_test1_mcap"


@pytest.mark.skipif(not HUSKY.is_dir(), reason="../shared is not beside this checkout")
def test_good_odometry_does_not_lock_out_a_receiver_that_wanders_by_metres(tmp_path: Path) -> None:
    page = (ROOT / "docs/howto-other-vehicles.md").read_text("utf-8")
    text = next(t for t in re.findall(r"```toml\n(.*?)```", page, re.S) if "/imu/data" in t)
    (tmp_path / "husky.toml").write_text(text, encoding="utf-8")
    motion = fuse(read_source(HUSKY, tmp_path / "husky.toml"), QUICK)
    channels = {c.channel: c for c in motion.consistency}
    position, wheels = channels["gnss position, not fixed"], channels["wheel speed"]
    assert position.rejected < 0.05 * position.count
    assert wheels.rejected < 0.05 * wheels.count
    assert motion.noise["wheels"]["speed"]["value"] == UNTOLD


@pytest.mark.parametrize(("kind", "column"), [(s.FIXED_X, 0), (s.FLOAT_X, 1)])
def test_positions_refused_on_end_are_a_new_error_of_the_receiver(kind: int, column: int) -> None:
    """One epoch each 0.1 s; refused from 3 s to 9 s, by 2 m east and 1 m north, and for one second at 15 s."""
    t = np.arange(0.0, 20.0, 0.1)
    away = (t > 2.95) & (t < 8.95)
    refused = away | ((t > 14.95) & (t < 15.95))
    q = SimpleNamespace(
        kind=np.tile([kind, kind + 1], t.size), node=np.repeat(np.rint(t / 0.02).astype(int), 2)
    )
    offsets = np.where(away[:, None], [2.0, 1.0], 0.0).ravel()
    found: Any = SimpleNamespace(used=~np.repeat(refused, 2), nu=offsets)
    task: Any = SimpleNamespace(t=GRID, measurements=q)
    jumps = insisting(task, found)
    assert np.flatnonzero(jumps[:, column]).tolist() == [150, 450]  # when it left, and when it was back
    np.testing.assert_allclose(jumps[[150, 450], column], 5.0)
    assert not jumps[:, 1 - column].any()


# --- the pieces ---

TRACTOR = Tractor(
    mass=5200.0, yaw_inertia=9500.0, front_track=1.9, rear_track=1.8, front_axle=1.45, rear_axle=1.15, hitch=2.05,
    cog_height=1.0, front_wheel_radius=0.62, rear_wheel_radius=0.8,
)  # fmt: skip
GRID = np.arange(0.0, 20.0, 0.02)


def speed_sensor(**keys: object) -> Speed:
    return Speed.model_validate({"kind": "speed", "file": "a.csv", "rate": 10.0, **keys})


@pytest.mark.parametrize("radius", [8.0, -8.0, 400.0])
@pytest.mark.parametrize("wheel", ["front_left", "front_right", "rear_left", "rear_right", None])
def test_on_a_circle_every_wheel_tells_the_same_speed_of_the_middle(wheel: str | None, radius: float) -> None:
    """Centre of the turn at (0, radius) from the rear axle's middle: each hub runs at rate times its distance."""
    places = {
        "front_left": (2.6, 0.95), "front_right": (2.6, -0.95), "rear_left": (0.0, 0.9), "rear_right": (0.0, -0.9),
        None: (0.0, 0.0),
    }  # fmt: skip
    rate = np.array([2.5 / radius])
    x, y = places[wheel]
    hub = np.abs(rate) * np.hypot(x, radius - y)
    assert at_middle(hub, speed_sensor(wheel=wheel), TRACTOR, rate)[0] == pytest.approx(2.5, abs=1e-12)


def series(name: str, t: np.ndarray, speed: np.ndarray) -> SpeedStream:
    return SpeedStream(name, t, t + 0.01, speed)


def test_a_second_sensor_that_drops_out_makes_no_step() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    one, two = series("a", t, np.full(t.size, 2.0)), series("b", t[t < 10.0], np.full(100, 2.2))
    told = [(speed_sensor(wheel="rear_left"), one), (speed_sensor(wheel="rear_right"), two)]
    found = by_sensors(GRID, told, TRACTOR, np.zeros(GRID.size), np.ones(GRID.size))
    np.testing.assert_allclose(found.speed[GRID < 19.8], 2.0, rtol=1e-12)


def test_holes_and_creeping_are_not_measured() -> None:
    t = np.concatenate([np.arange(0.0, 5.0, 0.1), np.arange(8.0, 20.0, 0.1)])
    stream = series("a", t, np.where(t < 11.95, 2.0, 0.3))
    zero, one = np.zeros(GRID.size), np.ones(GRID.size)
    found = by_sensors(GRID, [(speed_sensor(), stream)], TRACTOR, zero, one)
    k, speed, _ = found.measured(np.zeros(GRID.size, dtype=bool), 0.03)
    assert not ((GRID[k] > 4.95) & (GRID[k] < 7.95)).any()
    assert GRID[k].max() < 11.95
    np.testing.assert_allclose(speed, 2.0)


def test_a_slow_sensor_is_measured_once_a_sample() -> None:
    t = np.arange(0.5, 19.0, 1.0)
    assert own_nodes(GRID, series("a", t, np.full(t.size, 2.0))).sum() == t.size


def test_stated_noise_is_the_least_and_the_stated_scale_is_the_prior() -> None:
    t = np.arange(0.0, 20.0, 0.1)
    told = [(speed_sensor(noise=0.2, scale_sd=0.04), series("a", t, np.full(t.size, 2.0)))]
    found = by_sensors(GRID, told, TRACTOR, np.zeros(GRID.size), np.ones(GRID.size))
    assert found.scale_sd == 0.04
    assert found.measured(np.zeros(GRID.size, dtype=bool), 0.0)[2].min() == pytest.approx(0.04)


def test_a_sensor_without_sign_takes_the_direction_of_travel_one_with_sign_gives_it(
    passes: list[Sample],
) -> None:
    t = np.arange(0.0, 20.0, 0.1)
    back = np.where(GRID < 10.0, 1.0, -1.0)
    blind = by_sensors(
        GRID, [(speed_sensor(), series("a", t, np.full(t.size, 2.0)))], TRACTOR, np.zeros(GRID.size), back
    )
    np.testing.assert_allclose(blind.speed[GRID < 19.8], 2.0 * back[GRID < 19.8])
    resting = series("a", t, np.where(t < 10.0, 2.0, -0.002))
    assert (forwards_of(GRID, None, replace(passes[0].log, streams={"a": resting})) == 1.0).all()
    signed = series("a", t, np.where(t < 10.0, 2.0, -2.0))
    log = replace(passes[0].log, streams={**passes[0].log.streams, "a": signed})
    told = forwards_of(GRID, None, log)
    assert (told[GRID < 9.8] == 1.0).all()
    assert (told[GRID > 10.1] == -1.0).all()
    assert (forwards_of(GRID, None, passes[0].log) == 1.0).all()
