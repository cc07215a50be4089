"""result.mcap opens in others' tools, and says what the tables say."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import report_samples as samples
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from smts_validate.pipeline.report_view import PassView
from smts_validate.pipeline.result import read_result, write_result
from smts_validate.pipeline.result_mcap import write_result_log


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, PassView]:
    out = tmp_path_factory.mktemp("mcap") / "out"
    write_result(
        out,
        samples.pass_result(),
        lambda folder: write_result_log(folder / "result.mcap", read_result(folder)),
    )
    return out / "result.mcap", read_result(out)


def _messages(path: Path, topic: str) -> list[tuple[int, Any]]:
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        return [(t, reader.deserialize(raw, c.msgtype)) for c, t, raw in reader.messages(wanted)]


def test_rosbags_reads_every_topic_and_only_ros_schemas(written: tuple[Path, PassView]) -> None:
    path, _ = written
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)
    for side in ("measured", "simulated"):
        for body in ("tractor", "seeder"):
            assert kinds[f"/{side}/{body}/odometry"] == "nav_msgs/msg/Odometry"
            assert kinds[f"/{side}/{body}/pose"] == "geometry_msgs/msg/PoseStamped"
            assert kinds[f"/{side}/{body}/fix"] == "sensor_msgs/msg/NavSatFix"
    assert kinds["/tf"] == "tf2_msgs/msg/TFMessage"
    assert kinds["/scene"] == "foxglove_msgs/msg/SceneUpdate"


def test_odometry_is_the_trajectory(written: tuple[Path, PassView]) -> None:
    path, view = written
    found = _messages(path, "/measured/seeder/odometry")
    assert len(found) == view.trajectory["t"].size
    index = 1234
    stamp, message = found[index]
    assert stamp == pytest.approx(view.trajectory["t"][index] * 1e9, abs=200)
    assert message.pose.pose.position.x == view.trajectory["x2"][index]
    half = np.arctan2(message.pose.pose.orientation.z, message.pose.pose.orientation.w)
    assert 2.0 * half == pytest.approx(view.trajectory["yaw2"][index], abs=1e-12)
    covariance = message.pose.covariance.reshape(6, 6)
    assert covariance[5, 5] == pytest.approx(view.trajectory["sd_yaw2"][index] ** 2)
    assert covariance[0, 0] == pytest.approx(view.trajectory["sd_x2"][index] ** 2, rel=0.02)


def test_simulated_messages_are_those_with_a_place_only(written: tuple[Path, PassView]) -> None:
    path, view = written
    found = _messages(path, "/simulated/tractor/pose")
    assert len(found) == int(np.isfinite(view.simulation["x1"]).sum())
    assert all(np.isfinite(m.pose.position.x) for _, m in found)


def test_scene_tells_outlines_residuals_and_verdict(written: tuple[Path, PassView]) -> None:
    path, _ = written
    ((_, update),) = _messages(path, "/scene")
    entities = {entity.id: entity for entity in update.entities}
    assert entities["outline tractor"].frame_locked
    assert len(entities["outline tractor"].cubes) == 4
    assert "inconclusive" in entities["verdict"].texts[0].text
    assert len(entities["residual tractor"].lines[0].points) >= 2


def test_residual_over_time_is_simulated_less_measured(written: tuple[Path, PassView]) -> None:
    path, view = written
    found = _messages(path, "/residual/tractor/deviation")
    grid = view.comparison
    expected = grid["n1_simulated"] - grid["n1"]
    np.testing.assert_array_equal([m.data for _, m in found], expected[np.isfinite(expected)])


def test_fix_lies_at_the_origin_where_the_body_does(written: tuple[Path, PassView]) -> None:
    path, view = written
    found = _messages(path, "/measured/tractor/fix")
    nearest = int(np.argmin(np.hypot(view.trajectory["x1"], view.trajectory["y1"])))
    message = found[nearest][1]
    metres = 111_200.0 * np.hypot(
        message.latitude - 50.0, (message.longitude - 36.5) * np.cos(np.deg2rad(50.0))
    )
    offset = np.hypot(view.trajectory["x1"][nearest], view.trajectory["y1"][nearest])
    assert metres == pytest.approx(offset, abs=0.01)


@pytest.mark.slow
def test_evo_computes_the_error_that_the_tables_hold(written: tuple[Path, PassView], tmp_path: Path) -> None:
    path, view = written
    evo = Path(sys.executable).with_name("evo_ape")
    command = [str(evo), "mcap", str(path), "/measured/tractor/odometry", "/simulated/tractor/odometry"]
    environment = {"HOME": str(tmp_path), "PATH": str(evo.parent), "MPLBACKEND": "Agg"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    told = dict(line.split() for line in done.stdout.splitlines() if line.strip().startswith(("rmse", "max")))
    t, s = view.trajectory, view.simulation
    error = np.hypot(t["x1"] - s["x1"], t["y1"] - s["y1"])
    assert float(told["rmse"]) == pytest.approx(np.sqrt(np.nanmean(error**2)), abs=1e-6)
    assert float(told["max"]) == pytest.approx(np.nanmax(error), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("rerun", [path for path in (shutil.which("rerun"),) if path])
def test_rerun_finds_nothing_wrong_where_it_is_installed(written: tuple[Path, PassView], rerun: str) -> None:
    done = subprocess.run(
        [rerun, "mcap", "check", str(written[0])], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_tractor_alone_writes_no_seeder(tmp_path: Path) -> None:
    out = write_result(tmp_path / "out", samples.pass_result(seeder=False))
    write_result_log(tmp_path / "result.mcap", read_result(out))
    with AnyReader([tmp_path / "result.mcap"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        assert not [c.topic for c in reader.connections if "seeder" in c.topic]
