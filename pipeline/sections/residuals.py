"""Simulated less measured along the row, with what measuring error and inputs explain of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..report_blocks import Chart, Curve, Missing, Panel, Section
from ..report_view import BODY_NAMES, PassView
from ._common import deep, distance_label, nothing_compared, responses_of, small
from ._tracks import joined_distance

Floats = NDArray[np.float64]

QUANTITIES = (("n", "deviation", "cm", 100.0), ("yaw", "yaw", "°", float(np.rad2deg(1.0))))
TITLES = {"n": "Residual of the deviation", "yaw": "Residual of the turning angle"}


def build(view: PassView) -> Section:
    """The section."""
    if not view.comparison:
        return Section("residuals", "Residuals", (Missing(nothing_compared(view)),))
    charts = tuple(_chart(view, *quantity) for quantity in QUANTITIES)
    return Section("residuals", "Residuals", charts)


def _chart(view: PassView, quantity: str, response: str, unit: str, factor: float) -> Chart:
    bodies = [b for b in view.bodies if f"{quantity}{b}_simulated" in view.comparison]
    panels = tuple(
        Panel(f"{BODY_NAMES[b]}, {unit}", _curves(view, quantity, b, factor), levels=((0.0, ""),))
        for b in bodies
    )
    sizes = [
        f"{BODY_NAMES[b]} {small(deep(view.metrics, 'responses', name, 'rmse'), name)}"
        for b in bodies
        for name in (f"{response}{b}",)
        if name in responses_of(view)
    ]
    return Chart(
        key=f"residual-{response}",
        title=f"{TITLES[quantity]}: simulated less measured",
        caption=(
            "The windows' residuals after the bounded alignment, at equal distance along the line; "
            "gaps of the GNSS are left out. The band is twice the standard uncertainty that "
            "measuring error, steering, start and stated parameters together leave in the residual: "
            "what lies within it needs no fault of the model."
        ),
        alt=f"{TITLES[quantity]} over distance; root mean square: {', '.join(sizes)}.",
        x_label=distance_label(view),
        panels=panels,
    )


def _curves(view: PassView, quantity: str, b: str, factor: float) -> tuple[Curve, ...]:
    grid = view.comparison
    valid = grid[f"valid{b}"] > 0.5
    x = joined_distance(view, grid["row"], grid["s"])
    residual = np.where(valid, factor * (grid[f"{quantity}{b}_simulated"] - grid[f"{quantity}{b}"]), np.nan)
    known = 2.0 * factor * np.hypot(grid[f"sd_{quantity}{b}"], grid[f"sd_input_{quantity}{b}"])
    band = Curve("known uncertainty", "reference", x, np.zeros(x.size), -known, known, "none", "± 2 u")
    return band, Curve("residual", "residual", x, residual)
