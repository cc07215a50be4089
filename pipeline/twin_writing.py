"""Files of a twin: run.toml, CSVs, NMEA, and the truth beside them, as the format page has them."""

from __future__ import annotations

import datetime as dt
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .twin_clocks import ImuRecord, SteerRecord

Floats = NDArray[np.float64]

IMU_COLUMNS = ("t_host_ns", "t_dev_us", "seq", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
IMU_FORMATS = (("accel", "%.4f"),) * 3 + (("gyro", "%.6f"),) * 3 + (("mag", "%.4e"),) * 3
DEFAULT_UNITS = {"accel": "m/s2", "gyro": "rad/s", "mag": "T"}
FACTORS = {
    "m/s2": 1.0, "g": 9.80665, "rad/s": 1.0, "deg/s": math.pi / 180.0, "T": 1.0, "uT": 1e-6, "gauss": 1e-4,
}  # fmt: skip
NANOSECONDS = {"ns": 1, "us": 10**3, "ms": 10**6, "s": 10**9}
TRUTH_COLUMNS = ("t", "x1", "y1", "yaw1", "v1", "x2", "y2", "yaw2", "steer")
TRUTH_FORMATS = ("%.3f", "%.5f", "%.5f", "%.7f", "%.5f", "%.5f", "%.5f", "%.7f", "%.7f")
NOTE = (
    "t: UTC s since the epoch; x, y: east, north of the CoM in the tangent plane at the origin, m; "
    "yaw: rad, ccw from east; v1: speed of the tractor's CoM along its axis, m/s; "
    "steer: mean angle of the front wheels, rad, left positive"
)


def imu_text(record: ImuRecord, columns: Iterable[str], sensor: Mapping[str, Any], cut_last_row: bool) -> str:
    """An IMD's or WDS's CSV; `columns` is those of IMU_COLUMNS that the logger writes, `sensor` its
    table of run.toml, whose `units` and `columns` (renamed) are the file's."""
    names, wanted = sensor.get("columns", {}), tuple(columns)
    text = dict(zip(IMU_COLUMNS, _imu_cells(record, sensor.get("units", {})), strict=False))
    head = ",".join(names.get(column, column) for column in wanted)
    lines = [head, *(",".join(row) for row in zip(*(text[c] for c in wanted), strict=True))]
    if cut_last_row:
        return "\n".join(lines)[: -len(lines[-1]) // 2]
    return "\n".join(lines) + "\n"


def _imu_cells(record: ImuRecord, units: Mapping[str, str]) -> Iterator[list[str]]:
    """Text of each column in the order of IMU_COLUMNS, in the file's units."""
    yield _times(record.t_host_ns, NANOSECONDS[units.get("host_time", "ns")])
    yield _times(record.t_dev_us * 1000, NANOSECONDS[units.get("device_time", "us")])
    yield [str(v) for v in record.seq.tolist()]
    for k, (kind, digits) in enumerate(IMU_FORMATS[: record.values.shape[1]]):
        factor = FACTORS[units.get(kind, DEFAULT_UNITS[kind])]
        shown = [digits % v for v in (record.values[:, k] / factor).tolist()]
        for row in np.flatnonzero(record.empty[:, k]):
            shown[int(row)] = ""
        yield shown


def _times(ns: NDArray[np.int64], unit: int) -> list[str]:
    """Whole numbers in ns or µs; milliseconds and seconds with decimals down to the nanosecond."""
    if unit <= 1000:
        return [str(v) for v in (ns // unit).tolist()]
    digits = len(str(unit)) - 1
    return [f"{v // unit}.{v % unit:0{digits}d}" for v in ns.tolist()]


def steer_text(record: SteerRecord) -> str:
    """steer.csv."""
    rows = (
        f"{ns},{angle:.6f}\n"
        for ns, angle in zip(record.t_host_ns.tolist(), record.angle.tolist(), strict=True)
    )
    return "t_host_ns,angle\n" + "".join(rows)


def truth_text(truth: Floats) -> str:
    """truth.csv of (N, 9) rows in the order of TRUTH_COLUMNS; NaN stays empty (a tractor alone)."""
    rows = [
        ",".join("" if v != v else f % v for f, v in zip(TRUTH_FORMATS, row, strict=True))
        for row in truth.tolist()
    ]
    return "\n".join([",".join(TRUTH_COLUMNS), *rows]) + "\n"


def origin_text(lat: float, lon: float, alt: float) -> str:
    """truth_origin.json."""
    return json.dumps({"lat": lat, "lon": lon, "alt": alt, "note": NOTE}, indent=1) + "\n"


def toml_text(table: Mapping[str, Any]) -> str:
    """TOML of nested tables: plain keys first, then a header for each table (inline below two levels)."""
    return "\n".join(_toml_lines(table, ())).lstrip("\n") + "\n"


def _toml_lines(table: Mapping[str, Any], where: tuple[str, ...]) -> list[str]:
    plain = {k: v for k, v in table.items() if not _has_header(v, where)}
    lines = ["", f"[{'.'.join(_key(k) for k in where)}]"] if where and plain else []
    lines += [f"{_key(k)} = {toml_value(v)}" for k, v in plain.items()]
    for key, value in table.items():
        if key not in plain:
            lines += _toml_lines(value, (*where, key))
    return lines


def _has_header(value: Any, where: tuple[str, ...]) -> bool:
    return isinstance(value, Mapping) and (not where or where[0] in ("machine", "sensors"))


def _key(key: str) -> str:
    return key if key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key) else json.dumps(key)


def toml_value(value: Any) -> str:
    """A TOML value. Raises TypeError for what TOML lacks."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dt.date):
        return value.isoformat()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return (
            "{ " + ", ".join(f"{_key(k)} = {toml_value(v)}" for k, v in value.items()) + " }"
            if value
            else "{}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    raise TypeError(f"{type(value).__name__} has no TOML form")


def write_files(folder: Path, files: Mapping[str, str]) -> None:
    """Write each file into the folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, "utf-8")
