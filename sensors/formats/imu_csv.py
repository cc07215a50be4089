"""CSV of an inertial unit (IMD or WDS): a header line, then one row a sample."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from ..manifest import GRAVITY, Imd, Sensor, Wds
from ..raw import Floats, Ints, RawError, RawImu, Rejected
from ..streams import Warn
from ..tables import Bools, Table, as_utf8, find_header, parse_table, read_bytes

HOST, DEVICE, SEQ = "t_host_ns", "t_dev_us", "seq"
ACCEL, GYRO, MAG = ("ax", "ay", "az"), ("gx", "gy", "gz"), ("mx", "my", "mz")
SECONDS = {"ns": 1.0e-9, "us": 1.0e-6, "ms": 1.0e-3, "s": 1.0}
ACCEL_UNITS = {"m/s2": 1.0, "g": GRAVITY}
GYRO_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
MAG_UNITS = {"T": 1.0, "uT": 1.0e-6, "gauss": 1.0e-4}
ACCEL_LIMIT = 2000.0  # m/s²: 200 g, above any unit for vehicles
GYRO_LIMIT = 150.0  # rad/s: 8600 deg/s
MAG_LIMIT = 0.1  # T
MOST = 0.5  # of the rows may be unusable before the file is refused
STUCK = 1.0  # s: identical readings on all six axes for longer are a frozen unit


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path, head
    return isinstance(sensor, Imd | Wds)


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawImu:
    """The unit's rows in SI units; what cannot be used is left out, counted and named in warnings.

    Raises RawError : a column is missing, or most rows are unusable.
    """
    del date
    data = as_utf8(read_bytes(path).rstrip(b"\0"), path.name)
    names = {
        standard: sensor.columns.get(standard, standard)
        for standard in (HOST, DEVICE, SEQ, *ACCEL, *GYRO, *MAG)
    }
    header = find_header(data, path.name, [names[c] for c in (*ACCEL, *GYRO)])
    _require(path.name, names, header.names, sensor)
    present = {standard: column for standard, column in names.items() if column in header.names}
    kinds = {
        column: "int" if standard in (HOST, DEVICE, SEQ) else "float" for standard, column in present.items()
    }
    return _samples(parse_table(data, header, path.name, kinds), present, sensor, name)


def _require(file: str, names: dict[str, str], header: tuple[str, ...], sensor: Sensor) -> None:
    for standard in (HOST, *ACCEL, *GYRO):
        if names[standard] not in header:
            raise RawError(
                f"{file}, row 1: no column '{names[standard]}' (it has {', '.join(header)[:120]}); "
                f"name it in `columns = {{ {standard} = ... }}`"
            )
    for standard, column in sensor.columns.items():
        if column not in header:
            raise RawError(
                f"{file}, row 1: no column '{column}', which `columns` of run.toml gives for {standard}"
            )


def _samples(table: Table, present: dict[str, str], sensor: Sensor, name: str) -> RawImu:
    units = sensor.units
    host_ns, good = times_ns(table, present[HOST], SECONDS[units.host_time])
    counter, tick, span, counted = _counter(table, present.get(DEVICE), SECONDS[units.device_time])
    seq, numbered = table.integers(present[SEQ]) if SEQ in present else (None, None)
    accel = _vectors(table, present, ACCEL, ACCEL_UNITS[units.accel])
    gyro = _vectors(table, present, GYRO, GYRO_UNITS[units.gyro])
    mag = _vectors(table, present, MAG, MAG_UNITS[units.mag]) if all(c in present for c in MAG) else None
    checks = [
        ("without a usable time", _all(good, counted, numbered)),
        (
            "with an empty or non-numeric value",
            np.isfinite(accel).all(axis=1) & np.isfinite(gyro).all(axis=1),
        ),
        ("beyond what such a unit can read", ~_absurd(accel, gyro)),
        ("with zero on every axis", accel.any(axis=1) | gyro.any(axis=1)),
    ]
    keep, warnings = kept_rows(table, checks, name)
    if mag is not None:
        mag = np.where(np.abs(mag) < MAG_LIMIT, mag, np.nan)
        mag = None if np.isnan(mag).all() else mag[keep]
    return RawImu(
        host_ns[keep],
        None if counter is None else counter[keep],
        tick,
        span,
        None if seq is None else seq[keep],
        table.rows[keep],
        accel[keep],
        gyro[keep],
        mag,
        warnings,
    )


def _all(*masks: Bools | None) -> Bools:
    return np.logical_and.reduce([mask for mask in masks if mask is not None])


def times_ns(table: Table, column: str, unit: float) -> tuple[Ints, Bools]:
    """A column of times in `unit` seconds as whole nanoseconds, and where it holds a plausible one."""
    if table.is_whole(column):
        values, good = table.integers(column)
        scale = round(unit * 1.0e9)
        good &= np.abs(values) < 2**62 // scale
        return np.where(good, values, 0) * scale, good
    values_s = table.floats(column) * unit
    good = np.isfinite(values_s) & (np.abs(values_s) < 4.0e9)
    return np.rint(np.where(good, values_s, 0.0) * 1.0e9).astype(np.int64), good


def _counter(
    table: Table, column: str | None, unit: float
) -> tuple[Ints | None, float, int | None, Bools | None]:
    """The unit's counter as integers, its tick (s), where it wraps, where it is valid."""
    if column is None:
        return None, unit, None, None
    if not table.is_whole(column):
        values, good = times_ns(table, column, unit)
        return values, 1.0e-9, None, good
    values, good = table.integers(column)
    good &= values >= 0
    wide = good.any() and bool(np.median(values[good]) >= 2**32)
    return values, unit, None if wide else 2**32, good if wide else good & (values < 2**32)


def _vectors(table: Table, present: dict[str, str], axes: tuple[str, ...], unit: float) -> Floats:
    return np.column_stack([table.floats(present[axis]) for axis in axes]) * unit


def _absurd(accel: Floats, gyro: Floats) -> Bools:
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(accel) > ACCEL_LIMIT).any(axis=1) | (np.abs(gyro) > GYRO_LIMIT).any(axis=1))


def kept_rows(table: Table, checks: list[tuple[str, Bools]], name: str) -> tuple[Bools, tuple[Warn, ...]]:
    """Rows that pass every check, and a warning for each kind of failure with its count and first row.

    Raises RawError when fewer than half of the rows pass.
    """
    warnings = list(dropped_lines(table.dropped, table.file, name))
    keep = np.ones(table.size, dtype=np.bool_)
    for what, passed in checks:
        failed = keep & ~passed
        keep &= passed
        if failed.any():
            count, row = int(failed.sum()), int(table.rows[np.argmax(failed)])
            warnings.append(Warn(f"{count} rows {what}", "dropped", name, table.file, row))
    if not keep.sum() > MOST * table.size:
        what = warnings[-1].what if warnings else "no rows"
        row = warnings[-1].row if warnings else table.header.lines
        raise RawError(
            f"{table.file}, row {row}: {what}, of {table.size}: too many to go on; check `columns` and `units`"
        )
    return keep, tuple(warnings)


def dropped_lines(dropped: tuple[Rejected, ...], file: str, name: str) -> tuple[Warn, ...]:
    """One warning for each reason for which lines were dropped."""
    reasons: dict[str, list[int]] = {}
    for line in dropped:
        reasons.setdefault(line.reason, []).append(line.row)
    return tuple(
        Warn(f"{len(rows)} rows with {reason}", "dropped", name, file, rows[0])
        for reason, rows in reasons.items()
    )
