"""Charts for the page's script: one JSON object a chart, columns ready for uPlot; and uPlot's own files."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import figures_style as style
from .report_blocks import Curve, Panel

Floats = NDArray[np.float64]

UPLOT = "uplot-python"
X_DIGITS, DIGITS = 5, 4  # significant digits that a drawn value keeps


class MissingFileError(RuntimeError):
    """A file that an installed package should have brought is not there."""


@cache
def uplot_file(name: str) -> str:
    """Text of one of uPlot's own files, found in the installed package without importing it."""
    try:
        found = [path for path in files(UPLOT) or [] if path.name == name]
    except PackageNotFoundError:
        found = []
    if not found:
        raise MissingFileError(f"{UPLOT}: {name} is not installed; run `pip install {UPLOT}`")
    return found[0].read_text(encoding="utf-8")


@dataclass(frozen=True)
class _Column:
    """One column of a panel's data: a curve, or an edge of its band (hidden: not in the legend)."""

    curve: Curve
    values: Floats
    hidden: bool = False


def chart_json(thinned: style.Thinned) -> str:
    """The chart as JSON that may stand inside a script element."""
    chart = thinned.chart
    value = {
        "key": chart.key,
        "x_label": chart.x_label,
        "x_short": chart.x_label.split(",")[0],
        "x_digits": _digits(np.concatenate([c.x for p in chart.panels for c in p.curves])),
        "log_x": chart.log_x,
        "discrete": chart.discrete,
        "panels": [_panel(panel) for panel in chart.panels],
    }
    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _panel(panel: Panel) -> dict[str, Any]:
    columns = [column for curve in panel.curves for column in _columns(curve)]
    x = np.unique(np.concatenate([column.curve.x for column in columns]))
    rounded = _significant if panel.log_y else _rounded
    digits = _digits(np.concatenate([column.values for column in columns]))
    return {
        "y_label": panel.y_label,
        "log_y": panel.log_y,
        "levels": [[value, label] for value, label in panel.levels],
        "curves": [
            {
                "name": _label(c.curve),
                "role": c.curve.role,
                "style": c.curve.style,
                "hidden": c.hidden,
                "digits": digits,
                "log": panel.log_y,
            }
            for c in columns
        ],
        "bands": [
            [i, i + 1, columns[i].curve.role]
            for i in range(len(columns) - 1)
            if columns[i].hidden and columns[i + 1].hidden and columns[i].curve is columns[i + 1].curve
        ],
        "data": [_rounded(x, X_DIGITS), *(rounded(_on(x, column)) for column in columns)],
    }


def _label(curve: Curve) -> str:
    return f"{curve.name} ({curve.band_name})" if curve.band_name else curve.name


def _columns(curve: Curve) -> list[_Column]:
    line = [_Column(curve, curve.y)]
    if curve.low is None or curve.high is None:
        return line
    return [*line, _Column(curve, curve.high, hidden=True), _Column(curve, curve.low, hidden=True)]


def _on(x: Floats, column: _Column) -> Floats:
    """The column's values at the panel's x: its own where it has them, between them straight, NaN outside."""
    own, values = column.curve.x, column.values
    if own.size == x.size or column.curve.style in {"points", "bars"}:
        placed = np.full(x.size, np.nan)
        placed[np.searchsorted(x, own)] = values
        return placed
    return np.asarray(np.interp(x, own, values, left=np.nan, right=np.nan))


def _digits(values: Floats) -> int:
    """Decimals that show three or four significant digits of the largest value."""
    finite = np.abs(values[np.isfinite(values)])
    largest = float(finite.max()) if finite.size else 0.0
    return 2 if largest == 0.0 else int(np.clip(3 - math.floor(math.log10(largest)), 0, 9))


def _significant(values: Floats) -> list[float | None]:
    """Values to three significant digits each, for logarithmic axes; None where not finite."""
    return [float(f"{v:.3g}") if math.isfinite(v) else None for v in values.tolist()]


def _rounded(values: Floats, digits: int = DIGITS) -> list[float | None]:
    """Values to so many significant digits of the largest, None where not finite."""
    finite = np.abs(values[np.isfinite(values)])
    largest = float(finite.max()) if finite.size else 0.0
    places = 0 if largest == 0.0 else digits - 1 - math.floor(math.log10(largest))
    rounded = np.round(values, places)
    whole = places <= 0
    return [None if not math.isfinite(v) else int(v) if whole else v for v in rounded.tolist()]
