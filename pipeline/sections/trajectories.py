"""Trajectories of both centres of mass, measured and simulated, as in the paper's Fig. 6."""

from __future__ import annotations

import numpy as np

from ..report_blocks import Block, Chart, Curve, Missing, Panel, Section, Text
from ..report_view import BODY_NAMES, PassView
from ._common import NO_ROW, distance_label, nothing_compared
from ._tracks import measured, simulated

CM = 100.0


def build(view: PassView) -> Section:
    """The section."""
    if not view.row_indices:
        return Section("trajectories", "Trajectories", (Missing(NO_ROW),))
    panels = tuple(Panel(f"{BODY_NAMES[b]}, cm", _curves(view, b)) for b in view.bodies)
    blocks: tuple[Block, ...] = (Text(_swing(view)), _chart(view, panels))
    lacking = [BODY_NAMES[b] for b in view.bodies if simulated(view, b) is None]
    if lacking:
        blocks = (*blocks, Missing(f"The {' and the '.join(lacking)} was not simulated: {_reason(view)}"))
    return Section("trajectories", "Trajectories", blocks)


def _reason(view: PassView) -> str:
    """Why a body has no simulated curve."""
    if view.imposed:
        return (
            "without a steering series that is independent of the body's motion the measured tractor is imposed, "
            "and only the seeder is the model's."
        )
    return nothing_compared(view)


def _curves(view: PassView, b: str) -> tuple[Curve, ...]:
    m, s = measured(view, b), simulated(view, b)
    y, sd = CM * m.n, CM * m.sd_n
    curves = (Curve("measured", "measured", m.x, y, y - 2 * sd, y + 2 * sd, band_name="± 2 sd"),)
    return curves if s is None else (*curves, Curve("simulated", "simulated", s.x, CM * s.n, style="dash"))


def _swing(view: PassView) -> str:
    parts = []
    for b in view.bodies:
        n = CM * measured(view, b).n
        low, high = np.nanquantile(n, [0.025, 0.975])
        parts.append(f"{high - low:.1f} cm ({BODY_NAMES[b]})")
    return (
        f"95 % of the measured deviation from the line lies within {' and '.join(parts)}; "
        "the paper's runs swing by 8 to 12 cm."
    )


def _chart(view: PassView, panels: tuple[Panel, ...]) -> Chart:
    return Chart(
        key="trajectories", title="Deviation from the AB line, left positive", x_label=distance_label(view),
        panels=panels, alt=_swing(view),
        caption="Lateral deviation of the centres of mass of the tractor and the seeder, measured with its "
        "band and simulated by the model in consecutive windows, each started from the measured state and "
        "aligned within bounds (compare the paper's Fig. 6).",
    )  # fmt: skip
