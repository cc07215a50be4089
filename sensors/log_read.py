"""From the topics of a recording to a pass's streams.

A log of ours holds what its streams held, exactly. Anybody's recording is read with a manifest whose sensors
name their `topic`; its samples are then put in order of their stamps, and what had to be left out is counted.
"""

from __future__ import annotations

import difflib
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .cdr import CdrError, Group, Ints, decode, message_type
from .log_topics import GNSS_EXTRAS, from_ns
from .manifest import Manifest, ManifestError, parse
from .mcap_records import McapError
from .mcap_scan import Batch, Fault, Recording, open_recording, read_messages
from .ros_messages import definition, is_known, short_name
from .streams import FieldLog, Floats, GnssStream, ImuStream, SteerStream, Stream, Warn, WheelStream

MANIFEST_NAME = "run.toml"
INGEST_NAME = "ingest.json"
NO_FIX, FIX, SBAS_FIX, GBAS_FIX = -1, 0, 1, 2  # NavSatStatus.status
RTK_FIXED_SD = 0.1  # m, horizontal: a GBAS fix better than that counts as fixed, else as float
HALF = 0.5  # of a sample's period: how far apart two topics' stamps of one instant may lie


class LogError(ValueError):
    """A log that cannot be used; the text says what, where and how to mend it, in one line."""


Values = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Topic:
    """A topic that is looked for: which types may be on it, and what is taken out of them."""

    name: str
    types: tuple[str, ...]
    take: Callable[[Group], Values]


@dataclass
class Found:
    """What a topic gave: columns `stamp` and `log` (ns) and those of `Topic.take`."""

    parts: list[Values] = field(default_factory=list)

    def column(self, name: str) -> NDArray[Any]:
        return np.concatenate([part[name] for part in self.parts])

    def __len__(self) -> int:
        return sum(len(part["stamp"]) for part in self.parts)


# -- what is taken out of each type ----------------------------------------------------------------------


def take_imu(group: Group) -> Values:
    return {
        "specific_force": group.column("linear_acceleration"),
        "angular_velocity": group.column("angular_velocity"),
    }


def take_mag(group: Group) -> Values:
    return {"magnetic_field": group.column("magnetic_field")}


def take_fix(group: Group) -> Values:
    return {
        "status": group.column("status.status"),
        "lat": group.column("latitude"),
        "lon": group.column("longitude"),
        "alt": group.column("altitude"),
        "variance": group.column("position_covariance")[:, [0, 4, 8]],
        "covariance_type": group.column("position_covariance_type"),
    }


def take_velocity(group: Group) -> Values:
    return {"east": group.column("twist.linear.x"), "north": group.column("twist.linear.y")}


def take_joints(names: Sequence[str]) -> Callable[[Group], Values]:
    """Positions of the named joints, NaN for those that a message lacks."""

    def take(group: Group) -> Values:
        n = group.rows.size
        places = _joint_places(group)
        positions = group.column("position") if places else np.empty((n, 0))
        return {name: positions[:, places[name]] if name in places else np.full(n, np.nan) for name in names}

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


def collect(recordings: Sequence[Recording], topics: Iterable[Topic]) -> tuple[dict[str, Found], list[Fault]]:
    """Columns of the topics that are there, over all files of a recording.

    Raises LogError, naming file and topic, for a type that is not expected or a message that cannot be read.
    """
    wanted = {topic.name: topic for topic in topics}
    found: dict[str, Found] = {}
    faults: list[Fault] = []
    for recording in recordings:
        faults += recording.faults
        for channel in recording.channels.values():
            if channel.topic in wanted:
                found.setdefault(channel.topic, Found())
        try:
            for item in read_messages(recording, lambda channel: channel.topic in wanted):
                if isinstance(item, Fault):
                    faults.append(item)
                else:
                    _add(found.setdefault(item.channel.topic, Found()), wanted[item.channel.topic], item)
        except (CdrError, McapError) as error:
            raise LogError(f"{recording.path}: {error}") from None
    return found, faults


