"""Measured and simulated motion over distance, as the figures of a pass show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..report_view import Columns, PassView
from ._common import ROW_GAP

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Track:
    """One body over joined distance x (m): deviation n (m), heading to the line (rad), sds where known."""

    x: Floats
    n: Floats
    yaw: Floats
    sd_n: Floats
    sd_yaw: Floats


def measured(view: PassView, b: str) -> Track:
    """The fused motion of body `b` inside rows, broken between rows."""
    t = view.trajectory
    return _track(view, b, t, t[f"sd_n{b}"], t[f"sd_yaw{b}"], np.zeros(t["t"].size))


def simulated(view: PassView, b: str) -> Track | None:
    """The model's motion of body `b`, broken between rows and windows; None where nothing was simulated."""
    columns = view.simulation
    if not np.isfinite(columns[f"n{b}"]).any():
        return None
    nothing = np.full(columns["t"].size, np.nan)
    return _track(view, b, columns, nothing, nothing, np.nan_to_num(columns["window"], nan=-1.0))


def _track(view: PassView, b: str, values: Columns, sd_n: Floats, sd_yaw: Floats, window: Floats) -> Track:
    inside = values["row"] >= 0
    x = joined_distance(view, values["row"], values[f"s{b}"])[inside]
    yaw = relative_yaw(view, values["row"], values[f"yaw{b}"])[inside]
    joins = np.flatnonzero(np.diff(values["row"][inside]) + np.diff(window[inside])) + 1
    columns = (values[f"n{b}"][inside], yaw, sd_n[inside], sd_yaw[inside])
    # A sample that is not there breaks the line where one row or window ends and the next begins.
    return Track(np.insert(x, joins, x[joins]), *(np.insert(column, joins, np.nan) for column in columns))


def row_starts(view: PassView) -> dict[int, tuple[float, float]]:
    """By row: chainage in m at which the tractor enters it, and where the joined axis begins it."""
    t, found, offset = view.trajectory, {}, 0.0
    for row in view.row_indices:
        s = t["s1"][t["row"] == row]
        low, high = float(np.nanmin(s)), float(np.nanmax(s))
        found[row] = (low, offset)
        offset += high - low + ROW_GAP
    return found


def joined_distance(view: PassView, row: Floats, s: Floats) -> Floats:
    """Distance with the rows laid end to end, each from where the tractor enters it; NaN outside rows."""
    joined = np.full(s.size, np.nan)
    for index, (start, offset) in row_starts(view).items():
        inside = row == index
        joined[inside] = s[inside] - start + offset
    return joined


def relative_yaw(view: PassView, row: Floats, yaw: Floats) -> Floats:
    """Heading relative to each row's line, rad, within ±π of it; NaN outside rows."""
    relative = np.full(yaw.size, np.nan)
    for line in view.lines:
        inside = row == line["row"]
        heading = np.arctan2(line["b"][1] - line["a"][1], line["b"][0] - line["a"][0])
        # Wrapped by whole turns at the row's middle only: the series itself stays continuous.
        turns = yaw[inside] - heading
        middle = np.nanmedian(turns) if np.isfinite(turns).any() else 0.0
        relative[inside] = turns - 2.0 * np.pi * np.round(middle / (2.0 * np.pi))
    return relative
