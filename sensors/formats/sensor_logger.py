"""Sensor Logger (phone): one CSV a sensor, `time,seconds_elapsed,z,y,x`; `file` names the accelerometer's.

Beside it stands Gyroscope.csv; Accelerometer.csv, which lacks gravity, needs Gravity.csv too.
"""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..checks import sound_readings, times_ns
from ..manifest import Imd, Sensor, Wds
from ..raw import Floats, Ints, RawError, RawImu
from ..tables import Table, find_header, parse_table, read_text

MARKS = ("time", "seconds_elapsed", "x", "y", "z")
GYRO, GRAVITY, MAG = "Gyroscope.csv", "Gravity.csv", "Magnetometer.csv"
WITHOUT_GRAVITY = "Accelerometer.csv"
MICRO = 1.0e-6


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path
    first = head.split(b"\n")[0].decode("utf-8", "replace")
    named = {cell.strip().strip('"') for cell in first.split(",")}
    return isinstance(sensor, Imd | Wds) and set(MARKS) <= named


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawImu:
    """Accelerometer rows, with the other sensors interpolated to their times.

    Raises RawError : a file that belongs to it is missing or no such table.
    """
    del date
    table = _table(path)
    host_ns, timed = times_ns(table, "time", 1.0e-9)
    accel = _vectors(table)
    at = (host_ns - host_ns[0]) * 1.0e-9
    if path.name == WITHOUT_GRAVITY:
        accel = accel + _beside(path, GRAVITY, at, int(host_ns[0]))
    gyro = _beside(path, GYRO, at, int(host_ns[0]))
    rate = sensor.rate if isinstance(sensor, Imd | Wds) else 100.0
    keep, warnings = sound_readings(table, timed, accel, gyro, rate, name)
    mag = None
    if (path.parent / MAG).is_file():
        mag = (_beside(path, MAG, at, int(host_ns[0])) * MICRO)[keep]
    rows = table.rows[keep]
    return RawImu(host_ns[keep], None, MICRO, None, None, rows, accel[keep], gyro[keep], mag, warnings)


def _table(path: Path) -> Table:
    data = read_text(path)
    header = find_header(data, path.name, MARKS)
    if not set(MARKS) <= set(header.names):
        raise RawError(f"{path.name}, row {header.lines}: is no file of Sensor Logger")
    table = parse_table(data, header, path.name, {"time": "int", "x": "float", "y": "float", "z": "float"})
    if table.size == 0:
        raise RawError(f"{path.name}: has no rows")
    return table


def _vectors(table: Table) -> Floats:
    return np.column_stack([table.floats(axis) for axis in "xyz"])


def _beside(path: Path, file: str, at: Floats, base: int) -> Floats:
    """Another sensor's values at the times `at` (s from `base` ns); NaN outside its recording."""
    other = path.parent / file
    if not other.is_file() or other.resolve().parent != path.resolve().parent:
        raise RawError(f"{file}: is not beside {path.name}, which needs it; export that sensor too")
    table = _table(other)
    host_ns, good = times_ns(table, "time", 1.0e-9)
    values = _vectors(table)
    good &= np.isfinite(values).all(axis=1)
    if np.count_nonzero(good) < 2:
        raise RawError(f"{file}: has hardly a usable row")
    order = _rising(host_ns, good)
    seconds = (host_ns[order] - base) * 1.0e-9
    columns = [np.interp(at, seconds, values[order, k], left=np.nan, right=np.nan) for k in range(3)]
    return np.column_stack(columns)


def _rising(host_ns: Ints, good: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Ints:
    """Good rows in the order of time, each time once."""
    rows = np.flatnonzero(good)
    _, first = np.unique(host_ns[rows], return_index=True)
    return np.asarray(rows[first], dtype=np.int64)