def _add(found: Found, topic: Topic, batch: Batch) -> None:
    name = "" if batch.schema is None else batch.schema.name
    if short_name(name) not in topic.types:
        expected = " or ".join(topic.types)
        raise CdrError(f"topic {topic.name} holds {name or 'messages without a schema'}, not {expected}")
    kind = message_type(name, _schema_text(batch))
    try:
        for group in decode(kind, batch.payloads):
            found.parts.append(
                {
                    "stamp": group.stamp_ns("header.stamp"),
                    "log": batch.log_time[group.rows].astype(np.int64),
                    **topic.take(group),
                }
            )
    except CdrError as error:
        raise CdrError(f"topic {topic.name}, {error}") from None


def _schema_text(batch: Batch) -> str:
    """The schema's text; ours where a recorder stored none or another notation for a type that we know."""
    schema = batch.schema
    if batch.channel.message_encoding != "cdr":
        raise CdrError(
            f"topic {batch.channel.topic} is encoded as {batch.channel.message_encoding!r}, not 'cdr'"
        )
    if schema is None:
        raise CdrError(f"topic {batch.channel.topic} has no schema")
    if schema.encoding == "ros2msg" and schema.data.strip():
        return schema.data.decode(errors="replace")
    if is_known(schema.name):
        return definition(schema.name)
    raise CdrError(
        f"topic {batch.channel.topic}: schema encoding {schema.encoding!r} is not read, only 'ros2msg'"
    )


# -- streams ---------------------------------------------------------------------------------------------


def read_streams(path: Path, given: tuple[Manifest, str] | None) -> FieldLog:
    """The pass in a log (see log.read_log)."""
    try:
        recordings = [open_recording(each) for each in files_of(path)]
    except McapError as error:
        raise LogError(str(error)) from None
    manifest, text = given if given is not None else _attached_manifest(path, recordings)
    found, faults = collect(recordings, _topics(manifest))
    streams: dict[str, Stream] = {}
    warnings = [Warn(fault.what, fault.effect, file=path.name) for fault in faults]
    for name, sensor in manifest.sensors.items():
        stream = _stream(name, sensor, found, warnings)
        if stream is not None:
            streams[name] = stream
        elif sensor.topic is not None:
            raise LogError(_missing(path, name, sensor.topic, recordings))
    told = _ingest(recordings)
    before = tuple(Warn(**each) for each in told.get("warnings", ()))
    return FieldLog(
        manifest, text, streams, (*before, *warnings), told.get("health", {}), str(path), _digest(recordings)
    )


def files_of(path: Path) -> list[Path]:
    """The MCAP files of a log: the file itself."""
    return [path]


def _attached(recordings: Sequence[Recording], name: str) -> bytes | None:
    for recording in recordings:
        for attachment in recording.attachments:
            if attachment.name == name:
                return attachment.data
    return None


def _attached_manifest(path: Path, recordings: Sequence[Recording]) -> tuple[Manifest, str]:
    data = _attached(recordings, MANIFEST_NAME)
    if data is None:
        raise LogError(f"{path}: has no run.toml attached; give one with --manifest")
    text = data.decode("utf-8-sig", errors="replace")
    try:
        return parse(text, f"{path}, run.toml"), text
    except ManifestError as error:
        raise LogError(str(error)) from None


def _ingest(recordings: Sequence[Recording]) -> dict[str, Any]:
    """What ingest found when it made the log."""
    data = _attached(recordings, INGEST_NAME)
    return {} if data is None else dict(json.loads(data))


def _digest(recordings: Sequence[Recording]) -> str:
    digest = hashlib.sha256()
    for recording in recordings:
        digest.update(recording.data.data)
    return digest.hexdigest()


