"""Files of a twin: run.toml, CSVs, NMEA, and the truth beside them, as the format page has them."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .twin_clocks import ImuRecord, SteerRecord

Floats = NDArray[np.float64]

IMU_COLUMNS = ("t_host_ns", "t_dev_us", "seq", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")
IMU_FORMATS = ("%.4f",) * 3 + ("%.6f",) * 3 + ("%.4e",) * 3
TRUTH_COLUMNS = ("t", "x1", "y1", "yaw1", "v1", "x2", "y2", "yaw2", "steer")
TRUTH_FORMATS = ("%.3f", "%.5f", "%.5f", "%.7f", "%.5f", "%.5f", "%.5f", "%.7f", "%.7f")
NOTE = (
    "t: UTC s since the epoch; x, y: east, north of the CoM in the tangent plane at the origin, m; "
    "yaw: rad, ccw from east; v1: speed of the tractor's CoM along its axis, m/s; "
    "steer: mean angle of the front wheels, rad, left positive"
)


def imu_text(record: ImuRecord, columns: Iterable[str], cut_last_row: bool) -> str:
    """An IMD's or WDS's CSV; `columns` is those of IMU_COLUMNS that the logger writes."""
    wanted = tuple(columns)
    cells = [record.t_host_ns.tolist(), record.t_dev_us.tolist(), record.seq.tolist()]
    text = [[str(v) for v in column] for column in cells]
    for k in range(record.values.shape[1]):
        shown = [IMU_FORMATS[k] % v for v in record.values[:, k].tolist()]
        for row in np.flatnonzero(record.empty[:, k]):
            shown[int(row)] = ""
        text.append(shown)
    by_name = dict(zip(IMU_COLUMNS, text, strict=False))
    lines = [",".join(wanted), *(",".join(row) for row in zip(*(by_name[c] for c in wanted), strict=True))]
    if cut_last_row:
        return "\n".join(lines)[: -len(lines[-1]) // 2]
    return "\n".join(lines) + "\n"


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
