"""Recordings of other vehicles: the pages' own manifest and plan are what they say they are."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from smts_validate.pipeline.identify import Recording, identify, names_of
from smts_validate.pipeline.identify_parameter import IdentifyError
from smts_validate.pipeline.identify_wishes import Wish
from smts_validate.pipeline.run import run_pass
from smts_validate.pipeline.source import machine_of, read_source
from smts_validate.pipeline.twin_campaign import campaign_from
from smts_validate.sensors import manifest

ROOT = Path(__file__).resolve().parents[2]
PLAN, HUSKY = re.findall(
    r"```toml\n(.*?)```", (ROOT / "docs/howto-other-vehicles.md").read_text("utf-8"), re.S
)
RECORDING = ROOT.parent / "shared" / "real" / "husky" / "husky_test1_mcap"


def test_the_pages_plan_makes_tractors_alone_whose_front_tyre_is_half_as_stiff() -> None:
    passes = [plan for plan, _ in campaign_from(tomllib.loads(PLAN)).passes()]
    assert len(passes) == 4
    for plan in passes:
        assert "seeder" not in plan.machine
        assert plan.truth == {"tyres.front.cornering_stiffness": 0.5}


def test_the_pages_manifest_of_a_robot_has_one_body_and_turns_its_imu_upright() -> None:
    read = manifest.parse(HUSKY)
    assert read.machine.seeder is None
    roll, pitch, yaw = np.deg2rad(read.sensors["imu"].rotation_deg)
    assert pitch == 0.0
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    # Sensor's +y is up, its −z forward and its −x to the left.
    for sensor, body in (((0, 1, 0), (0, 0, 1)), ((0, 0, -1), (1, 0, 0)), ((-1, 0, 0), (0, 1, 0))):
        assert about_z @ about_x @ np.array(sensor) == pytest.approx(np.array(body), abs=1e-12)


@pytest.mark.slow
@pytest.mark.skipif(not RECORDING.is_dir(), reason="../shared is not beside this checkout")
def test_a_skid_steered_robot_is_fused_and_its_verdict_is_inconclusive_for_want_of_a_row(
    tmp_path: Path,
) -> None:
    (tmp_path / "husky.toml").write_text(HUSKY, encoding="utf-8")
    log = read_source(RECORDING, tmp_path / "husky.toml")
    assert "tractor.front_axle" in [row["parameter"] for row in names_of(RECORDING, tmp_path / "husky.toml")]
    result = run_pass(log)
    assert result.metrics["verdict"]["value"] == "inconclusive"
    assert result.metrics["verdict"]["codes"] == ["no-row"]
    motion = result.motion
    assert motion.seeder is None
    # Its odometry reads 1.02 m/s at most, its positions (without smoothing) a loop of 395 m.
    assert float(np.nanpercentile(motion.tractor.v, 95)) < 1.5
    steps = np.hypot(np.diff(motion.tractor.x), np.diff(motion.tractor.y))
    assert 330.0 < float(steps.sum()) < 460.0
    with pytest.raises(IdentifyError, match="no pass has a row"):
        identify([Recording(log.manifest, motion, machine_of(log))], {"tractor.front_axle": Wish()})
