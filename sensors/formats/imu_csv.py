"""CSV of an inertial unit (IMD or WDS): a header line, then one row a sample."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..checks import SECONDS, check_host_scale, not_isolated, sound_readings, times_ns
from ..manifest import GRAVITY, Imd, Sensor, Units, Wds
from ..presets import PRESETS
from ..raw import Floats, Ints, RawError, RawImu
from ..streams import Warn
from ..tables import Bools, Header, Table, find_header, parse_table, read_text

HOST, DEVICE, SEQ = "t_host_ns", "t_dev_us", "seq"
ACCEL, GYRO, MAG = ("ax", "ay", "az"), ("gx", "gy", "gz"), ("mx", "my", "mz")
WHOLE = (HOST, DEVICE, SEQ)
COLUMNS = (*WHOLE, *ACCEL, *GYRO, *MAG)
ACCEL_UNITS = {"m/s2": 1.0, "g": GRAVITY}
GYRO_UNITS = {"rad/s": 1.0, "deg/s": np.pi / 180.0}
MAG_UNITS = {"T": 1.0, "uT": 1.0e-6, "gauss": 1.0e-4}
MAG_LIMIT = 0.1  # T
SPAN = 2**32


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path, head
    return isinstance(sensor, Imd | Wds)


@dataclass(frozen=True)
class Layout:
    """Which columns of the file mean what, and in which units."""

    columns: Mapping[str, str]
    units: Units
    preset: str | None = None


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawImu:
    """The unit's rows in SI units; what cannot be used is left out, counted and named in warnings.

    Raises RawError : a column is missing, or most rows are unusable.
    """
    del date
    data = read_text(path)
    header, layout = find_layout(data, path.name, sensor)
    kinds = {column: "int" if key in WHOLE else "float" for key, column in layout.columns.items()}
    rate = sensor.rate if isinstance(sensor, Imd | Wds) else 100.0
    return _samples(parse_table(data, header, path.name, kinds), layout, rate, name)


def find_layout(data: bytes, file: str, sensor: Sensor) -> tuple[Header, Layout]:
    """The header, and the columns by standard name: as run.toml says, or those of a well-known logger.

    Raises RawError : a column is missing.
    """
    names = {key: sensor.columns.get(key, key) for key in COLUMNS}
    wanted = [names[key] for key in (*ACCEL, *GYRO)]
    header = find_header(data, file, wanted)
    if not sensor.columns and not set(wanted) <= set(header.names):
        for preset in PRESETS:
            other = find_header(data, file, preset.columns.values())
            if set(preset.columns.values()) <= set(other.names):
                stated = sensor.units.model_dump(exclude_unset=True)
                return other, Layout(preset.columns, Units(**(dict(preset.units) | stated)), preset.name)
    _require(file, names, header, sensor)
    present = {key: column for key, column in names.items() if column in header.names}
    return header, Layout(present, sensor.units)


def _require(file: str, names: Mapping[str, str], header: Header, sensor: Sensor) -> None:
    for key, column in sensor.columns.items():
        if column not in header.names:
            where = f"{file}, row {header.lines}"
            raise RawError(f"{where}: no column '{column}', which `columns` of run.toml gives for {key}")
    for key in (*ACCEL, *GYRO):
        if names[key] not in header.names:
            shown = ", ".join(header.names)[:120]
            raise RawError(
                f"{file}, row {header.lines}: no column '{names[key]}' (it has {shown}); "
                f'name it in `columns = {{ {key} = "..." }}`'
            )
    if names[HOST] not in header.names and names[DEVICE] not in header.names:
        raise RawError(f"{file}, row {header.lines}: no column of time; name it in `columns`")


def _samples(table: Table, layout: Layout, rate: float, name: str) -> RawImu:
    times, timed, warnings = _times(table, layout, name)
    accel = _vectors(table, layout, ACCEL) * ACCEL_UNITS[layout.units.accel]
    gyro = _vectors(table, layout, GYRO) * GYRO_UNITS[layout.units.gyro]
    keep, faults = sound_readings(table, timed, accel, gyro, rate, name)
    return RawImu(
        times.host_ns[keep],
        None if times.counter is None else times.counter[keep],
        times.tick,
        times.span,
        None if times.seq is None else times.seq[keep],
        table.rows[keep],
        accel[keep],
        gyro[keep],
        _magnetic(table, layout, keep),
        (*warnings, *faults),
    )


@dataclass(frozen=True)
class _Times:
    host_ns: Ints
    counter: Ints | None
    tick: float
    span: int | None
    seq: Ints | None


def _times(table: Table, layout: Layout, name: str) -> tuple[_Times, Bools, list[Warn]]:
    """Clocks of the rows, and where they can be used; without a host column the counter is the clock."""
    columns, units = layout.columns, layout.units
    seq, good = None, np.ones(table.size, dtype=np.bool_)
    if SEQ in columns:
        seq, good = table.integers(columns[SEQ])
    counter, tick, span = None, SECONDS[units.device_time], None
    if DEVICE in columns:
        counter, tick, span, counted = _counter(table, columns[DEVICE], tick)
        good = good & counted
    if HOST not in columns:
        return (
            _Times(_from_counter(counter, tick, span), None, tick, None, seq),
            good,
            [Warn("no column of the logger's time", "the unit's counter is the clock", name, table.file)],
        )
    host_ns, stamped = times_ns(table, columns[HOST], SECONDS[units.host_time])
    good = good & stamped & not_isolated(host_ns, 1.0e-9)
    check_host_scale(host_ns, table, columns[HOST], units.host_time)
    return _Times(host_ns, counter, tick, span, seq), good, []


def _from_counter(counter: Ints | None, tick: float, span: int | None) -> Ints:
    """Nanoseconds of a counter that is the only clock; wraps taken out step by step."""
    if counter is None:
        raise RawError("no column of time")
    if span is not None:
        step = (np.diff(counter) + span // 2) % span - span // 2
        counter = np.concatenate([counter[:1], counter[0] + np.cumsum(step)])
    return counter * round(tick * 1.0e9)


def _counter(table: Table, column: str, unit: float) -> tuple[Ints, float, int | None, Bools]:
    """The unit's counter as integers, its tick (s), where it wraps (None: it is wider), where it is valid."""
    if not table.is_whole(column):
        values, good = times_ns(table, column, unit)
        return values, 1.0e-9, None, good
    values, good = table.integers(column)
    good &= values >= 0
    wide = bool(good.any()) and bool(np.median(values[good]) >= SPAN)
    if wide:
        return values, unit, None, good & not_isolated(values, unit)
    return values, unit, SPAN, good & (values < SPAN) & not_isolated(values, unit, SPAN)


def _vectors(table: Table, layout: Layout, axes: tuple[str, ...]) -> Floats:
    return np.column_stack([table.floats(layout.columns[axis]) for axis in axes])


def _magnetic(table: Table, layout: Layout, keep: Bools) -> Floats | None:
    """Magnetic field of the kept rows, NaN where it is absent or absurd; None when it is so everywhere."""
    if not all(axis in layout.columns for axis in MAG):
        return None
    field = _vectors(table, layout, MAG)[keep] * MAG_UNITS[layout.units.mag]
    field = np.where(np.abs(field) < MAG_LIMIT, field, np.nan)
    return None if np.isnan(field).all() else field
