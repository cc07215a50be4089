"""Recordings that others made: any layout of MCAP, rosbag2 folders, topics named by a manifest."""

from __future__ import annotations

import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from log_samples import (
    BARE,
    REAL,
    STORE,
    TOPIC_SENSORS,
    drive,
    fix,
    imu,
    joints,
    odometry,
    topic_manifest,
    velocity,
    write_foreign,
)
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from smts_validate.sensors.cdr import decode, message_type
from smts_validate.sensors.log import LogError, read_log
from smts_validate.sensors.mcap_messages import Batch, read_messages
from smts_validate.sensors.mcap_scan import open_recording
from smts_validate.sensors.mounting import to_body
from smts_validate.sensors.streams import FieldLog, GnssStream, SpeedStream

HUSKY = REAL / "husky" / "husky_test1_mcap"
JACKAL = REAL / "husky" / "jackal_test2_msgzstd"
needs_husky = pytest.mark.skipif(not HUSKY.exists(), reason="needs ../shared/real/husky")
needs_rosbag2 = pytest.mark.skipif(not (REAL / "rosbag2").exists(), reason="needs ../shared/real/rosbag2")

LAYOUTS: dict[str, dict[str, Any]] = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "small chunks": {"chunk_size": 700},
    "no chunks": {"use_chunking": False},
    "no summary": dict(BARE),
    "no summary, no chunks": {**BARE, "use_chunking": False},
    "no checksums": {"enable_crcs": False},
    "data checksum": {"enable_data_crcs": True},
    "big endian": {"little_endian": False},
    "messages compressed one by one": {
        "pack": zstandard.ZstdCompressor().compress,
        "compression": CompressionType.NONE,
    },
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_layout_of_mcap_gives_the_same_streams(layout: str, tmp_path: Path) -> None:
    topics = drive()
    write_foreign(tmp_path / "a.mcap", topics, **LAYOUTS[layout])
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path))
    unit: Any = log.streams["imu"]
    gps: Any = log.streams["gps"]
    sent = [message for _, message in topics["/imu/data"]]
    force = [[m.linear_acceleration.x, m.linear_acceleration.y, m.linear_acceleration.z] for m in sent]
    np.testing.assert_array_equal(unit.specific_force, force)
    np.testing.assert_allclose(unit.t_arrival - unit.t, 0.025, atol=1e-6)
    np.testing.assert_array_equal(gps.lat, np.full(len(sent), 50.0))
    assert log.warnings == ()


def test_deviations_speed_and_course_come_from_fix_and_velocity(tmp_path: Path) -> None:
    write_foreign(tmp_path / "a.mcap", drive())
    gps: Any = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path)).streams["gps"]
    np.testing.assert_allclose(np.column_stack([gps.sd_east, gps.sd_north, gps.sd_up])[3], [0.2, 0.3, 0.5])
    np.testing.assert_allclose(gps.speed, 1.0)
    np.testing.assert_allclose(gps.course, np.arctan2(0.8, 0.6))
    assert np.isnan(gps.heading).all()


@pytest.mark.parametrize(
    ("status", "variance", "kind", "quality"),
    [
        (-1, 1.0, 2, 0.0),  # no fix
        (0, 4.0, 2, 1.0),  # single
        (1, 1.0, 2, 2.0),  # SBAS: differential
        (2, 1e-4, 2, 4.0),  # GBAS, 1 cm: RTK fixed
        (2, 0.25, 2, 5.0),  # GBAS, 0.5 m: RTK float
        (2, 1e-4, 0, 5.0),  # GBAS, covariance unknown: not trusted as fixed
    ],
)
def test_fix_quality_comes_from_status_and_covariance(
    status: int, variance: float, kind: int, quality: float, tmp_path: Path
) -> None:
    topics = drive(3)
    t_ns = [log_time for log_time, _ in topics["/fix"]]
    topics["/fix"] = [(t, fix(t, status, [variance] * 3, kind)) for t in t_ns]
    write_foreign(tmp_path / "a.mcap", topics)
    gps: Any = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path)).streams["gps"]
    assert gps.quality.tolist() == [quality] * 3
    assert np.isnan(gps.sd_east).all() == (kind == 0)


