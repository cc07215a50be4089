"""CSV of a GNSS receiver or phone: a time in UTC, latitude, longitude, and what else is known."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..checks import SECONDS, YEAR_2000, YEAR_2100, dropped_lines, times_ns
from ..gnss_values import epochs, to_yaw, unix_seconds
from ..manifest import Gps, Sensor
from ..raw import Floats, RawError, RawGnss
from ..tables import Header, Table, find_header, parse_table, read_text

NAMES: dict[str, tuple[str, ...]] = {
    "t": ("t", "time", "timestamp", "utc", "t_utc", "datetime"),
    "lat": ("lat", "latitude", "lat_deg"),
    "lon": ("lon", "lng", "longitude", "lon_deg"),
    "alt": ("alt", "altitude", "height", "ellipsoidal_height"),
    "quality": ("quality", "fix", "fix_quality"),
    "sd_east": ("sd_east",),
    "sd_north": ("sd_north",),
    "sd_up": ("sd_up", "verticalAccuracy"),
    "speed": ("speed",),
    "course_deg": ("course_deg", "course", "bearing", "track"),
    "heading_deg": ("heading_deg",),
    "hdop": ("hdop",),
    "satellites": ("satellites", "sats", "numSV"),
    "accuracy": ("horizontalAccuracy", "h_acc", "accuracy"),
}


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path
    plain = head.replace(b"\0", b"").lower()
    named = b"lat" in plain or bool(sensor.columns)
    return isinstance(sensor, Gps) and named and b"$g" not in plain


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawGnss:
    """The rows of a table; those without time or place are dropped with a warning.

    Raises RawError : no columns of time, latitude and longitude.
    """
    del date
    data = read_text(path)
    header = find_header(data, path.name, list(sensor.columns.values()))
    columns = _columns(path.name, header, sensor)
    host = sensor.columns.get("t_host_ns", "t_host_ns")
    kinds = dict.fromkeys(columns.values(), "float") | {columns["t"]: "int"}
    kinds |= {host: "int"} if host in header.names else {}
    table = parse_table(data, header, path.name, kinds)
    values = {key: table.floats(column) for key, column in columns.items() if key != "t"}
    for angle, key in (("course_deg", "course"), ("heading_deg", "heading")):
        if angle in values:
            compass = values.pop(angle)
            values[key] = to_yaw(np.where(compass < 0.0, np.nan, compass))  # phones say -1 for unknown
    accuracy = values.pop("accuracy", None)
    if accuracy is not None:
        values.setdefault("sd_east", accuracy / np.sqrt(2.0))
        values.setdefault("sd_north", accuracy / np.sqrt(2.0))
    stamps = times_ns(table, host, SECONDS[sensor.units.host_time])[0] if host in header.names else None
    gnss = epochs(_utc(table, columns["t"]), stamps, table.rows, values, path.name, name)
    warnings = (*dropped_lines(table.dropped, path.name, name), *gnss.warnings)
    return RawGnss(
        gnss.utc,
        gnss.host_ns,
        gnss.rows,
        gnss.values,
        table.size,
        len(table.dropped),
        table.dropped,
        warnings,
    )


def _columns(file: str, header: Header, sensor: Sensor) -> dict[str, str]:
    """The file's column for each thing known, as run.toml says or by its usual names."""
    lower = {name.lower(): name for name in reversed(header.names)}
    found = {}
    for key, usual in NAMES.items():
        names = (sensor.columns[key],) if key in sensor.columns else usual
        column = next((lower[name.lower()] for name in names if name.lower() in lower), None)
        if column is not None:
            found[key] = column
    for key in ("t", "lat", "lon"):
        if key not in found:
            shown = ", ".join(header.names)[:120]
            raise RawError(
                f"{file}, row {header.lines}: no column for {key} (it has {shown}); "
                f'name it in `columns = {{ {key} = "..." }}`'
            )
    return found


def _utc(table: Table, column: str) -> Floats:
    """Unix times in the unit that makes them dates of this century, or ISO 8601 text."""
    if table.size == 0:
        return np.zeros(0)
    ns, good = times_ns(table, column, 1.0e-9)
    if 2 * np.count_nonzero(good) < good.size:
        number = table.floats(column)
        if np.isfinite(number).sum() * 2 > number.size:
            return number
        return _iso(table, column)
    if not table.is_whole(column):
        return _scaled(table.floats(column))
    whole = _scaled(ns.astype(np.float64))
    return np.where(good, whole, np.nan)


def _scaled(number: Floats) -> Floats:
    middle = float(np.nanmedian(number))
    for size in SECONDS.values():
        if YEAR_2000 <= middle * size <= YEAR_2100:
            return np.asarray(number * size)
    return np.full(number.shape, np.nan)


def _iso(table: Table, column: str) -> Floats:
    import pandas as pd  # half a second to import, and few files need it

    text = pd.Series(table.columns[column].to_numpy(zero_copy_only=False), dtype=object)
    moment = pd.to_datetime(text, errors="coerce", utc=True, format="ISO8601")
    return unix_seconds(moment)
