"""Turning angles of both bodies, measured and simulated, as in the paper's Fig. 7."""

from __future__ import annotations

import numpy as np

from ..report_blocks import Chart, Curve, Missing, Panel, Section
from ..report_view import BODY_NAMES, PassView
from ._common import NO_ROW, distance_label
from ._tracks import measured, simulated


def build(view: PassView) -> Section:
    """The section."""
    if not view.row_indices:
        return Section("yaw", "Turning angles", (Missing(NO_ROW),))
    panels = tuple(Panel(f"{BODY_NAMES[b]}, °", _curves(view, b)) for b in view.bodies)
    chart = Chart(
        key="yaw", title="Heading relative to the AB line, left positive",
        x_label=distance_label(view), panels=panels,
        alt=_alt(view),
        caption="Turning angle of the tractor and the seeder about the vertical, relative to the line, "
        "measured with its band and simulated (compare the paper's Fig. 7).",
    )  # fmt: skip
    return Section("yaw", "Turning angles", (chart,))


def _curves(view: PassView, b: str) -> tuple[Curve, ...]:
    m, s = measured(view, b), simulated(view, b)
    y, sd = np.rad2deg(m.yaw), np.rad2deg(m.sd_yaw)
    curves = (Curve("measured", "measured", m.x, y, y - 2 * sd, y + 2 * sd, band_name="± 2 sd"),)
    return (
        curves
        if s is None
        else (*curves, Curve("simulated", "simulated", s.x, np.rad2deg(s.yaw), style="dash"))
    )


def _alt(view: PassView) -> str:
    parts = [
        f"{BODY_NAMES[b]} from {np.nanmin(y):.2f}° to {np.nanmax(y):.2f}°"
        for b in view.bodies
        for y in (np.rad2deg(measured(view, b).yaw),)
    ]
    return f"Measured and simulated heading over distance: {'; '.join(parts)}."
