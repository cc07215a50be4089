"""What several sections share: joined distances, plain number formatting, reasons for absence."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..report_blocks import Role
from ..report_view import PassView

Floats = NDArray[np.float64]

ROW_GAP = 5.0  # m left empty between joined rows
NO_ROW = "This log holds no row that could be compared (a straight stretch of 60 m or more at working speed)."


def nothing_compared(view: PassView) -> str:
    """Why there is no comparison: no row was found, or each was excluded for a reason."""
    excluded = deep(view.metrics, "comparison", "excluded") or []
    if not excluded:
        return NO_ROW
    words = "; ".join(f"row {entry['row']}: {entry['reason']}" for entry in excluded)
    return f"No row was compared. {sentence(words)}"


def number(value: Any, digits: int = 2, unit: str = "", absent: str = "–") -> str:
    """A number for print with its unit; a dash where there is none."""
    if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
        return absent
    text = f"{value:.{digits}f}".replace("-", "−")
    return text + (unit if unit == "°" else f"\u00a0{unit}" if unit else "")


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


RESPONSES = {
    "deviation1": "deviation, tractor",
    "deviation2": "deviation, seeder",
    "yaw1": "turning angle, tractor",
    "yaw2": "turning angle, seeder",
}
ROLES: dict[str, Role] = {
    "deviation1": "measured",
    "deviation2": "simulated",
    "yaw1": "third",
    "yaw2": "fourth",
}


def responses_of(view: PassView) -> tuple[str, ...]:
    """Responses that were compared, in a fixed order."""
    found = view.metrics.get("responses") or {}
    return tuple(name for name in RESPONSES if name in found)


def small(value: Any, response: str, digits: int = 2) -> str:
    """A length in cm or an angle in degrees, from m or rad."""
    if not isinstance(value, int | float):
        return number(value)
    return (
        number(np.rad2deg(value), digits + 1, "°")
        if response.startswith("yaw")
        else number(100.0 * value, digits, "cm")
    )


def interval(ends: Any, unit: str = "%") -> str:
    """`4.0 to 9.5 %`, a dash where there is none."""
    if not ends or not all(isinstance(end, int | float) for end in ends):
        return "–"
    return f"{number(ends[0], 1)} to {number(ends[1], 1, unit)}"
