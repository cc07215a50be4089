"""Measured and simulated motion over distance, as the figures of a pass show it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..report_view import Columns, PassView
from ._common import ROW_GAP

Floats = NDArray[np.float64]

MOST_WINDOWS = 1e6  # in a row: tells windows of different rows apart


@dataclass(frozen=True)
class Track:
    """One body over joined distance x (m): deviation n (m), heading to the line (rad), sds where known."""

    x: Floats
    n: Floats
    yaw: Floats
    sd_n: Floats
    sd_yaw: Floats


def measured(view: PassView, b: str) -> Track:
    """The fused motion of body `b` inside rows, broken between them; on the comparison's grid if possible."""
    t = view.trajectory
    if not _on_grid(view, b):
        return _series(view, b, t, (t[f"sd_n{b}"], t[f"sd_yaw{b}"]), np.zeros(t["t"].size))
    grid = view.comparison
    sds = (_along(view, grid["row"], grid["s"], b, name) for name in ("sd_n", "sd_yaw"))
    return _broken(view, grid["row"], grid["s"], (grid[f"n{b}"], grid[f"yaw{b}"], *sds), grid["row"])


def simulated(view: PassView, b: str) -> Track | None:
    """The model's motion of body `b`, broken between rows and windows; None where nothing was simulated."""
    columns, grid = view.simulation, view.comparison
    if b not in view.simulated_bodies or not np.isfinite(columns[f"n{b}"]).any():
        return None
    if not _on_grid(view, b):
        nothing = np.full(columns["t"].size, np.nan)
        window = np.nan_to_num(columns["window"], nan=-1.0)
        return _series(view, b, columns, (nothing, nothing), window)
    nothing = np.full(grid["s"].size, np.nan)
    values = (grid[f"n{b}_simulated"], grid[f"yaw{b}_simulated"], nothing, nothing)
    part = np.nan_to_num(grid[f"window{b}"], nan=-1.0) + MOST_WINDOWS * grid["row"]
    return _broken(view, grid["row"], grid["s"], values, part)


def _series(view: PassView, b: str, columns: Columns, sds: tuple[Floats, Floats], window: Floats) -> Track:
    """A track from columns over time; inside rows only, broken where row or window change."""
    inside = columns["row"] >= 0
    yaw = relative_yaw(view, columns["row"], columns[f"yaw{b}"])
    values = tuple(column[inside] for column in (columns[f"n{b}"], yaw, *sds))
    part = (window + MOST_WINDOWS * columns["row"])[inside]
    return _broken(view, columns["row"][inside], columns[f"s{b}"][inside], values, part)


def _on_grid(view: PassView, b: str) -> bool:
    """Whether every row of the pass was compared, for this body."""
    grid = view.comparison
    return f"n{b}_simulated" in grid and set(np.unique(grid["row"])) == set(view.row_indices)


def _along(view: PassView, row: Floats, s: Floats, b: str, name: str) -> Floats:
    """A column of the trajectory read at the grid's chainages."""
    t, found = view.trajectory, np.full(s.size, np.nan)
    for index in view.row_indices:
        here, there = row == index, t["row"] == index
        found[here] = np.interp(s[here], np.maximum.accumulate(t[f"s{b}"][there]), t[f"{name}{b}"][there])
    return found


def _broken(view: PassView, row: Floats, s: Floats, values: tuple[Floats, ...], part: Floats) -> Track:
    """The track with a sample that is not there wherever `part` changes: it breaks the line."""
    x = joined_distance(view, row, s)
    joins = np.flatnonzero(np.diff(part)) + 1
    between = 0.5 * (x[joins - 1] + x[joins])
    return Track(np.insert(x, joins, between), *(np.insert(column, joins, np.nan) for column in values))


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
