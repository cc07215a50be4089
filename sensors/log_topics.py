"""What goes into an MCAP log: channels of ROS 2 messages given as columns, and those of a pass's streams.

    channel = Channel("/fused/tractor", "nav_msgs/msg/Odometry", t_ns, messages(
        "nav_msgs/msg/Odometry", {"header": {"frame_id": "map"}, "child_frame_id": "tractor"},
        {**stamp_columns("header.stamp", t_ns), "pose.pose.position.x": x, ...}))

The first mapping is one message, nested as the definition is: its strings and the lengths of its sequences
hold for all messages. The second holds columns by dotted path, (n,) or (n, k). Nothing is serialised before
the writer asks for rows, a chunk at a time. Messages whose lengths change are given as a list of bytes
(`cdr.serialise`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cdr import Template, encode, make_template, message_type, stamp_columns
from .mcap_records import Bytes, Ints
from .ros_messages import definition
from .streams import FieldLog, Floats, GnssStream, ImuStream, SpeedStream, SteerStream

LIBRARY = "smts-validate"  # in the header of logs that we wrote
GNSS_EXTRAS = ("quality", "hdop", "satellites", "speed", "course", "heading", "sd_east", "sd_north", "sd_up")
STATUS = {0: -1, 1: 0, 2: 1, 4: 2, 5: 2, 6: -1}  # GGA fix quality -> NavSatStatus.status
UNKNOWN, DIAGONAL_KNOWN = 0, 2  # NavSatFix.position_covariance_type
SERVICE_GPS = 1


@dataclass(frozen=True)
class Columns:
    """n messages of one layout: a template and the columns that change, each (n,) or (n, k)."""

    template: Template
    columns: Mapping[str, NDArray[Any]]
    n: int

    def __len__(self) -> int:
        return self.n

    def rows(self, start: int, stop: int) -> Bytes:
        """Serialised messages start..stop, (stop - start, length) bytes."""
        part = {path: values[start:stop] for path, values in self.columns.items()}
        return encode(self.template, part, stop - start)


@dataclass(frozen=True)
class Channel:
    """One topic's messages. log_time_ns: (n,) ns since the epoch; publish_time_ns: the same when None.

    messages are `Columns`, or serialised CDR payloads; schema_text defaults to the known definition.
    """

    topic: str
    schema_name: str
    log_time_ns: Ints
    messages: Columns | Sequence[bytes]
    publish_time_ns: Ints | None = None
    schema_text: str | None = None
    metadata: Mapping[str, str] = field(default_factory=lambda: {"offered_qos_profiles": ""})

    @property
    def text(self) -> str:
        """The channel's `ros2msg` schema."""
        return definition(self.schema_name) if self.schema_text is None else self.schema_text


def messages(schema_name: str, values: Mapping[str, Any], columns: Mapping[str, NDArray[Any]]) -> Columns:
    """Messages of a known type: `values` is one message (see the module), `columns` what changes.

    Raises CdrError for a field that the type lacks, ValueError for columns of different lengths.
    """
    sizes = {len(column) for column in columns.values()}
    if len(sizes) != 1:
        raise ValueError(f"{schema_name}: columns have different lengths: {sorted(sizes)}")
    kind = message_type(schema_name, definition(schema_name))
    return Columns(make_template(kind, values), dict(columns), sizes.pop())


def to_ns(t: Floats) -> Ints:
    """Nanoseconds since the epoch of float seconds.

    The whole seconds are split off first: t * 1e9 would round by 128 ns. `from_ns` gives back the same float
    for any |t| above 97 days (2^23 s), below which a float64 of seconds is finer than 1 ns.
    """
    seconds = np.floor(t)
    return seconds.astype(np.int64) * 1_000_000_000 + np.rint((t - seconds) * 1e9).astype(np.int64)


def from_ns(t_ns: Ints) -> Floats:
    """Float seconds since the epoch, the nearest float64 to within 1e-9 s."""
    seconds = t_ns // 1_000_000_000
    return np.asarray(seconds + (t_ns - seconds * 1_000_000_000) * 1e-9, dtype=np.float64)


def channels_of(log: FieldLog) -> list[Channel]:
    """A pass's streams as channels, each stream's own topics one after the other."""
    found: list[Channel] = []
    for name, stream in log.streams.items():
        if isinstance(stream, ImuStream):
            found += imu_channels(name, stream)
        elif isinstance(stream, GnssStream):
            found += _gnss_channels(name, stream)
        elif isinstance(stream, SpeedStream):
            found.append(_speed_channel(name, stream))
        else:
            found.append(_steer_channel(name, stream))
    return found


