"""Gyroflow's .gcsv: key and value lines with scales, then `t,gx,gy,gz,ax,ay,az` in raw counts."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..checks import YEAR_2000, YEAR_2100, sound_readings
from ..manifest import GRAVITY, Imd, Sensor, Wds
from ..raw import RawError, RawImu
from ..tables import Table, find_header, parse_table, read_text

TITLES = (b"GYROFLOW IMU LOG", b"CAMERA IMU LOG")
TIME, GYRO, ACCEL, MAG = "t", ("gx", "gy", "gz"), ("ax", "ay", "az"), ("mx", "my", "mz")
GAUSS = 1.0e-4


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path
    return isinstance(sensor, Imd | Wds) and head.startswith(TITLES)


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawImu:
    """The unit's rows in SI units. Time is its own, from the header's `timestamp` (Unix s) on.

    The header's `orientation` is left to `rotation_deg` of run.toml.

    Raises RawError : a scale or a column is missing.
    """
    del date
    data = read_text(path)
    header = find_header(data, path.name, (TIME, *GYRO, *ACCEL))
    for column in (TIME, *GYRO, *ACCEL):
        if column not in header.names:
            raise RawError(f"{path.name}, row {header.lines}: no column '{column}'")
    present = [axis for axis in (TIME, *GYRO, *ACCEL, *MAG) if axis in header.names]
    table = parse_table(data, header, path.name, dict.fromkeys(present, "float"))
    keys = _keys(data, header.lines)
    accel = _vectors(table, ACCEL) * _scale(keys, "ascale", path.name) * GRAVITY
    gyro = _vectors(table, GYRO) * _scale(keys, "gscale", path.name)
    seconds = table.floats(TIME) * _scale(keys, "tscale", path.name)
    start = _start(keys)
    timed = np.isfinite(seconds) & (np.abs(seconds) < YEAR_2100)
    rate = sensor.rate if isinstance(sensor, Imd | Wds) else 100.0
    keep, warnings = sound_readings(table, timed, accel, gyro, rate, name)
    stamps = start + np.rint(np.where(timed, seconds, 0.0) * 1.0e9).astype(np.int64)
    mag = None
    if set(MAG) <= set(header.names) and "mscale" in keys:
        mag = (_vectors(table, MAG) * _scale(keys, "mscale", path.name) * GAUSS)[keep]
    rows = table.rows[keep]
    return RawImu(stamps[keep], None, 1.0e-6, None, None, rows, accel[keep], gyro[keep], mag, warnings)


def _vectors(table: Table, axes: tuple[str, ...]) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.column_stack([table.floats(axis) for axis in axes])


def _keys(data: bytes, lines: int) -> dict[str, str]:
    """Key and value of each line above the header."""
    above = data.decode("utf-8", "replace").splitlines()[1 : lines - 1]
    return {key.strip(): value.strip() for key, _, value in (line.partition(",") for line in above)}


def _scale(keys: dict[str, str], key: str, file: str) -> float:
    try:
        value = float(keys[key])
    except (KeyError, ValueError):
        raise RawError(f"{file}: the header has no usable `{key}`") from None
    if not 0.0 < abs(value) < 1.0e6:
        raise RawError(f"{file}: `{key}` is {value}")
    return value


def _start(keys: dict[str, str]) -> int:
    """Unix ns of the header's timestamp; 0 where it has none."""
    try:
        seconds = float(keys.get("timestamp", "nan"))
    except ValueError:
        return 0
    return round(seconds * 1.0e9) if YEAR_2000 <= seconds <= YEAR_2100 else 0
