"""From a topic's columns to streams: in order, finite, possible, and with what belongs to the same instants.

A log that we wrote was checked when its raw files were read, and comes back as it was. Others' recordings are
`foreign`: their values must be such as a sensor can read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checks import ACCEL_LIMIT, GYRO_LIMIT, frozen, rows_of
from .log_collect import Values
from .log_topics import GNSS_EXTRAS, UNKNOWN, from_ns
from .mcap_records import Ints
from .streams import Floats, GnssStream, ImuStream, SpeedStream, SteerStream

Bools = NDArray[np.bool_]
Check = tuple[str, Bools]  # what is wrong with the messages that do not pass
STEERING = "angle"  # column of the steering joint, whatever its name
NO_FIX, FIX, SBAS_FIX, GBAS_FIX = -1, 0, 1, 2  # NavSatStatus.status
RTK_FIXED_SD = 0.1  # m, horizontal: a GBAS fix better than that counts as fixed, else as float
LIMITS = {
    "imu": {"specific_force": ACCEL_LIMIT, "angular_velocity": GYRO_LIMIT},
    "vel": {"east": 150.0, "north": 150.0},  # m/s
    "steer": {STEERING: np.pi / 2.0},
    "speed": {"forward": 50.0},  # m/s
}


def checks_of(part: str, columns: Values, rate: float, foreign: bool) -> list[Check]:
    """What the messages of one part of a sensor ("imu", "vel", "steer", ...) must pass."""
    limits = {key: limit for key, limit in LIMITS.get(part, {}).items() if key in columns}
    checks = [("with a value that is not finite", _all(columns, dict.fromkeys(limits, np.inf)))]
    if foreign and limits:
        checks.append(("beyond what such a sensor can read", _all(columns, limits)))
    if foreign and part == "fix" and "lat" in columns:
        checks.append(("with an impossible position", ~_off_earth(columns)))
    if foreign and part == "imu" and limits:
        readings = np.hstack([columns[key] for key in limits])
        checks.append(("that repeat one reading (the unit froze)", ~frozen(readings, rate)))
    return checks


def _all(columns: Values, limits: Mapping[str, float]) -> Bools:
    """Where every component of these columns is finite and within its limit."""
    good = np.ones(columns["stamp"].size, np.bool_)
    for key, limit in limits.items():
        within = np.isfinite(columns[key]) & ~(np.abs(columns[key]) > limit)
        good &= within if within.ndim == 1 else within.all(axis=1)
    return good


def _off_earth(fix: Values) -> Bools:
    """Fixes where no fix can be; 0, 0 is what a driver writes that has none."""
    lat, lon = fix["lat"], fix["lon"]
    off = (np.abs(lat) > 90.0) | (np.abs(lon) > 360.0) | ((lat == 0.0) & (lon == 0.0))
    return np.asarray(off & (fix["status"] > NO_FIX))


def in_order(columns: Values, checks: Sequence[Check]) -> tuple[Values, list[tuple[str, str]]]:
    """Columns with strictly increasing stamps that pass the checks; what was wrong, and what was done."""
    stamp, told = columns["stamp"], []
    good = np.ones(stamp.size, np.bool_)
    for what, passed in checks:
        told.append((int(np.count_nonzero(good & ~passed)), what, "left out"))
        good &= passed
    if good.all() and (np.diff(stamp) > 0).all():
        return columns, []
    rows = np.flatnonzero(good)
    told.append((int(np.count_nonzero(np.diff(stamp[rows]) < 0)), "out of order", "sorted by their stamps"))
    rows = rows[np.argsort(stamp[rows], kind="stable")]
    kept = rows[np.diff(stamp[rows], prepend=np.iinfo(np.int64).min // 2) > 0]
    told.append((rows.size - kept.size, "with a stamp seen before", "the first was kept"))
    warnings = [(f"{rows_of(count, 'message')} {what}", effect) for count, what, effect in told if count]
    return {key: values[kept] for key, values in columns.items()}, warnings


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


def imu_stream(kind: type[ImuStream], name: str, parts: Mapping[str, Values]) -> ImuStream:
    """An inertial unit's samples, with those of its magnetometer at the same instants."""
    imu, magnetic = parts["imu"], None
    t, t_arrival = from_ns(imu["stamp"]), from_ns(imu.pop("log"))
    if "mag" in parts:
        magnetic = np.full((t.size, 3), np.nan)
        if parts["mag"]["stamp"].size:
            here, there = _matched(imu["stamp"], parts["mag"]["stamp"])
            magnetic[here] = parts["mag"]["magnetic_field"][there]
    return kind(name, t, t_arrival, imu["specific_force"], imu["angular_velocity"], magnetic)