def test_disordered_doubled_and_broken_samples_are_repaired_and_counted(tmp_path: Path) -> None:
    topics = drive(20)
    rows = topics["/imu/data"]
    t = rows[-1][0]
    rows[3], rows[4] = (rows[3][0], rows[4][1]), (rows[4][0], rows[3][1])  # two stamps change places
    rows.append((t + 1, rows[-1][1]))  # the last message once more
    rows.append((t + 2, imu(t + 10**8, (np.nan, 0.0, 0.0), (0.0, 0.0, 0.0))))
    write_foreign(tmp_path / "a.mcap", topics)
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path))
    unit: Any = log.streams["imu"]
    original = [m.linear_acceleration.x for _, m in drive(20)["/imu/data"]]
    np.testing.assert_array_equal(unit.specific_force[:, 0], original)
    told = {warn.what: warn for warn in log.warnings}
    assert set(told) == {
        "1 message with a value that is not finite on /imu/data",
        "1 message out of order on /imu/data",
        "1 message with a stamp seen before on /imu/data",
    }
    assert {warn.sensor for warn in log.warnings} == {"imu"}


def test_values_that_no_sensor_reads_are_left_out_and_counted(tmp_path: Path) -> None:
    topics = drive(20)
    for i, (force, rate) in enumerate([((1e34, 0, 0), (0, 0, 0)), ((0, 0, 9.8), (0, 1e300, 0))]):
        t = topics["/imu/data"][3 + i][0]
        topics["/imu/data"][3 + i] = (t, imu(t - 25_000_000, force, rate))
    topics["/vel"][5] = (topics["/vel"][5][0], velocity(topics["/vel"][5][0] - 25_000_000, 1e308, 1e308))
    for i, (lat, lon) in enumerate([(95.0, 36.5), (0.0, 0.0)]):
        topics["/fix"][7 + i][1].latitude, topics["/fix"][7 + i][1].longitude = lat, lon
    write_foreign(tmp_path / "a.mcap", topics)
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path))
    gps: Any = log.streams["gps"]
    assert {name: stream.t.size for name, stream in log.streams.items()} == {"imu": 18, "gps": 18}
    assert np.flatnonzero(np.isnan(gps.speed)).tolist() == [5]
    assert {(warn.sensor, warn.what) for warn in log.warnings} == {
        ("imu", "2 messages beyond what such a sensor can read on /imu/data"),
        ("gps", "1 message beyond what such a sensor can read on /vel"),
        ("gps", "2 messages with an impossible position on /fix"),
    }


def test_a_unit_that_froze_is_told(tmp_path: Path) -> None:
    topics = drive(60)
    for i in range(20, 45):
        t = topics["/imu/data"][i][0]
        topics["/imu/data"][i] = (t, imu(t - 25_000_000, (0.1, 0.2, 9.8), (0.0, 0.0, 0.1)))
    write_foreign(tmp_path / "a.mcap", topics)
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path))
    assert log.streams["imu"].t.size == 36  # the first of the 25 equal readings may be true
    assert log.warnings[0].what == "24 messages that repeat one reading (the unit froze) on /imu/data"


def test_an_epoch_without_fix_has_no_position_whatever_the_driver_wrote(tmp_path: Path) -> None:
    topics = drive(6)
    topics["/fix"][2][1].status.status = -1
    topics["/fix"][3][1].status.status = -1
    topics["/fix"][3][1].latitude = topics["/fix"][3][1].longitude = 0.0
    write_foreign(tmp_path / "a.mcap", topics)
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path))
    gps: Any = log.streams["gps"]
    assert np.flatnonzero(np.isnan(gps.lat)).tolist() == [2, 3]
    assert np.flatnonzero(gps.quality == 0.0).tolist() == [2, 3]
    assert log.warnings == ()


def test_where_stamps_are_zero_the_log_time_is_the_time(tmp_path: Path) -> None:
    topics = drive(5)
    topics["/imu/data"] = [(t, imu(0, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))) for t, _ in topics["/imu/data"]]
    write_foreign(tmp_path / "a.mcap", topics)
    unit: Any = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path)).streams["imu"]
    np.testing.assert_array_equal(unit.t, unit.t_arrival)


def test_frames_that_change_their_length_lose_no_sample(tmp_path: Path) -> None:
    topics = drive(30)
    for i, (_, message) in enumerate(topics["/imu/data"]):
        message.header.frame_id = "x" * (i % 4)
    write_foreign(tmp_path / "a.mcap", topics)
    unit: Any = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path)).streams["imu"]
    sent = [m.angular_velocity.y for _, m in topics["/imu/data"]]
    np.testing.assert_array_equal(unit.angular_velocity[:, 1], sent)


