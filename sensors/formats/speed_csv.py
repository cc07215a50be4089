"""CSV of a wheel's or the vehicle's speed: `t_host_ns,speed`, m/s, or a wheel's rotation in rad/s or rpm."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..checks import GYRO_LIMIT
from ..manifest import Sensor, Speed
from ..raw import RawSpeed
from ..timed_csv import read_series

SPEED = "speed"
SPEED_UNITS = {"m/s": 1.0, "mm/s": 1.0e-3, "km/h": 1.0 / 3.6, "mph": 0.44704}
TURN_UNITS = {"rad/s": 1.0, "rpm": np.pi / 30.0}
SPEED_LIMIT = 50.0  # m/s: no tractor is faster; a bus's "not available" (65.5 m/s in ISO 11783) lies beyond


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path, head
    return isinstance(sensor, Speed)


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawSpeed:
    """The speeds; rows that cannot be used are left out, counted and named in warnings.

    Raises RawError : a column is missing, or most rows are unusable.
    """
    del date
    unit = sensor.units.speed
    if unit in TURN_UNITS:
        scale, limit, beyond = TURN_UNITS[unit], GYRO_LIMIT, f"beyond {GYRO_LIMIT:.0f} rad/s"
    else:
        scale, limit, beyond = SPEED_UNITS[unit], SPEED_LIMIT, f"beyond {SPEED_LIMIT:.0f} m/s"
    found = read_series(path, sensor, name, SPEED, scale, limit, f"with a speed {beyond} (taken as {unit})")
    return RawSpeed(found.host_ns, found.rows, found.values, unit in TURN_UNITS, found.warnings)
