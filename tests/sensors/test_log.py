"""A pass written as MCAP and read back; what others' readers see in it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from log_samples import a_log, assert_same
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from smts_validate.sensors.cdr import CdrError
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.log import (
    Attachment,
    Channel,
    LogError,
    messages,
    read_log,
    write_channels,
    write_log,
)
from smts_validate.sensors.log_topics import from_ns, to_ns
from smts_validate.sensors.streams import FieldLog, ImuStream


@pytest.fixture(scope="module")
def log() -> FieldLog:
    return a_log()


@pytest.fixture(scope="module")
def path(log: FieldLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    write_log(path, log)
    return path


def test_a_log_gives_back_exactly_what_was_written(log: FieldLog, path: Path) -> None:
    again = read_log(path)
    assert_same(log, again)
    assert again.manifest == log.manifest
    assert again.manifest_text == log.manifest_text
    assert again.warnings == log.warnings
    assert again.health == log.health


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_every_log_comes_back_exactly(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    log = a_log(seed, seconds=1.0)
    path = tmp_path_factory.mktemp("log") / "sample.mcap"
    write_log(path, log)
    assert_same(log, read_log(path))


def test_a_magnetometer_that_never_gave_a_value_is_still_there(log: FieldLog, tmp_path: Path) -> None:
    unit: Any = log.streams["imd1"]
    silent = dataclasses.replace(unit, magnetic_field=np.full((unit.t.size, 3), np.nan))
    written = dataclasses.replace(log, streams={**log.streams, "imd1": silent})
    write_log(tmp_path / "a.mcap", written)
    assert_same(written, read_log(tmp_path / "a.mcap"))


def test_a_log_longer_than_a_chunk_comes_back_exactly(tmp_path: Path) -> None:
    log = a_log(seconds=100.0)
    write_log(tmp_path / "a.mcap", log)
    assert_same(log, read_log(tmp_path / "a.mcap"))


def test_the_mcap_package_reads_it_with_its_checksums_topics_and_schemas(log: FieldLog, path: Path) -> None:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        count = sum(1 for _ in reader.iter_messages())
        attached = {each.name: each.data.decode() for each in reader.iter_attachments()}
        told = {each.name: each.metadata for each in reader.iter_metadata()}
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == count
    assert {each.compression for each in summary.chunk_indexes} == {"zstd"}
    schemas = {c.topic: summary.schemas[c.schema_id].name for c in summary.channels.values()}
    assert schemas["/imd1/imu"] == schemas["/wds1/imu"] == "sensor_msgs/msg/Imu"
    assert schemas["/imd1/mag"] == "sensor_msgs/msg/MagneticField"
    assert schemas["/gps/fix"] == "sensor_msgs/msg/NavSatFix"
    assert schemas["/gps/vel"] == "geometry_msgs/msg/TwistStamped"
    assert schemas["/steer"] == "sensor_msgs/msg/JointState"
    assert schemas["/gearbox/speed"] == "geometry_msgs/msg/TwistStamped"
    assert "/wds1/mag" not in schemas
    assert attached["run.toml"] == log.manifest_text
    assert told["smts.run"]["id"] == "sample-1"
    assert told["smts.run"]["date"] == "2025-05-14"


def decoded(path: Path, topic: str) -> list[tuple[Any, Any]]:
    """(log time, message) by the mcap and mcap-ros2-support packages."""
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = reader.iter_decoded_messages(topics=[topic], log_time_order=False)
        return [(each.message.log_time, each.decoded_message) for each in found]


def test_another_decoder_sees_the_samples(log: FieldLog, path: Path) -> None:
    stream: Any = log.streams["imd1"]
    found = decoded(path, "/imd1/imu")
    assert len(found) == stream.t.size
    for i in (0, 7, len(found) - 1):
        log_time, message = found[i]
        assert message.header.frame_id == "imd1"
        assert message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec == pytest.approx(
            stream.t[i], abs=1e-6
        )
        assert log_time * 1e-9 == pytest.approx(stream.t_arrival[i], abs=1e-6)
        a, w = message.linear_acceleration, message.angular_velocity
        assert [a.x, a.y, a.z] == stream.specific_force[i].tolist()
        assert [w.x, w.y, w.z] == stream.angular_velocity[i].tolist()
        assert message.orientation_covariance[0] == -1.0


def test_another_decoder_sees_fix_velocity_heading_and_steering(log: FieldLog, path: Path) -> None:
    gps: Any = log.streams["gps"]
    fixes = [message for _, message in decoded(path, "/gps/fix")]
    np.testing.assert_array_equal([m.latitude for m in fixes], gps.lat)
    np.testing.assert_allclose([m.position_covariance[4] for m in fixes], gps.sd_north**2)
    assert {m.status.status for m, q in zip(fixes, gps.quality, strict=True) if q == 4} == {2}
    moving = np.isfinite(gps.speed) & np.isfinite(gps.course)
    vel = [message for _, message in decoded(path, "/gps/vel")]
    east = [m.twist.linear.x for m in vel]
    np.testing.assert_allclose(east, (gps.speed * np.cos(gps.course))[moving], rtol=1e-12)
    turned = np.isfinite(gps.heading)
    yaw = [2.0 * np.arctan2(m.quaternion.z, m.quaternion.w) for _, m in decoded(path, "/gps/heading")]
    np.testing.assert_allclose(np.exp(1j * np.array(yaw)), np.exp(1j * gps.heading[turned]), atol=1e-12)
    steer: Any = log.streams["steer"]
    joints = [message for _, message in decoded(path, "/steer")]
    assert {tuple(m.name) for m in joints} == {("steering",)}
    assert [m.position[0] for m in joints] == steer.angle.tolist()


def test_another_decoder_sees_the_speed_of_the_wheels_along_x(log: FieldLog, path: Path) -> None:
    stream: Any = log.streams["gearbox"]
    twists = [message for _, message in decoded(path, "/gearbox/speed")]
    assert [m.twist.linear.x for m in twists] == stream.speed.tolist()
    assert {(m.header.frame_id, m.twist.linear.y, m.twist.angular.z) for m in twists} == {
        ("gearbox", 0.0, 0.0)
    }


@given(st.floats(min_value=2.0**23, max_value=2.0**31, exclude_max=True))
def test_stamps_hold_every_float_of_utc_seconds(t: float) -> None:
    assert from_ns(to_ns(np.array([t])))[0] == t


def test_the_same_log_is_the_same_bytes(log: FieldLog, path: Path, tmp_path: Path) -> None:
    write_log(tmp_path / "again.mcap", log)
    assert (tmp_path / "again.mcap").read_bytes() == path.read_bytes()


def test_a_time_beyond_2038_is_refused_and_leaves_no_file(log: FieldLog, tmp_path: Path) -> None:
    late = ImuStream("imd1", np.array([2.0**31]), np.array([2.0**31]), np.ones((1, 3)), np.ones((1, 3)))
    with pytest.raises(CdrError, match="2038"):
        write_log(tmp_path / "a.mcap", dataclasses.replace(log, streams={"imd1": late}))
    assert list(tmp_path.iterdir()) == []


def test_times_that_mcap_cannot_hold_are_refused(tmp_path: Path) -> None:
    numbers = messages("std_msgs/msg/Float64", {}, {"data": np.arange(2.0)})
    early = Channel("/a", "std_msgs/msg/Float64", np.array([-1, 0]), numbers)
    with pytest.raises(LogError, match="before 1970"):
        write_channels(tmp_path / "a.mcap", [early])
    fewer = Channel("/a", "std_msgs/msg/Float64", np.array([0]), numbers)
    with pytest.raises(LogError, match="2 messages with 1 log times"):
        write_channels(tmp_path / "a.mcap", [fewer])
    assert list(tmp_path.iterdir()) == []


def test_an_old_file_stays_whole_when_writing_a_new_one_fails(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"old")
    broken = Channel("/a", "std_msgs/msg/Float64", np.arange(2), messages_that_fail())
    with pytest.raises(ZeroDivisionError):
        write_channels(path, [broken])
    assert path.read_bytes() == b"old"
    assert [each.name for each in tmp_path.iterdir()] == ["a.mcap"]


def messages_that_fail() -> Any:
    class Failing(list[bytes]):
        def __getitem__(self, key: Any) -> Any:
            raise ZeroDivisionError

    return Failing([b"a", b"b"])


def test_channels_of_columns_and_of_single_messages_lie_side_by_side(tmp_path: Path) -> None:
    t_ns = np.arange(5) * 10**9
    numbers = messages("std_msgs/msg/Float64", {}, {"data": np.arange(5.0)})
    texts = [b"\x00\x01\x00\x00" + len(text).to_bytes(4, "little") + text for text in (b"a\0", b"longer\0")]
    write_channels(
        tmp_path / "a.mcap",
        [
            Channel("/number", "std_msgs/msg/Float64", t_ns, numbers),
            Channel("/text", "std_msgs/msg/String", t_ns[:2], texts),
            Channel("/nothing", "std_msgs/msg/String", t_ns[:0], []),
        ],
        [Attachment("note.txt", "text/plain", b"hello")],
        {"about": {"key": "value"}},
    )
    assert [m.data for _, m in decoded(tmp_path / "a.mcap", "/number")] == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert [m.data for _, m in decoded(tmp_path / "a.mcap", "/text")] == ["a", "longer"]
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        assert summary is not None
        assert {c.topic for c in summary.channels.values()} == {
            "/number",
            "/text",
            "/nothing",
        }
        assert [each.data for each in reader.iter_attachments()] == [b"hello"]
        assert [each.metadata for each in reader.iter_metadata()] == [{"key": "value"}]


def test_columns_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="different lengths"):
        messages("geometry_msgs/msg/Point", {}, {"x": np.zeros(3), "y": np.zeros(4)})


def test_a_file_that_is_absent_empty_or_something_else_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    (tmp_path / "text.mcap").write_text("t,ax,ay\n")
    for name, what in (("absent", "cannot be read"), ("empty", "is empty"), ("text", "not an MCAP file")):
        with pytest.raises(LogError, match=what) as caught:
            read_log(tmp_path / f"{name}.mcap")
        assert "\n" not in str(caught.value)


def test_a_log_without_manifest_asks_for_one(tmp_path: Path) -> None:
    write_channels(tmp_path / "a.mcap", [])
    with pytest.raises(LogError, match="--manifest"):
        read_log(tmp_path / "a.mcap")


def test_what_ingest_found_rides_along_as_json(log: FieldLog, path: Path) -> None:
    with path.open("rb") as file:
        found = {each.name: each.data for each in make_reader(file).iter_attachments()}
    told = json.loads(found["ingest.json"])
    assert told["health"] == log.health
    assert told["warnings"][0]["what"] == "3 samples lost"


def test_a_pass_from_its_log_is_the_pass_from_its_raw_files(tmp_path: Path) -> None:
    samples = Path(__file__).resolve().parents[2] / "data_samples"
    folder = sorted(path.parent for path in samples.rglob("run.toml"))[0]
    raw = read_pass(folder)
    write_log(tmp_path / "a.mcap", raw)
    again = read_log(tmp_path / "a.mcap")
    assert_same(raw, again)
    assert (again.manifest_text, again.warnings, again.health) == (
        raw.manifest_text,
        raw.warnings,
        raw.health,
    )
