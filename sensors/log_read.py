"""From the topics of a recording to a pass's streams.

A log of ours holds what its streams held, exactly. Anybody's recording is read with a manifest whose sensors
name their `topic`; its samples are then put in order of their stamps, and what had to be left out is counted.
"""

from __future__ import annotations

import dataclasses
import datetime as dt
import difflib
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .cdr import Group
from .health import health_of
from .log_collect import (
    Found,
    Key,
    LogError,
    Topic,
    Values,
    collect,
    take_fix,
    take_forward,
    take_imu,
    take_joints,
    take_mag,
    take_velocity,
)
from .log_streams import STEERING, checks_of, gnss_stream, imu_stream, in_order, speed_stream, steer_stream
from .log_topics import GNSS_EXTRAS, LIBRARY
from .manifest import UNDATED, Manifest, ManifestError, parse
from .mcap_records import McapError, one_line
from .mcap_scan import Fault, Recording, open_recording
from .rosbag2 import files_of
from .streams import (
    FieldLog,
    GnssStream,
    ImuStream,
    Stream,
    StreamError,
    Warn,
    WheelStream,
)

MANIFEST_NAME = "run.toml"
INGEST_NAME = "ingest.json"
TWISTS = ("geometry_msgs/TwistStamped", "geometry_msgs/TwistWithCovarianceStamped")
NEEDED = ("imd", "gps")  # kinds of sensors without which there is no pass


def read_streams(path: Path, given: tuple[Manifest, str] | None) -> FieldLog:
    """The pass in a log (see log.read_log)."""
    try:
        recordings = [open_recording(each) for each in files_of(path)]
    except McapError as error:
        raise LogError(str(error)) from None
    return streams_of(path, recordings, given)


def streams_of(path: Path, recordings: Sequence[Recording], given: tuple[Manifest, str] | None) -> FieldLog:
    """The pass in opened files; `given` overrides their manifest. Raises LogError."""
    manifest, text = given if given is not None else _attached_manifest(path, recordings)
    found, faults = collect(recordings, _topics(manifest))
    told = _ingest(recordings)
    foreign = any(recording.header.library != LIBRARY for recording in recordings)
    warnings = [Warn(one_line(fault.what), one_line(fault.effect), file=path.name) for fault in faults]
    streams: dict[str, Stream] = {}
    for name, sensor in manifest.sensors.items():
        try:
            stream = _stream(name, sensor, found, foreign, warnings)
        except StreamError as error:
            raise LogError(f"{path}: {error}") from None
        if stream is not None:
            streams[name] = stream
        elif sensor.topic is not None or sensor.kind in NEEDED:
            places = _places(name, sensor)
            raise LogError(_missing(path, name, next(iter(places.values())), recordings) + _because(faults))
        elif given is not None:
            warnings.append(Warn(f"sensor {name} is not in the log", "passed over", sensor=name))
    manifest = manifest.dated(_first_day(streams))
    before = tuple(Warn(**each) for each in told.get("warnings", ()))
    log = FieldLog(manifest, text, streams, (*before, *warnings), {}, str(path), _digest(recordings))
    return dataclasses.replace(log, health=_health(log, told.get("health", {}), bool(warnings)))


def _first_day(streams: Mapping[str, Stream]) -> dt.date:
    """UTC day of the first position, or of the first sample where there is none."""
    placed = [s.t[np.isfinite(s.lat)] for s in streams.values() if isinstance(s, GnssStream)]
    starts = [t[0] for t in (*placed, *(s.t for s in streams.values())) if t.size]
    return dt.datetime.fromtimestamp(float(starts[0]), dt.UTC).date() if starts else UNDATED


def _health(log: FieldLog, told: dict[str, Any], changed: bool) -> dict[str, Any]:
    """What ingest found, as it was; where the log was damaged since, or never ingested, what it holds now."""
    if told and not changed:
        return told
    now = health_of(log)
    return {name: told.get(name, {}) | now.get(name, {}) for name in {**told, **now}}


def _attached(recordings: Sequence[Recording], name: str) -> bytes | None:
    for recording in recordings:
        for attachment in recording.attachments:
            if attachment.name == name:
                return attachment.data
    return None


def _attached_manifest(path: Path, recordings: Sequence[Recording]) -> tuple[Manifest, str]:
    data = _attached(recordings, MANIFEST_NAME)
    if data is None:
        damage = _because([fault for recording in recordings for fault in recording.faults])
        raise LogError(f"{path}: has no run.toml attached; give one with --manifest{damage}")
    text = data.decode("utf-8-sig", errors="replace")
    try:
        return parse(text, f"{path}, run.toml"), text
    except ManifestError as error:
        raise LogError(str(error)) from None