STEER = """
[sensors.steer]
kind = "steer"
topic = "/joint_states"
columns = { angle = "front_axle" }
rate = 10.0
"""


def test_steering_is_the_joint_that_the_manifest_names(tmp_path: Path) -> None:
    topics = drive(6)
    t_ns = [t for t, _ in topics["/fix"]]
    topics["/joint_states"] = [
        (
            t,
            joints(
                t,
                ["rear", "front_axle"] if i % 2 else ["front_axle", "rear"],
                [0.1 * i, -1.0][:: 1 - 2 * (i % 2)],
            ),
        )
        for i, t in enumerate(t_ns)
    ]
    write_foreign(tmp_path / "a.mcap", topics)
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path, TOPIC_SENSORS + STEER))
    steer: Any = log.streams["steer"]
    np.testing.assert_allclose(steer.angle, 0.1 * np.arange(6))


SPEED = """
[sensors.odom]
kind = "speed"
topic = "{topic}"
rate = 10.0
"""


@pytest.mark.parametrize("topic", ["/odom", "/speed"])
def test_odometry_and_twists_of_others_are_read_as_the_wheels_speed(topic: str, tmp_path: Path) -> None:
    topics = drive(6)
    t_ns = [t for t, _ in topics["/fix"]]
    topics["/odom"] = [(t, odometry(t - 5_000_000, 0.5 * i)) for i, t in enumerate(t_ns)]
    topics["/speed"] = [(t, velocity(t - 5_000_000, 0.5 * i, 9.0)) for i, t in enumerate(t_ns)]
    write_foreign(tmp_path / "a.mcap", topics)
    given = topic_manifest(tmp_path, TOPIC_SENSORS + SPEED.format(topic=topic))
    log = read_log(tmp_path / "a.mcap", given)
    speed = log.of_type(SpeedStream)["odom"]
    np.testing.assert_array_equal(speed.speed, 0.5 * np.arange(6))
    np.testing.assert_allclose(speed.t_arrival - speed.t, 0.005, atol=1e-6)


def test_a_topic_that_is_absent_is_refused_with_the_nearest_name(tmp_path: Path) -> None:
    write_foreign(tmp_path / "a.mcap", drive(3))
    wrong = topic_manifest(tmp_path, TOPIC_SENSORS.replace("/imu/data", "/imu/dta"))
    with pytest.raises(LogError, match=r"sensor imu on topic /imu/dta; did you mean /imu/data\?"):
        read_log(tmp_path / "a.mcap", wrong)


def test_a_topic_of_another_type_is_refused_with_both_names(tmp_path: Path) -> None:
    write_foreign(tmp_path / "a.mcap", drive(3))
    wrong = topic_manifest(tmp_path, TOPIC_SENSORS.replace("/imu/data", "/vel"))
    with pytest.raises(LogError, match="/vel holds geometry_msgs/msg/TwistStamped, not sensor_msgs/Imu"):
        read_log(tmp_path / "a.mcap", wrong)


def test_somebody_elses_topic_beside_a_sensor_is_passed_over(tmp_path: Path) -> None:
    topics = drive(3)
    text = STORE.types["std_msgs/msg/String"]
    topics["/quality"] = [(t, text("good")) for t, _ in topics["/fix"]]
    topics["/imu/mag"] = [(t, text("iron")) for t, _ in topics["/fix"]]
    write_foreign(tmp_path / "a.mcap", topics)
    log = read_log(tmp_path / "a.mcap", topic_manifest(tmp_path))
    assert log.streams["gps"].t.size == 3


def rosbag2(folder: Path, names: list[str], storage: str = "mcap") -> Path:
    """A metadata.yaml as rosbag2 writes it."""
    folder.mkdir(exist_ok=True)
    listed = "\n".join(f"    - {name}" for name in names)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: {storage}\n"
        f"  relative_file_paths:\n{listed}\n  duration:\n    nanoseconds: 1\n"
    )
    return folder


def test_a_recording_split_into_files_is_one_log(tmp_path: Path) -> None:
    topics = drive(30)
    folder = rosbag2(tmp_path / "bag", [f"bag_{i}.mcap" for i in (0, 1, 2)])
    for i in range(3):
        part = {topic: rows[10 * i : 10 * i + 10] for topic, rows in topics.items()}
        write_foreign(folder / f"bag_{i}.mcap", part)
    unit: Any = read_log(folder, topic_manifest(tmp_path)).streams["imu"]
    sent = [m.linear_acceleration.x for _, m in topics["/imu/data"]]
    np.testing.assert_array_equal(unit.specific_force[:, 0], sent)