def _missing(path: Path, sensor: str, topic: str, recordings: Sequence[Recording]) -> str:
    there = sorted({channel.topic for recording in recordings for channel in recording.channels.values()})
    near = difflib.get_close_matches(topic, there, n=1, cutoff=0.3)
    hint = f"; did you mean {near[0]}?" if near else f"; it has {', '.join(there[:8]) or 'no topics'}"
    return f"{path}: topic {topic} of sensor {sensor} is not in the log{hint}"


def _beside(topic: str, name: str) -> str:
    """/imu/data -> /imu/mag, /fix -> /vel: the usual names of what comes with a topic."""
    return f"{topic.rsplit('/', 1)[0]}/{name}"


def _places(name: str, sensor: Any) -> dict[str, str]:
    """Where a sensor's data are, by part."""
    if sensor.kind in ("imd", "wds"):
        imu = sensor.topic or f"/{name}/imu"
        return {"imu": imu, "mag": _beside(imu, "mag")}
    if sensor.kind == "gps":
        fix = sensor.topic or f"/{name}/fix"
        return {"fix": fix, "vel": _beside(fix, "vel"), "quality": _beside(fix, "quality")}
    return {"steer": sensor.topic or f"/{name}"}


_TAKES: dict[str, tuple[tuple[str, ...], Callable[[Group], Values]]] = {
    "imu": (("sensor_msgs/Imu",), take_imu),
    "mag": (("sensor_msgs/MagneticField",), take_mag),
    "fix": (("sensor_msgs/NavSatFix",), take_fix),
    "vel": (("geometry_msgs/TwistStamped",), take_velocity),
    "quality": (("sensor_msgs/JointState",), take_joints(GNSS_EXTRAS)),
}


def _topics(manifest: Manifest) -> list[Topic]:
    found = []
    for name, sensor in manifest.sensors.items():
        for part, topic in _places(name, sensor).items():
            if part == "steer":
                joint = sensor.columns.get("angle", "steering")
                found.append(Topic(topic, ("sensor_msgs/JointState",), take_joints([joint])))
            else:
                found.append(Topic(topic, *_TAKES[part]))
    return found


def _stream(name: str, sensor: Any, found: Mapping[str, Found], warnings: list[Warn]) -> Stream | None:
    places = _places(name, sensor)
    parts = {part: found[topic] for part, topic in places.items() if topic in found}
    main = next(iter(places))
    if main not in parts or len(parts[main]) == 0:
        return None
    if main == "imu":
        return _imu(name, WheelStream if sensor.kind == "wds" else ImuStream, parts, warnings)
    if main == "fix":
        return _gnss(name, parts, warnings)
    return _steer(name, parts["steer"], sensor.columns.get("angle", "steering"), warnings)


def _in_order(name: str, found: Found, finite: Sequence[str], warnings: list[Warn]) -> tuple[Values, Ints]:
    """A topic's columns with strictly increasing stamps and finite values; what is left out is told."""
    columns = {key: found.column(key) for key in found.parts[0]}
    good = np.ones(len(found), np.bool_)
    for key in finite:
        values = columns[key]
        good &= np.isfinite(values if values.ndim == 1 else values.sum(axis=1))
    _tell(warnings, name, int((~good).sum()), "samples that are not finite numbers", "left out")
    stamp = columns["stamp"]
    rows = np.flatnonzero(good)
    back = int((np.diff(stamp[rows]) < 0).sum())
    if back or (np.diff(stamp[rows]) == 0).any():
        order = rows[np.argsort(stamp[rows], kind="stable")]
        rows = order[np.concatenate([[True], np.diff(stamp[order]) > 0])]
        _tell(warnings, name, back, "samples out of order", "sorted by their stamps")
        _tell(
            warnings,
            name,
            order.size - rows.size,
            "samples with a stamp that was there before",
            "the first was kept",
        )
    return (
        {key: values[rows] for key, values in columns.items()} if rows.size < stamp.size or back else columns
    ), rows


