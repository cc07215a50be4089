"""What several sections share: joined distances, plain number formatting, reasons for absence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..report_view import PassView

Floats = NDArray[np.float64]

ROW_GAP = 5.0  # m left empty between joined rows
NO_ROW = "This log holds no row that could be compared (a straight stretch of 60 m or more at working speed)."


def number(value: Any, digits: int = 2, unit: str = "", absent: str = "–") -> str:
    """A number for print with its unit; a dash where there is none."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
        return absent
    text = f"{value:.{digits}f}".replace("-", "−")
    return f"{text} {unit}" if unit else text


def percent(value: Any, digits: int = 1) -> str:
    """A percentage for print."""
    return number(value, digits, "%")


def sentence(text: str) -> str:
    """The text with a capital first letter and a full stop."""
    text = text.strip()
    return text if not text else text[0].upper() + text[1:] + ("" if text[-1] in ".!?" else ".")


def deep(values: Mapping[str, Any], *keys: str) -> Any:
    """A value deep in nested mappings, None where any step is absent."""
    found: Any = values
    for key in keys:
        found = found.get(key) if isinstance(found, Mapping) else None
    return found


def distance_label(view: PassView) -> str:
    """Label of the x axis of everything over distance."""
    rows = len(view.row_indices)
    return "distance along the row, m" if rows <= 1 else f"distance along the {rows} rows, joined, m"


def joined_rows(rows: NDArray[Any], s: Floats) -> Floats:
    """Distance with the rows laid end to end, `ROW_GAP` apart; NaN outside rows."""
    joined = np.full(s.size, np.nan)
    offset = 0.0
    for row in np.unique(rows[rows >= 0]):
        inside = rows == row
        low, high = np.nanmin(s[inside]), np.nanmax(s[inside])
        joined[inside] = s[inside] - low + offset
        offset += high - low + ROW_GAP
    return joined