def test_a_folder_without_metadata_is_read_in_the_order_of_its_numbers(tmp_path: Path) -> None:
    folder = tmp_path / "bag"
    folder.mkdir()
    topics = drive(12)
    for i in range(12):
        write_foreign(folder / f"bag_{i}.mcap", {topic: rows[i : i + 1] for topic, rows in topics.items()})
    log = read_log(folder, topic_manifest(tmp_path))
    assert log.streams["imu"].t.size == 12
    assert log.warnings == ()  # bag_10 behind bag_9, not behind bag_1


@pytest.mark.parametrize(
    ("names", "storage", "what"),
    [
        (["../outside.mcap"], "mcap", "outside its folder"),
        (["/etc/hostname"], "mcap", "outside its folder"),
        ([], "mcap", "lists no files"),
        (["a.db3"], "sqlite3", "ros2 bag convert"),
        (["absent.mcap"], "mcap", "cannot be read"),
    ],
)
def test_a_rosbag2_folder_that_cannot_be_used_says_why(
    names: list[str], storage: str, what: str, tmp_path: Path
) -> None:
    folder = rosbag2(tmp_path / "bag", names, storage)
    with pytest.raises(LogError, match=what):
        read_log(folder, topic_manifest(tmp_path))


def test_an_empty_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    with pytest.raises(LogError, match="give an MCAP file or a rosbag2 folder"):
        read_log(tmp_path / "bag", topic_manifest(tmp_path))


HUSKY_SENSORS = """
[sensors.imu]
kind = "imd"
body = "tractor"
topic = "/imu/data"
position = [0.0, 0.0, 0.0]
rotation_deg = [90.0, 0.0, 0.0]
rate = 30.0
[sensors.gps]
kind = "gps"
topic = "/fix"
position = [0.0, 0.0, 0.5]
rate = 2.5
"""


@pytest.fixture(scope="module")
def husky(tmp_path_factory: pytest.TempPathFactory) -> FieldLog:
    return read_log(HUSKY, topic_manifest(tmp_path_factory.mktemp("husky"), HUSKY_SENSORS))


@needs_husky
def test_the_huskys_odometry_is_a_speed_sensor_that_agrees_with_its_receiver(tmp_path: Path) -> None:
    sensors = HUSKY_SENSORS + SPEED.format(topic="/husky_velocity_controller/odom")
    log = read_log(HUSKY, topic_manifest(tmp_path, sensors))
    speed, gps = log.of_type(SpeedStream)["odom"], log.of_type(GnssStream)["gps"]
    assert speed.t.size == 3952  # as its metadata.yaml says
    east = np.radians(gps.lon - gps.lon[0]) * 6.371e6 * np.cos(np.radians(gps.lat[0]))
    north = np.radians(gps.lat - gps.lat[0]) * 6.371e6
    way = np.hypot(np.diff(east[::5]), np.diff(north[::5])).sum()  # every other second: less of it is noise
    rolled = np.trapezoid(np.abs(speed.speed), speed.t)
    assert rolled == pytest.approx(way, rel=0.15)


@needs_husky
def test_the_husky_recording_is_a_tractor_only_pass(husky: FieldLog) -> None:
    assert husky.manifest.machine.seeder is None
    assert husky.warnings == ()
    assert husky.streams["imu"].t.size == 11865  # as its metadata.yaml says
    assert husky.streams["gps"].t.size == 989
    assert husky.health["imu"]["rate_hz"] == pytest.approx(30.0, rel=1e-3)


@needs_husky
def test_the_huskys_stamps_lag_its_log_times_by_25_ms(husky: FieldLog) -> None:
    unit: Any = husky.streams["imu"]
    assert np.median(unit.t_arrival - unit.t) == pytest.approx(0.025, abs=5e-4)


@needs_husky
def test_the_huskys_mounting_turns_gravity_from_y_to_up(husky: FieldLog) -> None:
    unit: Any = husky.streams["imu"]
    force, rate = to_body(unit, husky.manifest.sensors["imu"])
    assert unit.specific_force.mean(axis=0)[1] == pytest.approx(9.8, abs=0.1)
    assert force.mean(axis=0)[2] == pytest.approx(9.8, abs=0.1)
    assert rate.std(axis=0).argmax() == 2  # a machine on the ground turns about its vertical axis


