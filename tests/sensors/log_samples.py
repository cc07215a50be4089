"""A small pass for the log's tests, and MCAP files as others write them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_typestore
from smts_validate.sensors import manifest
from smts_validate.sensors.draft_text import MACHINE
from smts_validate.sensors.ros_messages import definition
from smts_validate.sensors.streams import (
    FieldLog,
    GnssStream,
    ImuStream,
    SpeedStream,
    SteerStream,
    Stream,
    Warn,
    WheelStream,
)

SHARED = Path(__file__).resolve().parents[3] / "shared"
REAL = SHARED / "real"
STORE = get_typestore(Stores.ROS2_HUMBLE)

RUN = (
    """schema = 1
[run]
id = "sample-1"
field = "field1"
direction = "east"
variant = "b"
date = 2025-05-14
[operating]
speed = 2.8
tyre_pressure_mpa = 0.12
"""
    + MACHINE
)

OWN_SENSORS = """
[sensors.imd1]
kind = "imd"
body = "tractor"
file = "imd1.csv"
position = [0.3, 0.0, -0.2]
rate = 100.0
[sensors.wds1]
kind = "wds"
wheel = "front_right"
file = "wds1.csv"
rate = 100.0
[sensors.gps]
kind = "gps"
file = "gps.nmea"
position = [0.0, 0.0, 2.1]
rate = 10.0
[sensors.steer]
kind = "steer"
file = "steer.csv"
rate = 50.0
[sensors.gearbox]
kind = "speed"
file = "speed.csv"
rate = 20.0
"""

START = 1_747_215_000.25  # s, UTC


def _times(rng: np.random.Generator, seconds: float, rate: float) -> tuple[Any, Any]:
    t = START + rng.uniform(0.0, 0.1) + np.arange(int(seconds * rate)) / rate
    t = t + rng.uniform(-0.2, 0.2, t.size) / rate
    return t, t + rng.uniform(0.001, 0.02, t.size)


def _holes(rng: np.random.Generator, values: Any) -> Any:
    """Values with NaN here and there."""
    return np.where(rng.random(values.shape) < 0.1, np.nan, values)


def a_log(seed: int = 0, seconds: float = 20.0) -> FieldLog:
    """A pass with every kind of stream, noise for values, and holes wherever a stream may have them."""
    rng = np.random.default_rng(seed)
    text = RUN + OWN_SENSORS
    streams: dict[str, Stream] = {}
    for name, kind in (("imd1", ImuStream), ("wds1", WheelStream)):
        t, arrival = _times(rng, seconds, 100.0)
        vectors = rng.normal(size=(2, t.size, 3))
        magnetic = _holes(rng, rng.normal(0.0, 3e-5, (t.size, 3))) if name == "imd1" else None
        streams[name] = kind(name, t, arrival, vectors[0], vectors[1], magnetic)
    t, arrival = _times(rng, seconds, 10.0)
    values = {key: _holes(rng, rng.uniform(0.01, 5.0, t.size)) for key in GnssStream.ARRAYS}
    values["quality"] = rng.choice([0.0, 1.0, 2.0, 4.0, 5.0, 6.0], t.size)
    streams["gps"] = GnssStream("gps", t, arrival, **values)
    t, arrival = _times(rng, seconds, 50.0)
    streams["steer"] = SteerStream("steer", t, arrival, rng.normal(0.0, 0.1, t.size))
    t, arrival = _times(rng, seconds, 20.0)
    streams["gearbox"] = SpeedStream("gearbox", t, arrival, rng.normal(2.0, 1.0, t.size))
    warnings = (Warn("3 samples lost", "left as gaps", "imd1", "imd1.csv", 17), Warn("odd", "nothing"))
    health = {"imd1": {"rate_hz": 100.0, "drift_ppm": None}, "clock": {"source": "gps"}}
    return FieldLog(manifest.parse(text), text, streams, warnings, health, "somewhere", "0" * 64)


def arrays_of(stream: Stream) -> dict[str, Any]:
    """A stream's arrays by name (None where it has none)."""
    return {f.name: getattr(stream, f.name) for f in dataclasses.fields(stream) if f.name != "name"}


def assert_same(one: FieldLog, other: FieldLog) -> None:
    """Streams equal to the last bit, of the same kinds, in the same order."""
    assert list(one.streams) == list(other.streams)
    for name, stream in one.streams.items():
        assert type(other.streams[name]) is type(stream)
        for key, values in arrays_of(stream).items():
            again = arrays_of(other.streams[name])[key]
            if values is None:
                assert again is None
            else:
                np.testing.assert_array_equal(again, values, err_msg=f"{name}.{key}")


TOPIC_SENSORS = """
[sensors.imu]
kind = "imd"
body = "tractor"
topic = "/imu/data"
position = [0.0, 0.0, 0.0]
rate = 10.0
[sensors.gps]
kind = "gps"
topic = "/fix"
position = [0.0, 0.0, 0.5]
rate = 10.0
"""


