"""u-blox binary: NAV-PVT, with NAV-HPPOSLLH for the digits below a centimetre."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..gnss_values import epochs, little_endian, to_yaw
from ..manifest import Gps, Sensor
from ..raw import Floats, RawError, RawGnss
from ..streams import Warn
from ..tables import read_bytes

Bytes = NDArray[np.uint8]
SYNC = b"\xb5\x62"
PVT, PVT_LENGTH = b"\x01\x07", 92
HIGH, HIGH_LENGTH = b"\x01\x14", 36
FRAME = 8  # sync, class, identity, length, two bytes of checksum


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path
    return isinstance(sensor, Gps) and SYNC + PVT in head


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawGnss:
    """The epochs of a recording; frames with a wrong checksum are counted and dropped.

    Raises RawError : no NAV-PVT is sound.
    """
    del sensor, date
    data = np.frombuffer(read_bytes(path), dtype=np.uint8)
    payload, bad = frames(data, PVT, PVT_LENGTH)
    if payload.shape[0] == 0:
        raise RawError(f"{path.name}: no sound NAV-PVT message; record UBX-NAV-PVT, or NMEA")
    values = _values(payload)
    _sharpen(values, payload, frames(data, HIGH, HIGH_LENGTH)[0])
    rows = np.arange(1, payload.shape[0] + 1, dtype=np.int64)
    gnss = epochs(_utc(payload), None, rows, values, path.name, name)
    if bad == 0:
        return gnss
    warning = Warn(f"{bad} NAV-PVT messages with a wrong checksum", "dropped", name, path.name)
    return RawGnss(gnss.utc, None, gnss.rows, gnss.values, gnss.sentences, bad, (), (*gnss.warnings, warning))


def frames(data: Bytes, message: bytes, length: int) -> tuple[Bytes, int]:
    """Payloads (N, length) of all sound frames of one message, and how many were unsound.

    The checksum is Fletcher's: a = Σ byte, b = Σ a, modulo 256, from the class to the payload's end.
    """
    head = np.frombuffer(SYNC + message + length.to_bytes(2, "little"), dtype=np.uint8)
    last = data.size - length - FRAME
    if last < 0:
        return np.zeros((0, length), dtype=np.uint8), 0
    starts = np.flatnonzero(data[: last + 1] == head[0])
    for k in range(1, head.size):
        starts = starts[data[starts + k] == head[k]]
    whole = data[starts[:, None] + np.arange(length + FRAME)]
    body = whole[:, 2:-2].astype(np.int64)
    first = np.cumsum(body, axis=1)
    sound = (first[:, -1] % 256 == whole[:, -2]) & (first.sum(axis=1) % 256 == whole[:, -1])
    return whole[sound, 6:-2], int(np.count_nonzero(~sound))


def _utc(payload: Bytes) -> Floats:
    """Seconds since the epoch; NaN where the receiver calls date or time invalid."""
    year, month, day = (little_endian(payload, at, kind) for at, kind in ((4, "u2"), (6, "u1"), (7, "u1")))
    clock = [little_endian(payload, at, "u1") for at in (8, 9, 10)]
    nano = little_endian(payload, 16, "i4")
    valid = (payload[:, 11] & 3) == 3
    codes, where = np.unique(np.column_stack([year, month, day]), axis=0, return_inverse=True)
    days = np.array([_day(*(int(part) for part in code)) for code in codes])[where.ravel()]
    seconds = 3600.0 * clock[0] + 60.0 * clock[1] + clock[2] + 1.0e-9 * nano
    return np.where(valid, days * 86400.0 + seconds, np.nan)


def _day(year: int, month: int, day: int) -> float:
    try:
        return float((dt.date(year, month, day) - dt.date(1970, 1, 1)).days)
    except ValueError:
        return float("nan")


def _values(payload: Bytes) -> dict[str, Floats]:
    flags = payload[:, 21]
    carrier = flags >> 6
    quality = np.select([carrier == 2, carrier == 1, (flags & 2) != 0], [4.0, 5.0, 2.0], 1.0)
    fixed = ((flags & 1) != 0) & np.isin(payload[:, 20], (2, 3, 4))
    horizontal = little_endian(payload, 40, "u4") * 1.0e-3 / np.sqrt(2.0)
    speed = little_endian(payload, 60, "i4") * 1.0e-3
    return {
        "lat": np.where(fixed, little_endian(payload, 28, "i4") * 1.0e-7, np.nan),
        "lon": np.where(fixed, little_endian(payload, 24, "i4") * 1.0e-7, np.nan),
        "alt": np.where(fixed, little_endian(payload, 32, "i4") * 1.0e-3, np.nan),
        "quality": np.where(fixed, quality, 0.0),
        "sd_east": horizontal,
        "sd_north": horizontal,
        "sd_up": little_endian(payload, 44, "u4") * 1.0e-3,
        "speed": np.where(fixed, speed, np.nan),
        "course": np.where(fixed & (speed > 0.0), to_yaw(little_endian(payload, 64, "i4") * 1.0e-5), np.nan),
        "satellites": little_endian(payload, 23, "u1"),
    }


def _sharpen(values: dict[str, Floats], payload: Bytes, high: Bytes) -> None:
    """Replace positions by those of NAV-HPPOSLLH of the same time of week, where valid."""
    if high.shape[0] == 0:
        return
    week = little_endian(payload, 0, "u4")
    sound = high[(high[:, 3] & 1) == 0]
    _, mine, theirs = np.intersect1d(week, little_endian(sound, 4, "u4"), return_indices=True)
    mine_fixed = np.isfinite(values["lat"][mine])
    mine, sound = mine[mine_fixed], sound[theirs[mine_fixed]]
    parts = (("lon", 8, 24, 1e-7, 1e-9), ("lat", 12, 25, 1e-7, 1e-9), ("alt", 16, 26, 1e-3, 1e-4))
    for key, coarse, fine, unit, rest in parts:
        values[key][mine] = (
            little_endian(sound, coarse, "i4") * unit + little_endian(sound, fine, "i1") * rest
        )
    horizontal = little_endian(sound, 28, "u4") * 1.0e-4 / np.sqrt(2.0)
    values["sd_east"][mine] = values["sd_north"][mine] = horizontal
    values["sd_up"][mine] = little_endian(sound, 32, "u4") * 1.0e-4
