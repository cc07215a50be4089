"""Map of the pass: where both bodies went, to scale."""

from __future__ import annotations

import numpy as np

from ..report_blocks import Chart, Curve, Panel, Section, Text
from ..report_view import PassView
from ._common import NO_ROW, number

STEP = 25  # samples between drawn points: half a second
CLEARANCE = 12.0  # m, least height of the map


def build(view: PassView) -> Section:
    """The section."""
    lat, lon, alt = (
        number(view.origin.get(key), digits) for key, digits in (("lat", 6), ("lon", 6), ("alt", 1))
    )
    chart = Chart(
        key="map", title="Map of the pass", x_label="East, m",
        panels=(Panel("North, m", _curves(view)),), to_scale=True, alt=_alt(view),
        caption="Fused tracks of the centres of mass, to scale, in the East-North-Up plane at latitude "
        f"{lat}°, longitude {lon}°, altitude {alt} m above the ellipsoid.",
    )  # fmt: skip
    where = _rows_in_words(view) if view.row_indices else NO_ROW
    return Section("map", "Map of the pass", (Text(where), chart))


def _curves(view: PassView) -> tuple[Curve, ...]:
    t = view.trajectory
    picked = np.unique(np.append(np.arange(0, t["t"].size, STEP), t["t"].size - 1))
    curves = [Curve("tractor", "tractor", t["x1"][picked], t["y1"][picked])]
    if "2" in view.bodies:
        curves.append(Curve("seeder", "seeder", t["x2"][picked], t["y2"][picked], style="dash"))
    rows = [np.array([line["a"], line["b"]], dtype=np.float64) for line in _drawn_lines(view)]
    for index, ends in enumerate(rows):
        curves.append(
            Curve("AB line" if index == 0 else "", "reference", ends[:, 0], ends[:, 1], style="dots")
        )
    return (*curves, Curve("start", "third", t["x1"][:1], t["y1"][:1], style="points"))


def _drawn_lines(view: PassView) -> list[dict[str, list[float]]]:
    """Each row's line, cut to the part that the tractor travelled."""
    t, found = view.trajectory, []
    for line in view.lines:
        inside = t["row"] == line["row"]
        if not inside.any():
            continue
        a, b = np.array(line["a"], dtype=np.float64), np.array(line["b"], dtype=np.float64)
        along = (b - a) / np.hypot(*(b - a))
        s = t["s1"][inside]
        found.append({"a": list(a + np.nanmin(s) * along), "b": list(a + np.nanmax(s) * along)})
    return found


def _rows_in_words(view: PassView) -> str:
    t = view.trajectory
    count = len(view.row_indices)
    parts = []
    for row in view.row_indices:
        inside = t["row"] == row
        length = float(np.ptp(t["s1"][inside]))
        parts.append(f"row {row}, {length:.0f} m in {float(np.ptp(t['t'][inside])):.0f} s")
    return f"{'One row was' if count == 1 else f'{count} rows were'} found: {'; '.join(parts)}."


def _alt(view: PassView) -> str:
    t = view.trajectory
    return (
        f"Map of the tracks: {np.ptp(t['x1']):.0f} m from west to east and {np.ptp(t['y1']):.0f} m from "
        f"south to north, rows: {len(view.row_indices)}."
    )
