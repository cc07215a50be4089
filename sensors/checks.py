"""Which rows of a table can be used: each fault is counted and named with the first row that has it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from .manifest import GRAVITY
from .raw import Floats, Ints, RawError, Rejected
from .streams import Warn
from .tables import Bools, Table

SECONDS = {"ns": 1.0e-9, "us": 1.0e-6, "ms": 1.0e-3, "s": 1.0}
AXES = ("ax", "ay", "az", "gx", "gy", "gz")
MOST = 0.5  # of the rows must be usable
YEAR_2000, YEAR_2100 = 946_684_800, 4_102_444_800
STUCK_SECONDS = 1.0  # identical readings on all axes for longer are a frozen unit
STILL_SECONDS = 10.0  # one axis that shows one value for longer, while others move
PILE = 10  # samples at an axis's extreme value, and more than this share of those just below it, are clipped
NEAR_EXTREME = 0.02
ACCEL_LIMIT = 2000.0  # m/s²: 200 g, above any unit for vehicles
GYRO_LIMIT = 150.0  # rad/s: 8600 deg/s
CLIPPED_FROM = (2.0 * GRAVITY, 2.0)  # m/s², rad/s: an extreme below this is no full scale
ISOLATED = 1.0  # s: a single stamp so far from its neighbours is corrupt


def rows_of(count: int, noun: str = "row") -> str:
    """`1 row`, `2 rows`."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def kept_rows(table: Table, checks: Sequence[tuple[str, Bools]], name: str) -> tuple[Bools, tuple[Warn, ...]]:
    """Rows that pass every check, and a warning for each kind of failure with its count and first row.

    Raises RawError when half of the rows or more fail.
    """
    warnings = list(dropped_lines(table.dropped, table.file, name))
    keep = np.ones(table.size, dtype=np.bool_)
    for what, passed in checks:
        failed = keep & ~passed
        keep &= passed
        if failed.any():
            row = int(table.rows[np.argmax(failed)])
            warnings.append(Warn(f"{rows_of(int(failed.sum()))} {what}", "dropped", name, table.file, row))
    if not keep.sum() > MOST * (table.size + len(table.dropped)):
        worst = max(warnings, key=lambda warning: int(warning.what.split()[0]), default=None)
        what = f", row {worst.row}: {worst.what} of {table.size}, too many to go on" if worst else ": no rows"
        raise RawError(f"{table.file}{what}; check the file, or `columns` and `units` in run.toml")
    return keep, tuple(warnings)


def dropped_lines(dropped: Sequence[Rejected], file: str, name: str) -> tuple[Warn, ...]:
    """One warning for each reason for which lines were dropped."""
    reasons: dict[str, list[int]] = {}
    for line in dropped:
        reasons.setdefault(line.reason, []).append(line.row)
    return tuple(
        Warn(f"{rows_of(len(rows))} {reason}", "dropped", name, file, rows[0])
        for reason, rows in reasons.items()
    )


def times_ns(table: Table, column: str, unit: float) -> tuple[Ints, Bools]:
    """A column of times in `unit` seconds as whole nanoseconds, and where it holds a usable one."""
    if table.is_whole(column):
        values, good = table.integers(column)
        scale = round(unit * 1.0e9)
        good &= np.abs(values) < 2**62 // scale
        return np.where(good, values, 0) * scale, good
    values_s = table.floats(column) * unit
    good = np.isfinite(values_s) & (np.abs(values_s) < 4.0e9)
    return np.rint(np.where(good, values_s, 0.0) * 1.0e9).astype(np.int64), good