def columns_of(path: Path, names: dict[str, tuple[str, ...]]) -> dict[str, list[Any]]:
    """Our columns of whole topics, by `topic path`."""
    found: dict[str, list[Any]] = defaultdict(list)
    for batch in read_messages(open_recording(path), lambda channel: channel.topic in names):
        assert isinstance(batch, Batch)
        assert batch.schema is not None
        kind = message_type(batch.schema.name, batch.schema.data.decode())
        for group in decode(kind, batch.payloads):
            for name in names[batch.channel.topic]:
                found[f"{batch.channel.topic} {name}"] += group.column(name).tolist()
    return found


def attribute(message: Any, path: str) -> Any:
    for part in path.split("."):
        message = getattr(message, part)
    return message


REAL_FIELDS = {
    "/imu/data": (
        "header.stamp.sec",
        "header.stamp.nanosec",
        "orientation.w",
        "linear_acceleration_covariance",
    ),
    "/husky_velocity_controller/odom": ("child_frame_id", "pose.pose.position.x", "twist.covariance"),
    "/fix": ("header.frame_id", "status.status", "status.service", "latitude", "position_covariance_type"),
}


@needs_husky
def test_the_huskys_fields_are_those_that_another_decoder_reads() -> None:
    path = HUSKY / "husky_test1_mcap.mcap"
    theirs: dict[str, list[Any]] = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages(log_time_order=False):
            for name in REAL_FIELDS[channel.topic]:
                value = attribute(message, name)
                theirs[f"{channel.topic} {name}"].append(value.encode() if isinstance(value, str) else value)
    assert columns_of(path, REAL_FIELDS) == theirs


@needs_husky
def test_messages_compressed_one_by_one_are_those_that_rosbags_reads() -> None:
    ours = columns_of(
        JACKAL / "jackal_test2_msgzstd.mcap",
        {
            "/imu/data": ("linear_acceleration.z",),
            "/jackal_velocity_controller/odom": ("twist.twist.linear.x",),
        },
    )
    theirs: dict[str, list[float]] = defaultdict(list)
    with Reader(JACKAL) as reader:
        for connection, _, raw in reader.messages():
            message: Any = STORE.deserialize_cdr(raw, connection.msgtype)
            if connection.topic == "/imu/data":
                theirs["/imu/data linear_acceleration.z"].append(message.linear_acceleration.z)
            else:
                theirs[f"{connection.topic} twist.twist.linear.x"].append(message.twist.twist.linear.x)
    assert ours == theirs


@needs_rosbag2
def test_small_recordings_of_rosbag2_give_the_messages_that_the_mcap_package_reads() -> None:
    for path in sorted((REAL / "rosbag2").glob("*.mcap")):
        with path.open("rb") as file:
            sent = [message for _, _, message in make_reader(file).iter_messages(log_time_order=False)]
        theirs = sorted((m.channel_id, m.log_time, m.data) for m in sent)
        ours = []
        for batch in read_messages(open_recording(path), lambda channel: True):
            assert isinstance(batch, Batch)
            times = batch.log_time.tolist()
            ours += [(batch.channel.id, t, batch.payloads.at(i)) for i, t in enumerate(times)]
        assert sorted(ours) == theirs, path.name


@needs_rosbag2
def test_a_service_in_a_recording_does_not_disturb_its_topics(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    shutil.copy(REAL / "rosbag2" / "rosbag2__topics_and_services.mcap", path)
    with pytest.raises(LogError, match="no messages for sensor imu"):
        read_log(path, topic_manifest(tmp_path))


def test_a_schema_in_another_notation_is_read_where_the_type_is_known(tmp_path: Path) -> None:
    write_foreign(tmp_path / "b.mcap", drive(4), use_chunking=False, enable_crcs=False)
    renamed = (
        (tmp_path / "b.mcap").read_bytes().replace(b"\x07\x00\x00\x00ros2msg", b"\x07\x00\x00\x00ros2idl")
    )
    (tmp_path / "b.mcap").write_bytes(renamed)
    log = read_log(tmp_path / "b.mcap", topic_manifest(tmp_path))
    assert log.streams["imu"].t.size == 4