def steer_stream(name: str, steer: Values) -> SteerStream:
    """The steering sensor's samples."""
    return SteerStream(name, from_ns(steer["stamp"]), from_ns(steer["log"]), steer[STEERING])


def speed_stream(name: str, speed: Values) -> SpeedStream:
    """The speed sensor's samples."""
    return SpeedStream(name, from_ns(speed["stamp"]), from_ns(speed["log"]), speed["forward"])


def gnss_stream(name: str, parts: Mapping[str, Values], foreign: bool) -> GnssStream:
    """A receiver's epochs: position and its deviations, and what other topics tell of the same instants."""
    fix = parts["fix"]
    values: dict[str, Floats] = {key: np.full(fix["stamp"].size, np.nan) for key in GnssStream.ARRAYS}
    values |= _position(fix, foreign)
    if "vel" in parts and parts["vel"]["stamp"].size:
        _put_velocity(values, fix["stamp"], parts["vel"])
    if "quality" in parts and parts["quality"]["stamp"].size:
        # ours: what the standard messages cannot hold exactly
        here, there = _matched(fix["stamp"], parts["quality"]["stamp"])
        for key in GNSS_EXTRAS:
            values[key][here] = parts["quality"][key][there]
    return GnssStream(name, from_ns(fix["stamp"]), from_ns(fix["log"]), **values)


def _position(fix: Values, foreign: bool) -> dict[str, Floats]:
    """Position, standard deviations and quality of NavSatFix columns.

    Drivers write zeros or anything where there is no fix: a foreign epoch without one has no position.
    """
    place: dict[str, Floats] = {key: fix[key].astype(np.float64) for key in ("lat", "lon", "alt")}
    known = (fix["covariance_type"] > UNKNOWN)[:, np.newaxis] & (fix["variance"] > 0.0)
    sd = np.sqrt(np.where(known & np.isfinite(fix["variance"]), fix["variance"], np.nan))
    quality = _quality(fix["status"], sd)
    if foreign:
        none = ~(np.isfinite(place["lat"]) & np.isfinite(place["lon"])) | (fix["status"] <= NO_FIX)
        place["alt"] = np.where(np.isfinite(place["alt"]), place["alt"], 0.0)  # a fix in two dimensions
        place = {key: np.where(none, np.nan, values) for key, values in place.items()}
        quality = np.where(none, 0.0, quality)
    return {**place, "sd_east": sd[:, 0], "sd_north": sd[:, 1], "sd_up": sd[:, 2], "quality": quality}


def _put_velocity(values: dict[str, Floats], stamp: Ints, vel: Values) -> None:
    here, there = _matched(stamp, vel["stamp"])
    east, north = vel["east"][there], vel["north"][there]
    values["speed"][here], values["course"][here] = np.hypot(east, north), np.arctan2(north, east)


def _quality(status: NDArray[Any], sd: Floats) -> Floats:
    """GGA fix quality of a NavSatStatus: SBAS is differential, GBAS is RTK, fixed if the sd is small."""
    horizontal = np.hypot(sd[:, 0], sd[:, 1])
    rtk = np.where(horizontal < RTK_FIXED_SD, 4.0, 5.0)
    return np.select([status == FIX, status == SBAS_FIX, status == GBAS_FIX], [1.0, 2.0, rtk], 0.0)
