"""From the topics of a recording to a pass's streams.

A log of ours holds what its streams held, exactly. Anybody's recording is read with a manifest whose sensors
name their `topic`; its samples are then put in order of their stamps, and what had to be left out is counted.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
    take_imu,
    take_joints,
    take_mag,
    take_velocity,
)
from .log_topics import GNSS_EXTRAS, from_ns
from .manifest import Manifest, ManifestError, parse
from .mcap_records import Ints, McapError, one_line
from .mcap_scan import Fault, Recording, open_recording
from .rosbag2 import files_of
from .streams import (
    FieldLog,
    Floats,
    GnssStream,
    ImuStream,
    SteerStream,
    Stream,
    StreamError,
    Warn,
    WheelStream,
)

MANIFEST_NAME = "run.toml"
INGEST_NAME = "ingest.json"
FIX, SBAS_FIX, GBAS_FIX = 0, 1, 2  # NavSatStatus.status
RTK_FIXED_SD = 0.1  # m, horizontal: a GBAS fix better than that counts as fixed, else as float
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
    warnings = [Warn(one_line(fault.what), one_line(fault.effect), file=path.name) for fault in faults]
    streams: dict[str, Stream] = {}
    for name, sensor in manifest.sensors.items():
        try:
            stream = _stream(name, sensor, found, warnings)
        except StreamError as error:
            raise LogError(f"{path}: {error}") from None
        if stream is not None:
            streams[name] = stream
        elif sensor.topic is not None or sensor.kind in NEEDED:
            places = _places(name, sensor)
            raise LogError(_missing(path, name, next(iter(places.values())), recordings) + _because(faults))
        elif given is not None:
            warnings.append(Warn(f"sensor {name} is not in the log", "passed over", sensor=name))
    told = _ingest(recordings)
    before = tuple(Warn(**each) for each in told.get("warnings", ()))
    log = FieldLog(manifest, text, streams, (*before, *warnings), {}, str(path), _digest(recordings))
    return dataclasses.replace(log, health=_health(log, told.get("health", {}), bool(warnings)))


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
    return {"steer": sensor.topic or f"/{name}"}


_TAKES: dict[str, tuple[tuple[str, ...], Callable[[Group], Values] | None]] = {
    "imu": (("sensor_msgs/Imu",), take_imu),
    "mag": (("sensor_msgs/MagneticField",), take_mag),
    "fix": (("sensor_msgs/NavSatFix",), take_fix),
    "vel": (("geometry_msgs/TwistStamped", "geometry_msgs/TwistWithCovarianceStamped"), take_velocity),
    "quality": (("sensor_msgs/JointState",), take_joints(GNSS_EXTRAS)),
    "steer": (("sensor_msgs/JointState",), None),  # of the joint that the manifest names
}


def _joint(sensor: Any) -> str:
    """The joint that is the steering angle: `columns = { angle = "..." }` renames it."""
    return str(sensor.columns.get("angle", "steering"))


def _topics(manifest: Manifest) -> dict[Key, Topic]:
    found = {}
    for name, sensor in manifest.sensors.items():
        for i, (part, topic) in enumerate(_places(name, sensor).items()):
            types, take = _TAKES[part]
            found[name, part] = Topic(topic, types, take or take_joints([_joint(sensor)]), optional=i > 0)
    return found


# -- streams ---------------------------------------------------------------------------------------------


def _stream(name: str, sensor: Any, found: Mapping[Key, Found], warnings: list[Warn]) -> Stream | None:
    """A sensor's stream, None when the part that it needs has no messages."""
    places = _places(name, sensor)
    main = next(iter(places))
    finite = {
        "imu": ("specific_force", "angular_velocity"),
        "vel": ("east", "north"),
        "steer": (_joint(sensor),),
    }
    parts: dict[str, Values] = {}
    for part, topic in places.items():
        if (name, part) in found:
            parts[part] = _in_order(name, topic, found[name, part], finite.get(part, ()), warnings)
    if main not in parts or parts[main]["stamp"].size == 0:
        return None
    t, t_arrival = (
        from_ns(parts[main].pop(key)) if key == "log" else from_ns(parts[main][key])
        for key in ("stamp", "log")
    )
    if main == "imu":
        return _imu(WheelStream if sensor.kind == "wds" else ImuStream, name, t, t_arrival, parts)
    if main == "fix":
        return _gnss(name, t, t_arrival, parts)
    return SteerStream(name, t, t_arrival, parts["steer"][_joint(sensor)])


