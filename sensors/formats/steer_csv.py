"""CSV of a steering sensor: `t_host_ns,angle`, rad, positive to the left."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..manifest import Sensor, Steer
from ..raw import RawSteer
from ..timed_csv import read_series

ANGLE = "angle"
ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180.0}
ANGLE_LIMIT = np.pi / 2


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path, head
    return isinstance(sensor, Steer)


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawSteer:
    """The steering angles; rows that cannot be used are left out, counted and named in warnings.

    Raises RawError : a column is missing, or most rows are unusable.
    """
    del date
    beyond = "with an angle beyond 90 degrees"
    if sensor.units.angle == "rad":
        beyond += ' (taken as rad; units = { angle = "deg" } says otherwise)'
    found = read_series(path, sensor, name, ANGLE, ANGLE_UNITS[sensor.units.angle], ANGLE_LIMIT, beyond)
    return RawSteer(found.host_ns, found.rows, found.values, found.warnings)