def _ingest(recordings: Sequence[Recording]) -> dict[str, Any]:
    """What ingest found when it made the log; nothing where that cannot be read."""
    data = _attached(recordings, INGEST_NAME)
    try:
        told = json.loads(data or b"{}")
        return {"warnings": [dict(each) for each in told["warnings"]], "health": dict(told["health"])}
    except (ValueError, KeyError, TypeError):
        return {}


def _digest(recordings: Sequence[Recording]) -> str:
    digest = hashlib.sha256()
    for recording in recordings:
        for piece in recording.pieces():
            digest.update(piece)
    return digest.hexdigest()


def _missing(path: Path, sensor: str, topic: str, recordings: Sequence[Recording]) -> str:
    there = sorted({channel.topic for recording in recordings for channel in recording.channels.values()})
    near = difflib.get_close_matches(topic, there, n=1, cutoff=0.3)
    hint = f"; did you mean {near[0]}?" if near else f"; it has {', '.join(there[:8]) or 'no topics'}"
    return f"{path}: there are no messages for sensor {sensor} on topic {topic}{hint}"


def _because(faults: Sequence[Fault]) -> str:
    """Damage that may be why something is missing."""
    return f" ({faults[0].what})" if faults else ""


# -- which topics ----------------------------------------------------------------------------------------


def _beside(topic: str, name: str) -> str:
    """/imu/data -> /imu/mag, /fix -> /vel: the usual names of what comes with a topic."""
    return f"{topic.rsplit('/', 1)[0]}/{name}"


def _places(name: str, sensor: Any) -> dict[str, str]:
    """Where a sensor's data are, by part; the first part is the one that it needs."""
    if sensor.kind in ("imd", "wds"):
        imu = sensor.topic or f"/{name}/imu"
        return {"imu": imu, "mag": _beside(imu, "mag")}
    if sensor.kind == "gps":
        fix = sensor.topic or f"/{name}/fix"
        return {"fix": fix, "vel": _beside(fix, "vel"), "quality": _beside(fix, "quality")}
    if sensor.kind == "speed":
        return {"speed": sensor.topic or f"/{name}/speed"}
    return {"steer": sensor.topic or f"/{name}"}


_TAKES: dict[str, tuple[tuple[str, ...], Callable[[Group], Values] | None]] = {
    "imu": (("sensor_msgs/Imu",), take_imu),
    "mag": (("sensor_msgs/MagneticField",), take_mag),
    "fix": (("sensor_msgs/NavSatFix",), take_fix),
    "vel": (TWISTS, take_velocity),
    "speed": ((*TWISTS, "nav_msgs/Odometry"), take_forward),
    "quality": (("sensor_msgs/JointState",), take_joints({name: name for name in GNSS_EXTRAS})),
    "steer": (("sensor_msgs/JointState",), None),  # of the joint that the manifest names
}


def _joint(sensor: Any) -> str:
    """The joint that is the steering angle: `columns = { angle = "..." }` renames it in others' recordings.

    Where the sensor names a `file`, its columns are the file's, and the log is ours.
    """
    return str(sensor.columns.get("angle", "steering")) if sensor.topic is not None else "steering"


def _topics(manifest: Manifest) -> dict[Key, Topic]:
    found = {}
    for name, sensor in manifest.sensors.items():
        for i, (part, topic) in enumerate(_places(name, sensor).items()):
            types, take = _TAKES[part]
            found[name, part] = Topic(
                topic, types, take or take_joints({STEERING: _joint(sensor)}), optional=i > 0
            )
    return found


# -- streams ---------------------------------------------------------------------------------------------


def _stream(
    name: str, sensor: Any, found: Mapping[Key, Found], foreign: bool, warnings: list[Warn]
) -> Stream | None:
    """A sensor's stream, None when the part that it needs has no messages."""
    places = _places(name, sensor)
    main = next(iter(places))
    parts: dict[str, Values] = {}
    for part, topic in places.items():
        if (name, part) in found:
            columns = found[name, part].take() or {"stamp": np.empty(0, np.int64)}
            checks = checks_of(part, columns, sensor.rate, foreign)
            parts[part], told = in_order(columns, checks)
            warnings += [Warn(one_line(f"{what} on {topic}"), effect, sensor=name) for what, effect in told]
    if main not in parts or parts[main]["stamp"].size == 0:
        return None
    if main == "imu":
        return imu_stream(WheelStream if sensor.kind == "wds" else ImuStream, name, parts)
    if main == "fix":
        return gnss_stream(name, parts, foreign)
    return speed_stream(name, parts[main]) if main == "speed" else steer_stream(name, parts[main])