def _tell(warnings: list[Warn], sensor: str, count: int, what: str, effect: str) -> None:
    if count:
        warnings.append(Warn(f"{count} {what}", effect, sensor=sensor))


def _imu(name: str, kind: type[ImuStream], parts: Mapping[str, Found], warnings: list[Warn]) -> ImuStream:
    columns, _ = _in_order(name, parts["imu"], ("specific_force", "angular_velocity"), warnings)
    magnetic = None
    if "mag" in parts:
        magnetic = np.full((columns["stamp"].size, 3), np.nan)
        if len(parts["mag"]):
            mag, _ = _in_order(name, parts["mag"], (), warnings)
            here, there = _matched(columns["stamp"], mag["stamp"])
            magnetic[here] = mag["magnetic_field"][there]
    return kind(
        name, from_ns(columns["stamp"]), from_ns(columns["log"]), columns["specific_force"],
        columns["angular_velocity"], magnetic,
    )  # fmt: skip


def _matched(stamp: Ints, other: Ints) -> tuple[Ints, Ints]:
    """Pairs of rows of two increasing stamp columns that mean the same instant (nearest, half a period)."""
    period = int(np.median(np.diff(stamp))) if stamp.size > 1 else 1_000_000_000
    right = (
        np.clip(np.searchsorted(other, stamp), 1, max(other.size - 1, 1))
        if other.size > 1
        else np.zeros(stamp.size, np.int64)
    )
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(other[left] - stamp) <= np.abs(other[right] - stamp), left, right)
    here = np.flatnonzero(np.abs(other[nearest] - stamp) <= HALF * period)
    return here, nearest[here]


def _gnss(name: str, parts: Mapping[str, Found], warnings: list[Warn]) -> GnssStream:
    fix, _ = _in_order(name, parts["fix"], (), warnings)
    n = fix["stamp"].size
    values: dict[str, Floats] = {key: fix[key].astype(np.float64) for key in ("lat", "lon", "alt")}
    values |= {key: np.full(n, np.nan) for key in GnssStream.ARRAYS if key not in values}
    known = (fix["covariance_type"] > 0)[:, np.newaxis] & (fix["variance"] > 0.0)
    sd = np.sqrt(np.where(known, fix["variance"], np.nan))
    values |= dict(zip(("sd_east", "sd_north", "sd_up"), sd.T, strict=True))
    values["quality"] = _quality(fix["status"], sd)
    if len(parts.get("vel", ())):
        vel, _ = _in_order(name, parts["vel"], ("east", "north"), warnings)
        here, there = _matched(fix["stamp"], vel["stamp"])
        values["speed"][here] = np.hypot(vel["east"], vel["north"])[there]
        values["course"][here] = np.arctan2(vel["north"], vel["east"])[there]
    if len(parts.get("quality", ())):
        told, _ = _in_order(name, parts["quality"], (), warnings)
        here, there = _matched(fix["stamp"], told["stamp"])
        for key in GNSS_EXTRAS:
            values[key][here] = told[key][there]
    return GnssStream(name, from_ns(fix["stamp"]), from_ns(fix["log"]), **values)


def _quality(status: NDArray[Any], sd: Floats) -> Floats:
    """GGA fix quality of a NavSatStatus: SBAS is differential, GBAS is RTK, fixed if the sd is small."""
    horizontal = np.hypot(sd[:, 0], sd[:, 1])
    rtk = np.where(horizontal < RTK_FIXED_SD, 4.0, 5.0)
    return np.select([status == FIX, status == SBAS_FIX, status == GBAS_FIX], [1.0, 2.0, rtk], 0.0)


def _steer(name: str, found: Found, joint: str, warnings: list[Warn]) -> SteerStream | None:
    columns, _ = _in_order(name, found, (joint,), warnings)
    if columns["stamp"].size == 0:
        return None
    return SteerStream(name, from_ns(columns["stamp"]), from_ns(columns["log"]), columns[joint])
