"""Columns of topics, gathered over all chunks and files of a recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cdr import CdrError, Group, Layout, MessageType, decode, message_type
from .mcap_messages import Batch, read_messages
from .mcap_records import FRAME, MAX_RECORDS, MESSAGE_HEAD, McapError, one_line
from .mcap_scan import Fault, Recording
from .ros_messages import definition, is_known, short_name

Values = dict[str, NDArray[Any]]
Key = tuple[str, str]  # sensor and part: ("gps", "vel")
MAX_FAULTS = 50
FIRST_ROWS = 1024  # room made for a topic whose message count no summary tells


class LogError(ValueError):
    """A log that cannot be used; the text says what, where and how to mend it, in one line."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


@dataclass(frozen=True)
class Topic:
    """A topic that is looked for: which types may be on it, and what is taken out of them.

    An optional topic with another type on it is passed over: it is somebody else's.
    """

    name: str
    types: tuple[str, ...]
    take: Callable[[Group], Values]
    optional: bool = False


@dataclass
class Found:
    """What a topic gave: columns `stamp` and `log` (ns) and those of `Topic.take`, in file order.

    room is how many rows are expected; the arrays grow when there are more.
    """

    room: int = FIRST_ROWS
    size: int = 0
    columns: Values = field(default_factory=dict)
    layout: Layout | None = None  # of the last messages: likely that of the next

    def __len__(self) -> int:
        return self.size

    def add(self, values: Mapping[str, NDArray[Any]]) -> None:
        """Append rows. Raises CdrError when a field changes its length from one message to another."""
        stop = self.size + len(values["stamp"])
        for name, new in values.items():
            old = self.columns.get(name, np.empty((0, *new.shape[1:]), new.dtype.newbyteorder("=")))
            if old.shape[1:] != new.shape[1:]:
                raise CdrError(
                    f"{name} has {new.shape[1:]} values in one message and {old.shape[1:]} in another"
                )
            self.columns[name] = _with_room(old, self.size, max(stop, self.room))
            self.columns[name][self.size : stop] = new
        self.size = stop

    def take(self) -> Values:
        """The columns, handed over: nothing is kept here."""
        columns = {name: values[: self.size] for name, values in self.columns.items()}
        self.columns = {}
        return columns


def _with_room(old: NDArray[Any], used: int, rows: int) -> NDArray[Any]:
    if len(old) >= rows:
        return old
    grown = np.empty((max(rows, 2 * len(old)), *old.shape[1:]), old.dtype)
    grown[:used] = old[:used]
    return grown


def _numbers(group: Group, path: str, count: int | None = None) -> NDArray[Any]:
    """A column that must be (n,), or (n, count). Raises CdrError when the schema says otherwise."""
    leaf = group.layout.leaf(path)
    if leaf.dtype == "S" or leaf.count != count:
        raise CdrError(f"{group.layout.kind.name}: {path} is not what that type has there")
    return group.column(path)


def take_imu(group: Group) -> Values:
    """sensor_msgs/Imu: specific force (m/s²) and angular velocity (rad/s), (n, 3)."""
    return {
        "specific_force": _numbers(group, "linear_acceleration", 3),
        "angular_velocity": _numbers(group, "angular_velocity", 3),
    }


def take_mag(group: Group) -> Values:
    """sensor_msgs/MagneticField: field (T), (n, 3)."""
    return {"magnetic_field": _numbers(group, "magnetic_field", 3)}


def take_fix(group: Group) -> Values:
    """sensor_msgs/NavSatFix: status, degrees, m, and variances in ENU (m²), (n, 3)."""
    return {
        "status": _numbers(group, "status.status"),
        "lat": _numbers(group, "latitude"),
        "lon": _numbers(group, "longitude"),
        "alt": _numbers(group, "altitude"),
        "variance": _numbers(group, "position_covariance", 9)[:, [0, 4, 8]],
        "covariance_type": _numbers(group, "position_covariance_type"),
    }


def take_velocity(group: Group) -> Values:
    """geometry_msgs/TwistStamped or TwistWithCovarianceStamped in ENU: m/s."""
    twist = "twist" if "twist.linear.x" in group.layout.leaves else "twist.twist"
    return {"east": _numbers(group, f"{twist}.linear.x"), "north": _numbers(group, f"{twist}.linear.y")}


def take_forward(group: Group) -> Values:
    """nav_msgs/Odometry, or a twist in the vehicle's own frame: forward speed, m/s."""
    twist = "twist" if "twist.linear.x" in group.layout.leaves else "twist.twist"
    return {"forward": _numbers(group, f"{twist}.linear.x")}


def take_joints(joints: Mapping[str, str]) -> Callable[[Group], Values]:
    """Positions of the joints named for each column, NaN where a message lacks one."""

    def take(group: Group) -> Values:
        places = _joint_places(group)
        positions = group.column("position")
        missing = np.full(group.rows.size, np.nan)
        return {
            column: positions[:, places[name]] if places.get(name, np.inf) < positions.shape[1] else missing
            for column, name in joints.items()
        }

    return take