def topic_manifest(folder: Path, sensors: str = TOPIC_SENSORS) -> Path:
    """A tractor-only manifest whose sensors name topics, written to a file."""
    path = folder / "topics.toml"
    path.write_text(RUN + sensors)
    return path


def stamp(t_ns: int) -> Any:
    return STORE.types["builtin_interfaces/msg/Time"](t_ns // 10**9, t_ns % 10**9)


def header(t_ns: int, frame: str = "frame") -> Any:
    return STORE.types["std_msgs/msg/Header"](stamp(t_ns), frame)


def vector(values: Iterable[float]) -> Any:
    return STORE.types["geometry_msgs/msg/Vector3"](*map(float, values))


def imu(t_ns: int, force: Iterable[float], rate: Iterable[float], frame: str = "imu") -> Any:
    """A sensor_msgs/Imu of another implementation (rosbags)."""
    turn = STORE.types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    zeros = np.zeros(9)
    return STORE.types["sensor_msgs/msg/Imu"](
        header(t_ns, frame), turn, zeros, vector(rate), zeros, vector(force), zeros
    )


def fix(t_ns: int, status: int, variance: Iterable[float] = (0.04, 0.09, 0.25), kind: int = 2) -> Any:
    """A sensor_msgs/NavSatFix of another implementation."""
    state = STORE.types["sensor_msgs/msg/NavSatStatus"](status, 1)
    covariance = np.diag(list(variance)).ravel()
    return STORE.types["sensor_msgs/msg/NavSatFix"](header(t_ns), state, 50.0, 36.5, 120.0, covariance, kind)


def velocity(t_ns: int, east: float, north: float) -> Any:
    twist = STORE.types["geometry_msgs/msg/Twist"](vector((east, north, 0.0)), vector((0.0, 0.0, 0.0)))
    return STORE.types["geometry_msgs/msg/TwistStamped"](header(t_ns), twist)


def odometry(t_ns: int, forward: float) -> Any:
    """A nav_msgs/Odometry of another implementation: pose in `odom`, twist in the vehicle's own frame."""
    kinds, zeros = STORE.types, np.zeros(36)
    place = kinds["geometry_msgs/msg/Point"](7.0, 8.0, 9.0)
    turn = kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    pose = kinds["geometry_msgs/msg/PoseWithCovariance"](kinds["geometry_msgs/msg/Pose"](place, turn), zeros)
    twist = kinds["geometry_msgs/msg/Twist"](vector((forward, 0.5, 0.0)), vector((0.0, 0.0, 0.1)))
    moving = kinds["geometry_msgs/msg/TwistWithCovariance"](twist, zeros)
    return kinds["nav_msgs/msg/Odometry"](header(t_ns), "base_link", pose, moving)


def joints(t_ns: int, names: list[str], positions: list[float]) -> Any:
    kind = STORE.types["sensor_msgs/msg/JointState"]
    return kind(header(t_ns), names, np.array(positions, np.float64), np.zeros(0), np.zeros(0))


def write_foreign(
    path: Path,
    topics: Mapping[str, Iterable[tuple[int, Any]]],
    little_endian: bool = True,
    compression: CompressionType = CompressionType.ZSTD,
    pack: Any = bytes,
    **options: Any,
) -> None:
    """A log by the mcap package's writer: topics interleaved by log time, messages made by rosbags."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression, **options)
        writer.start(profile="ros2", library="tests")
        rows = []
        for topic, items in topics.items():
            for log_time, message in items:
                rows.append((log_time, topic, message))
        channels: dict[str, int] = {}
        for log_time, topic, message in sorted(rows, key=lambda row: row[0]):
            name = message.__msgtype__
            if topic not in channels:
                text = definition(name) if name != "std_msgs/msg/String" else "string data"
                schema = writer.register_schema(name, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            data = pack(bytes(STORE.serialize_cdr(message, name, little_endian=little_endian)))
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()


BARE: dict[str, Any] = {
    "index_types": IndexType.NONE,
    "repeat_channels": False,
    "repeat_schemas": False,
    "use_statistics": False,
    "use_summary_offsets": False,
}


def drive(count: int = 50) -> dict[str, list[tuple[int, Any]]]:
    """An IMU and a receiver of somebody else: 10 Hz, stamps 25 ms before the log time."""
    rng = np.random.default_rng(3)
    t_ns = [1_700_000_000_000_000_000 + 100_000_000 * i for i in range(count)]
    late = 25_000_000
    return {
        "/imu/data": [(t + late, imu(t, rng.normal(size=3), rng.normal(size=3))) for t in t_ns],
        "/fix": [(t + late, fix(t, 2)) for t in t_ns],
        "/vel": [(t + late, velocity(t, 0.6, 0.8)) for t in t_ns],
    }
