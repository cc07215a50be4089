"""CSV of one quantity over time, as signals of a CAN bus are exported: a time and a value, in any columns."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .checks import SECONDS, check_host_scale, kept_rows, not_isolated, times_ns
from .manifest import Sensor
from .raw import Floats, Ints, RawError
from .streams import Warn
from .tables import find_header, parse_table, read_text

HOST = "t_host_ns"


@dataclass(frozen=True)
class Series:
    """Rows that can be used: host_ns (N,), rows (N,) lines of the file, values (N,), and what was left out."""

    host_ns: Ints
    rows: Ints
    values: Floats
    warnings: tuple[Warn, ...]


def read_series(
    path: Path, sensor: Sensor, name: str, value: str, scale: float, limit: float, beyond: str
) -> Series:
    """The rows of a time and of column `value` (as `columns` renames it) times `scale`.

    limit : largest absolute value that can be, and `beyond` how such a row is told of

    Raises RawError : a column is missing, or most rows are unusable.
    """
    data = read_text(path)
    host, column = sensor.columns.get(HOST, HOST), sensor.columns.get(value, value)
    header = find_header(data, path.name, [host, column])
    for each in (host, column):
        if each not in header.names:
            raise RawError(f"{path.name}, row {header.lines}: no column '{each}'; name it in `columns`")
    table = parse_table(data, header, path.name, {host: "int", column: "float"})
    host_ns, good = times_ns(table, host, SECONDS[sensor.units.host_time])
    check_host_scale(host_ns, table, host, sensor.units.host_time)
    values = table.floats(column) * scale
    checks = [
        ("without a usable time", good & not_isolated(host_ns, 1.0e-9)),
        ("with an empty or non-numeric value", np.isfinite(values)),
        (beyond, ~(np.abs(values) > limit)),
    ]
    keep, warnings = kept_rows(table, checks, name)
    return Series(host_ns[keep], table.rows[keep], values[keep], warnings)