def _joint_places(group: Group) -> dict[str, int]:
    """Place of each joint in `position`. Raises CdrError when names change between messages of one layout."""
    count = sum(1 for path in group.layout.leaves if path.startswith("name."))
    places = {}
    for i in range(count):
        names = group.column(f"name.{i}")
        if not (names == names[0]).all():
            raise CdrError(f"{group.layout.kind.name}: joint {i} changes its name from message to message")
        places[names[0].decode(errors="replace")] = i
    return places


# -- collecting ------------------------------------------------------------------------------------------


def collect(
    recordings: Sequence[Recording], topics: Mapping[Key, Topic]
) -> tuple[dict[Key, Found], list[Fault]]:
    """Columns of the topics that are there, over all files of a recording, and what was damaged.

    topics are looked for under keys of the caller's; several keys may look at one topic.
    Raises LogError, naming file and topic, for a type that is not expected or a message that cannot be read.
    """
    found: dict[Key, Found] = {}
    faults: list[Fault] = []
    for recording in recordings:
        _make_room(found, recordings, recording, topics)
        try:
            faults += _collect_one(recording, topics, found)
        except (CdrError, McapError) as error:
            raise LogError(f"{recording.path}: {error}") from None
    return found, _few(faults)


def _collect_one(recording: Recording, topics: Mapping[Key, Topic], found: dict[Key, Found]) -> list[Fault]:
    """Add one file's messages to what was found; what is damaged in it."""
    names = {topic.name for topic in topics.values()}
    faults = list(recording.faults)
    read: Counter[int] = Counter()
    for item in read_messages(recording, lambda channel: channel.topic in names):
        if isinstance(item, Fault):
            faults.append(item)
            continue
        read[item.channel.id] += len(item.payloads)
        for key, topic in topics.items():
            if topic.name == item.channel.topic:
                _add(found.setdefault(key, Found()), topic, item)
    return faults or list(_miscounted(recording, read, names))


def _miscounted(recording: Recording, read: Mapping[int, int], names: Collection[str]) -> Iterator[Fault]:
    """Channels of which the summary tells another number of messages than were there."""
    told = {} if recording.statistics is None else recording.statistics.channel_message_counts
    for key, count in told.items():
        channel = recording.channels.get(key)
        if channel is not None and channel.topic in names and read.get(key, 0) != count:
            what = f"the summary tells of {count} messages on {channel.topic}, {read.get(key, 0)} are there"
            yield Fault(what, "those that are there were used")


def _few(faults: list[Fault]) -> list[Fault]:
    """Faults that a person can still read: the first ones, and how many more there are."""
    if len(faults) <= MAX_FAULTS:
        return faults
    return [*faults[:MAX_FAULTS], Fault(f"{len(faults) - MAX_FAULTS} more of the kind", "see those before")]


def _make_room(
    found: dict[Key, Found], all_of_it: Sequence[Recording], one: Recording, topics: Mapping[Key, Topic]
) -> None:
    """A topic that has a channel but no messages is there too."""
    there = {channel.topic for channel in one.channels.values()}
    for key, topic in topics.items():
        if topic.name in there and key not in found:
            found[key] = Found(_room(all_of_it, topic.name))


def _room(recordings: Sequence[Recording], topic: str) -> int:
    """Rows to make room for: what the summaries tell, but never more than the bytes could hold."""
    told = possible = 0
    for recording in recordings:
        counts = {} if recording.statistics is None else recording.statistics.channel_message_counts
        told += sum(
            counts.get(key, 0) for key, channel in recording.channels.items() if channel.topic == topic
        )
        size = recording.data.size + sum(chunk.uncompressed_size for chunk in recording.chunks)
        possible += size // (FRAME + MESSAGE_HEAD)
    return min(told, possible, MAX_RECORDS) or FIRST_ROWS


def _add(found: Found, topic: Topic, batch: Batch) -> None:
    if topic.optional and (batch.schema is None or short_name(batch.schema.name) not in topic.types):
        return
    kind = _kind(topic, batch)
    log_time = batch.log_time.astype(np.int64)
    try:
        for group in decode(kind, batch.payloads, found.layout):
            found.layout = group.layout
            log = log_time[group.rows]
            stamp = group.stamp_ns("header.stamp")
            # many publishers leave the stamp at zero
            found.add({"stamp": np.where(stamp == 0, log, stamp), "log": log, **topic.take(group)})
    except CdrError as error:
        raise CdrError(f"topic {topic.name}, {error}") from None


def _kind(topic: Topic, batch: Batch) -> MessageType:
    """The type of a batch's messages. Raises CdrError for one that is unexpected or cannot be read."""
    schema, encoding = batch.schema, batch.channel.message_encoding
    name = "messages without a schema" if schema is None else schema.name
    if schema is None or short_name(name) not in topic.types:
        raise CdrError(f"topic {topic.name} holds {name}, not {' or '.join(topic.types)}")
    if encoding != "cdr":
        raise CdrError(f"topic {topic.name} is encoded as {encoding!r}; only 'cdr' (ROS 2) is read")
    if schema.encoding == "ros2msg" and schema.data.strip():
        return message_type(name, schema.data.decode(errors="replace"))
    if is_known(name):  # recorders that store no text, or another notation, for a type whose fields we know
        return message_type(name, definition(name))
    raise CdrError(f"topic {topic.name}: its schema is in {schema.encoding!r}; only 'ros2msg' is read")