def _in_order(name: str, topic: str, found: Found, finite: Sequence[str], warnings: list[Warn]) -> Values:
    """A topic's columns with strictly increasing stamps and finite values; what is left out is told."""
    if len(found) == 0:
        return {"stamp": np.empty(0, np.int64)}
    columns = found.take()
    good = _finite(columns, finite)
    stamp = columns["stamp"]
    if good.all() and (np.diff(stamp) > 0).all():
        return columns
    rows = np.flatnonzero(good)
    back = int(np.count_nonzero(np.diff(stamp[rows]) < 0))
    rows = rows[np.argsort(stamp[rows], kind="stable")]
    kept = rows[np.diff(stamp[rows], prepend=np.iinfo(np.int64).min // 2) > 0]
    _tell(
        warnings, name, topic, good.size - rows.size, "messages with a value that is not finite", "left out"
    )
    _tell(warnings, name, topic, back, "messages out of order", "sorted by their stamps")
    _tell(
        warnings,
        name,
        topic,
        rows.size - kept.size,
        "messages with a stamp seen before",
        "the first was kept",
    )
    return {key: values[kept] for key, values in columns.items()}


def _finite(columns: Values, names: Sequence[str]) -> NDArray[np.bool_]:
    good = np.ones(columns["stamp"].size, np.bool_)
    for name in names:
        values = np.isfinite(columns[name])
        good &= values if values.ndim == 1 else values.all(axis=1)
    return good


def _tell(warnings: list[Warn], sensor: str, topic: str, count: int, what: str, effect: str) -> None:
    if count:
        warnings.append(Warn(one_line(f"{count} {what} on {topic}"), effect, sensor=sensor))


def _matched(stamp: Ints, other: Ints) -> tuple[Ints, Ints]:
    """Pairs of rows of two increasing stamp columns that mean the same instant.

    Equal stamps where every other stamp has its equal (one instant, two messages); else the nearest, within
    half a period.
    """
    place = np.searchsorted(other, stamp).clip(0, other.size - 1)
    here = np.flatnonzero(other[place] == stamp)
    if here.size == other.size:
        return here, place[here]
    before = np.maximum(place - 1, 0)
    nearest = np.where(np.abs(other[before] - stamp) < np.abs(other[place] - stamp), before, place)
    period = int(np.median(np.diff(stamp))) if stamp.size > 1 else 0
    here = np.flatnonzero(np.abs(other[nearest] - stamp) <= period // 2)
    return here, nearest[here]


def _imu(
    kind: type[ImuStream], name: str, t: Floats, t_arrival: Floats, parts: Mapping[str, Values]
) -> ImuStream:
    imu, magnetic = parts["imu"], None
    if "mag" in parts:
        magnetic = np.full((t.size, 3), np.nan)
        if parts["mag"]["stamp"].size:
            here, there = _matched(imu["stamp"], parts["mag"]["stamp"])
            magnetic[here] = parts["mag"]["magnetic_field"][there]
    return kind(name, t, t_arrival, imu["specific_force"], imu["angular_velocity"], magnetic)


def _gnss(name: str, t: Floats, t_arrival: Floats, parts: Mapping[str, Values]) -> GnssStream:
    fix = parts["fix"]
    values: dict[str, Floats] = {key: np.full(t.size, np.nan) for key in GnssStream.ARRAYS}
    values |= {key: fix[key].astype(np.float64) for key in ("lat", "lon", "alt")}
    known = (fix["covariance_type"] > 0)[:, np.newaxis] & (fix["variance"] > 0.0)
    sd = np.sqrt(np.where(known, fix["variance"], np.nan))
    values |= dict(zip(("sd_east", "sd_north", "sd_up"), sd.T, strict=True))
    values["quality"] = _quality(fix["status"], sd)
    vel, told = parts.get("vel", {}), parts.get("quality", {})
    if len(vel.get("stamp", ())):
        here, there = _matched(fix["stamp"], vel["stamp"])
        values["speed"][here] = np.hypot(vel["east"], vel["north"])[there]
        values["course"][here] = np.arctan2(vel["north"], vel["east"])[there]
    if len(told.get("stamp", ())):  # ours: everything that the standard messages cannot hold exactly
        here, there = _matched(fix["stamp"], told["stamp"])
        for key in GNSS_EXTRAS:
            values[key][here] = told[key][there]
    return GnssStream(name, t, t_arrival, **values)


def _quality(status: NDArray[Any], sd: Floats) -> Floats:
    """GGA fix quality of a NavSatStatus: SBAS is differential, GBAS is RTK, fixed if the sd is small."""
    horizontal = np.hypot(sd[:, 0], sd[:, 1])
    rtk = np.where(horizontal < RTK_FIXED_SD, 4.0, 5.0)
    return np.select([status == FIX, status == SBAS_FIX, status == GBAS_FIX], [1.0, 2.0, rtk], 0.0)