def _channel(
    topic: str,
    kind: str,
    stream: ImuStream | GnssStream | SteerStream | SpeedStream,
    values: Mapping[str, Any],
    columns: Mapping[str, NDArray[Any]],
    rows: NDArray[np.bool_] | None = None,
) -> Channel:
    """Messages with the stream's name as frame_id, its t as stamp, its t_arrival as log time."""
    keep = slice(None) if rows is None else rows
    t_ns, arrival_ns = to_ns(stream.t[keep]), to_ns(stream.t_arrival[keep])
    header = {"header": {"frame_id": stream.name}}
    every = {**stamp_columns("header.stamp", t_ns), **columns}
    return Channel(topic, kind, arrival_ns, messages(kind, {**header, **values}, every), t_ns)


def imu_channels(name: str, stream: ImuStream) -> list[Channel]:
    """A unit's samples, and its magnetometer's where it has one."""
    without_orientation = {"orientation": {"w": 1.0}, "orientation_covariance": [-1.0] + [0.0] * 8}
    columns = {"angular_velocity": stream.angular_velocity, "linear_acceleration": stream.specific_force}
    found = [_channel(f"/{name}/imu", "sensor_msgs/msg/Imu", stream, without_orientation, columns)]
    if stream.magnetic_field is not None:
        # a channel without messages still says that there is a magnetometer
        there = np.asarray(np.isfinite(stream.magnetic_field).any(axis=1))
        field_ = {"magnetic_field": stream.magnetic_field[there]}
        found.append(_channel(f"/{name}/mag", "sensor_msgs/msg/MagneticField", stream, {}, field_, there))
    return found


def _gnss_channels(name: str, stream: GnssStream) -> list[Channel]:
    moving = np.isfinite(stream.speed) & np.isfinite(stream.course)
    heading = np.isfinite(stream.heading)
    velocity = {
        "twist.linear.x": (stream.speed * np.cos(stream.course))[moving],
        "twist.linear.y": (stream.speed * np.sin(stream.course))[moving],
    }
    turn = {
        "quaternion.z": np.sin(stream.heading / 2)[heading],
        "quaternion.w": np.cos(stream.heading / 2)[heading],
    }
    extras = {"position": np.column_stack([getattr(stream, each) for each in GNSS_EXTRAS])}
    names = {"name": list(GNSS_EXTRAS), "position": [0.0] * len(GNSS_EXTRAS)}
    found = [
        _channel(
            f"/{name}/fix",
            "sensor_msgs/msg/NavSatFix",
            stream,
            {"status": {"service": SERVICE_GPS}},
            _fix(stream),
        ),
        _channel(f"/{name}/vel", "geometry_msgs/msg/TwistStamped", stream, {}, velocity, moving),
        _channel(f"/{name}/quality", "sensor_msgs/msg/JointState", stream, names, extras),
    ]
    if heading.any():
        found.append(
            _channel(f"/{name}/heading", "geometry_msgs/msg/QuaternionStamped", stream, {}, turn, heading)
        )
    return found


def _fix(stream: GnssStream) -> dict[str, NDArray[Any]]:
    """Columns of NavSatFix: covariance in ENU, known where any standard deviation is."""
    sd = np.column_stack([stream.sd_east, stream.sd_north, stream.sd_up])
    known = np.asarray(np.isfinite(sd).any(axis=1))
    covariance = np.zeros((stream.t.size, 9))
    covariance[:, [0, 4, 8]] = np.where(known[:, np.newaxis], sd**2, 0.0)
    status = np.full(stream.t.size, -1, np.int8)
    for quality, value in STATUS.items():
        status[stream.quality == quality] = value
    return {
        "status.status": status,
        "latitude": stream.lat,
        "longitude": stream.lon,
        "altitude": stream.alt,
        "position_covariance": covariance,
        "position_covariance_type": np.where(known, DIAGONAL_KNOWN, UNKNOWN),
    }


def _speed_channel(name: str, stream: SpeedStream) -> Channel:
    """Forward along the wheel's heading: in the frame of the sensor, not in ENU as a receiver's velocity."""
    columns = {"twist.linear.x": stream.speed}
    return _channel(f"/{name}/speed", "geometry_msgs/msg/TwistStamped", stream, {}, columns)


def _steer_channel(name: str, stream: SteerStream) -> Channel:
    columns = {"position": stream.angle[:, np.newaxis]}
    return _channel(
        f"/{name}", "sensor_msgs/msg/JointState", stream, {"name": ["steering"], "position": [0.0]}, columns
    )
