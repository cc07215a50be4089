"""Epochs of receivers whose files are not NMEA: put in order, checked, as `RawGnss`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .checks import rows_of
from .raw import Floats, Ints, RawError, RawGnss
from .streams import GnssStream, Warn

if TYPE_CHECKING:
    import pandas as pd

Bools = NDArray[np.bool_]
# Seconds by which GPS time is ahead of UTC, from each day (Unix s) on; IERS Bulletin C.
LEAP_DAYS = np.array(
    [915148800, 1136073600, 1230768000, 1341100800, 1435708800, 1483228800], dtype=np.float64
)
LEAP_SECONDS = np.array([13, 14, 15, 16, 17, 18], dtype=np.float64)


def utc_of_gps_time(gps: Floats) -> Floats:
    """GPS time written as Unix seconds -> UTC, for dates since 1999."""
    step = np.clip(np.searchsorted(LEAP_DAYS, gps, side="right") - 1, 0, LEAP_SECONDS.size - 1)
    return np.asarray(gps - LEAP_SECONDS[step])


def unix_seconds(moments: pd.Series[pd.Timestamp]) -> Floats:
    """UTC moments as Unix seconds, NaN where there is none."""
    micros = moments.dt.tz_localize(None).to_numpy().astype("datetime64[us]")
    seconds = micros.astype(np.int64) * 1.0e-6
    return np.where(np.isnat(micros), np.nan, seconds)


def to_yaw(compass_deg: Floats) -> Floats:
    """Compass degrees (clockwise from North) as rad counter-clockwise from East."""
    return np.asarray(np.pi / 2 - np.radians(compass_deg))


def epochs(
    utc: Floats, host_ns: Ints | None, rows: Ints, values: Mapping[str, Floats], file: str, name: str
) -> RawGnss:
    """One row an instant, in the order of UTC; impossible and repeated epochs dropped with a warning.

    values : some of `GnssStream.ARRAYS`, (N,) each; what is missing is NaN

    Raises RawError : half of the epochs or more cannot be used.
    """
    whole = {key: np.asarray(values.get(key, np.full(utc.shape, np.nan))) for key in GnssStream.ARRAYS}
    placed = np.isfinite(whole["lat"]) & np.isfinite(whole["lon"])
    usable, warnings = _usable(utc, whole, placed, rows, file, name)
    kept = np.flatnonzero(usable)
    _, first = np.unique(np.rint(utc[kept] * 1.0e3), return_index=True)
    chosen = kept[first]
    if chosen.size < kept.size:
        repeated = np.setdiff1d(kept, chosen)
        what = f"{rows_of(repeated.size)} of an instant already read"
        warnings.append(Warn(what, "dropped", name, file, int(rows[repeated[0]])))
    taken = {key: value[chosen] for key, value in whole.items()}
    no_place = ~placed[chosen]
    for key in ("lat", "lon", "alt"):
        taken[key] = np.where(no_place, np.nan, np.nan_to_num(taken[key]) if key == "alt" else taken[key])
    taken["quality"] = np.where(no_place, 0.0, np.where(np.isnan(taken["quality"]), 1.0, taken["quality"]))
    stamps = None if host_ns is None else host_ns[chosen]
    return RawGnss(
        utc[chosen], stamps, rows[chosen], taken, sentences=int(utc.size), warnings=tuple(warnings)
    )


def _usable(
    utc: Floats, values: Mapping[str, Floats], placed: Bools, rows: Ints, file: str, name: str
) -> tuple[Bools, list[Warn]]:
    """Epochs with a time and, if any, a possible position; 0, 0 is a receiver's "none"."""
    lat, lon = values["lat"], values["lon"]
    off_earth = placed & ((np.abs(lat) > 90.0) | (np.abs(lon) > 360.0) | ((lat == 0.0) & (lon == 0.0)))
    timed = np.isfinite(utc)
    usable = timed & ~off_earth
    warnings = []
    for failed, what in ((~timed, "without a usable time"), (off_earth, "with an impossible position")):
        if failed.any():
            row = int(rows[np.argmax(failed)])
            warnings.append(Warn(f"{rows_of(int(failed.sum()))} {what}", "dropped", name, file, row))
    if 2 * np.count_nonzero(usable) <= utc.size or not (usable & placed).any():
        where = f", row {rows[np.argmin(usable)]}" if rows.size and not usable.all() else ""
        raise RawError(f"{file}{where}: hardly an epoch has a time and a position; check `columns`")
    return usable, warnings


def little_endian(payload: NDArray[np.uint8], offset: int, kind: str) -> NDArray[np.float64]:
    """A field of fixed-layout binary messages: payload (N, L) bytes -> (N,) numbers of numpy type `kind`."""
    size = np.dtype(kind).itemsize
    block = np.ascontiguousarray(payload[:, offset : offset + size])
    return np.asarray(block.view(np.dtype(kind).newbyteorder("<"))[:, 0], dtype=np.float64)