def not_isolated(values: Ints, unit: float, span: int | None = None) -> Bools:
    """False where one value stands apart from its neighbours on both sides by more than ISOLATED seconds.

    span : where a counter wraps; its two ends are neighbours
    """
    if values.size < 5:
        return np.ones(values.size, dtype=np.bool_)
    limit = round(ISOLATED / unit)
    apart = values - median_filter(values, 5, mode="nearest")
    if span is not None:
        apart = (apart + span // 2) % span - span // 2
    return np.asarray(np.abs(apart) <= limit)


def check_host_scale(host_ns: Ints, table: Table, column: str, unit: str) -> None:
    """Raises RawError when the times are Unix times in another unit than they are said to be."""
    seconds = float(np.median(host_ns)) * 1.0e-9 if host_ns.size else 0.0
    if seconds == 0.0 or YEAR_2000 <= seconds <= YEAR_2100:
        return
    for other, size in SECONDS.items():
        if YEAR_2000 <= seconds / SECONDS[unit] * size <= YEAR_2100:
            raise RawError(
                f"{table.file}, row {table.rows[0]}: times in '{column}' look like {other}, not {unit}: "
                f'set units = {{ host_time = "{other}" }} for this sensor'
            )


def sound_readings(
    table: Table, timed: Bools, accel: Floats, gyro: Floats, rate: float, name: str
) -> tuple[Bools, tuple[Warn, ...]]:
    """Rows of an inertial unit that can be used, and what was wrong with the others.

    timed : (N,) where the row has a time; accel, gyro : (N, 3) m/s², rad/s

    Raises RawError when half of the rows or more cannot be used.
    """
    readings = np.hstack([accel, gyro])
    with np.errstate(invalid="ignore"):
        beyond = (np.abs(accel) > ACCEL_LIMIT).any(axis=1) | (np.abs(gyro) > GYRO_LIMIT).any(axis=1)
    checks = [
        ("without a usable time", timed),
        ("with an empty or non-numeric value", np.isfinite(readings).all(axis=1)),
        ("beyond what such a unit can read", ~beyond),
        ("with zero on every axis", (readings != 0.0).any(axis=1)),
        ("that repeat one reading (the unit froze)", ~frozen(readings, rate)),
    ]
    keep, dropped = kept_rows(table, checks, name)
    doubts = doubtful_axes(readings[keep], table.rows[keep], rate, table.file, name)
    return keep, (*dropped, *doubts)


def frozen(readings: Floats, rate: float) -> Bools:
    """Where all axes repeat the row before, in a run longer than STUCK_SECONDS: (N, k) readings to (N,)."""
    same = np.zeros(readings.shape[0], dtype=np.bool_)
    same[1:] = (readings[1:] == readings[:-1]).all(axis=1)
    return _long_runs(same, max(round(STUCK_SECONDS * rate), 5))


def _long_runs(flags: Bools, least: int) -> Bools:
    """The flags that stand in runs of at least `least`."""
    padded = np.concatenate([[False], flags, [False]]).astype(np.int8)
    edges = np.diff(padded)
    starts, stops = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    long = (stops - starts) >= least
    marks = np.zeros(flags.size + 1, dtype=np.int64)
    np.add.at(marks, starts[long], 1)
    np.add.at(marks, stops[long], -1)
    return np.asarray(np.cumsum(marks)[:-1] > 0)


def doubtful_axes(readings: Floats, rows: Ints, rate: float, file: str, name: str) -> list[Warn]:
    """Warnings for axes that are clipped, or stand still while the unit moves; such samples are kept.

    readings : (N, 6) m/s² and rad/s
    """
    found = []
    for column, (axis, label) in enumerate(zip(readings.T, AXES, strict=True)):
        clipped = _clipped(axis, CLIPPED_FROM[column // 3])
        if clipped.any():
            extreme = f"{label} at its extreme {np.abs(axis).max():.4g}"
            what = f"{rows_of(int(clipped.sum()), 'sample')} of {extreme}: saturated"
            row = int(rows[np.argmax(clipped)])
            found.append(Warn(what, "kept; the true values are larger", name, file, row))
        still = _long_runs(np.diff(axis, prepend=np.nan) == 0.0, max(round(STILL_SECONDS * rate), 5))
        if still.any():
            what = f"{label} shows one value for {rows_of(int(still.sum()), 'sample')} or more"
            found.append(Warn(what, "kept, but doubtful", name, file, int(rows[np.argmax(still)])))
    return found


def _clipped(axis: Floats, least: float) -> Bools:
    """Samples at the extreme, where they pile up: a smooth peak has fewer at its top than just below it."""
    if axis.size == 0:
        return np.zeros(0, dtype=np.bool_)
    size = np.abs(axis)
    top = size.max()
    at_top = size == top
    below = (size > top * (1.0 - NEAR_EXTREME)) & ~at_top
    piled = at_top.sum() >= PILE and at_top.sum() > 3 * below.sum() and top > least
    return np.asarray(at_top & bool(piled))
