"""Colours, line styles and thinning that every rendering of a chart shares. No plotting library here."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .report_blocks import Chart, Curve, Panel, Role

Floats = NDArray[np.float64]

# Okabe and Ito's colours, told apart with any colour vision; dark themes get lighter ones of the same hue.
LIGHT: dict[Role, str] = {
    "measured": "#0072b2", "simulated": "#c84e00", "measured2": "#007f5f", "simulated2": "#a8457f",
    "residual": "#3d4a57", "null": "#6b6b6b", "tractor": "#0071b0", "seeder": "#c74d01",
    "reference": "#6a6a6c", "third": "#007f5e", "fourth": "#a8467e",
}  # fmt: skip
DARK: dict[Role, str] = {
    "measured": "#56b4e9", "simulated": "#ff9a4d", "measured2": "#3fd0a4", "simulated2": "#e79ac8",
    "residual": "#c3ced8", "null": "#a5a5a5", "tractor": "#56b4e9", "seeder": "#ff9a4d",
    "reference": "#a5a5a5", "third": "#3fd0a4", "fourth": "#e79ac8",
}  # fmt: skip
INK = "#1d2329"
MUTED = "#59636e"
GRID = "#dfe3e8"

PAGE_POINTS = 700  # instants that an interactive chart holds
BAND_SPANS = 1.5  # of the curves' range: a band is drawn no further beyond them
STILL_POINTS = 360  # instants that a still picture draws


@dataclass(frozen=True)
class Thinned:
    """A chart ready to draw, how many of how many points it draws, and whether a band was cut."""

    chart: Chart
    drawn: int
    points: int
    cut: bool = False

    @property
    def note(self) -> str:
        """What the caption must say about what is not drawn; empty when nothing was left out."""
        band = " The band reaches beyond what is drawn." if self.cut else ""
        if self.drawn >= self.points:
            return band
        return (
            f" Long series are drawn by the least and the greatest value of each stretch "
            f"({self.drawn:,} of {self.points:,} points).{band}"
        )


def extremes(y: Floats, buckets: int) -> NDArray[np.intp]:
    """Indices, ascending, of the least and greatest value in each of `buckets` stretches of y, and the ends.

    Stretches without a finite value keep their first sample, so that a gap stays a gap.
    """
    if y.size <= 2 * buckets:
        return np.arange(y.size)
    edges = np.linspace(0, y.size, buckets + 1).astype(np.intp)
    starts = edges[:-1]
    width = int(np.diff(edges).max())
    padded = np.minimum(starts[:, None] + np.arange(width), edges[1:, None] - 1)
    values = y[padded]
    low = padded[np.arange(buckets), np.where(np.isnan(values), np.inf, values).argmin(axis=1)]
    high = padded[np.arange(buckets), np.where(np.isnan(values), -np.inf, values).argmax(axis=1)]
    gaps = np.flatnonzero(np.isnan(y[1:]) != np.isnan(y[:-1]))
    return np.unique(np.concatenate([low, high, gaps, gaps + 1, [0, y.size - 1]]))


def thin_panel(panel: Panel, most: int) -> Panel:
    """The panel with about `most` instants at most, each curve's extremes kept; shared grids stay shared."""
    grids: list[Floats] = []
    for curve in panel.curves:
        if not any(_same(curve.x, grid) for grid in grids):
            grids.append(curve.x)
    curves = []
    keeps = [_kept([c for c in panel.curves if _same(c.x, grid)], most) for grid in grids]
    for curve in panel.curves:
        keep = next(keep for keep, grid in zip(keeps, grids, strict=True) if _same(curve.x, grid))
        curves.append(_part(curve, keep))
    return replace(panel, curves=tuple(curves))


def _same(a: Floats, b: Floats) -> bool:
    return a is b or np.array_equal(a, b)


def _kept(curves: Sequence[Curve], most: int) -> NDArray[np.intp]:
    if curves[0].x.size <= most:
        return np.arange(curves[0].x.size)
    buckets = max(most // (2 * len(curves)), 10)
    return np.unique(np.concatenate([extremes(curve.y, buckets) for curve in curves]))


def _part(curve: Curve, keep: NDArray[np.intp]) -> Curve:
    low = None if curve.low is None else curve.low[keep]
    high = None if curve.high is None else curve.high[keep]
    return replace(curve, x=curve.x[keep], y=curve.y[keep], low=low, high=high)


def thin(chart: Chart, most: int) -> Thinned:
    """The chart with every long curve thinned."""
    panels = tuple(thin_panel(panel, most) for panel in chart.panels)
    bounded = tuple(cut_bands(panel) for panel in panels)
    cut = any(after is not before for after, before in zip(bounded, panels, strict=True))
    thinned = replace(chart, panels=bounded)
    return Thinned(thinned, _count(panels), _count(chart.panels), cut)


def cut_bands(panel: Panel) -> Panel:
    """The panel with bands cut where they would dwarf its curves: `BAND_SPANS` of their range beyond them."""
    values = np.concatenate([curve.y for curve in panel.curves if curve.style != "none"] or [np.empty(0)])
    values = values[np.isfinite(values)]
    if panel.log_y or values.size == 0:
        return panel
    low, high = float(values.min()), float(values.max())
    room = BAND_SPANS * (high - low)
    bands = [edge for curve in panel.curves for edge in (curve.low, curve.high) if edge is not None]
    beyond = any(np.nanmin(edge) < low - room or np.nanmax(edge) > high + room for edge in bands if edge.size)
    if not beyond or not room > 0.0:
        return panel
    return replace(panel, curves=tuple(_cut(curve, low - room, high + room) for curve in panel.curves))


def _cut(curve: Curve, low: float, high: float) -> Curve:
    if curve.low is None or curve.high is None:
        return curve
    return replace(curve, low=np.clip(curve.low, low, high), high=np.clip(curve.high, low, high))


def _count(panels: Sequence[Panel]) -> int:
    return sum(curve.x.size for panel in panels for curve in panel.curves)


def power(value: float) -> str:
    """A power of ten for an axis: 0.1, 1, 10, 10⁻³."""
    exponent = round(math.log10(value)) if value > 0.0 else 0
    if abs(exponent) < 3:
        return f"{value:g}"
    return "10" + "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(sign)] if sign.isdigit() else "⁻" for sign in str(exponent))
