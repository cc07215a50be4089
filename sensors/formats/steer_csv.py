"""CSV of a steering sensor: `t_host_ns,angle`, rad, positive to the left."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..checks import SECONDS, check_host_scale, kept_rows, not_isolated, times_ns
from ..manifest import Sensor, Steer
from ..raw import RawError, RawSteer
from ..tables import find_header, parse_table, read_text

HOST, ANGLE = "t_host_ns", "angle"
ANGLE_UNITS = {"rad": 1.0, "deg": np.pi / 180.0}
ANGLE_LIMIT = np.pi / 2


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path, head
    return isinstance(sensor, Steer)


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawSteer:
    """The steering angles; rows that cannot be used are left out, counted and named in warnings."""
    del date
    data = read_text(path)
    host, angle = sensor.columns.get(HOST, HOST), sensor.columns.get(ANGLE, ANGLE)
    header = find_header(data, path.name, [host, angle])
    for column in (host, angle):
        if column not in header.names:
            raise RawError(f"{path.name}, row {header.lines}: no column '{column}'; name it in `columns`")
    table = parse_table(data, header, path.name, {host: "int", angle: "float"})
    host_ns, good = times_ns(table, host, SECONDS[sensor.units.host_time])
    check_host_scale(host_ns, table, host, sensor.units.host_time)
    angles = table.floats(angle) * ANGLE_UNITS[sensor.units.angle]
    checks = [
        ("without a usable time", good & not_isolated(host_ns, 1.0e-9)),
        ("with an empty or non-numeric value", np.isfinite(angles)),
        ("with an angle beyond 90 degrees", ~(np.abs(angles) > ANGLE_LIMIT)),
    ]
    keep, warnings = kept_rows(table, checks, name)
    return RawSteer(host_ns[keep], table.rows[keep], angles[keep], warnings)
