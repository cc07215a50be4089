"""What was allowed to move and what that does: the disclosure table, the windows' shifts, the horizon
curve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..report_blocks import Block, Chart, Curve, Missing, Panel, Section, Table, Text
from ..report_view import PassView
from ._common import RESPONSES, ROLES, deep, nothing_compared, number, percent, responses_of

KINDS = {
    "none": "nothing moves, the row in one piece",
    "start": "windows from the smoothed state, nothing moves",
    "bounded": "bounded by stated covariance (headline)",
    "free": "offset and heading free",
    "null": "straight line, bounded alike",
}
BOUND = 7.81


def build(view: PassView) -> Section:
    """The section."""
    names = responses_of(view)
    disclosure = view.metrics.get("disclosure") or {}
    if not names or not disclosure:
        return Section("alignment", "Alignment and horizon", (Missing(nothing_compared(view)),))
    blocks: list[Block] = [Text(_within(view)), _table(disclosure, names)]
    windows = deep(view.metrics, "alignment", "windows") or []
    if windows:
        blocks.append(_moved(windows))
    curve = view.metrics.get("horizon_curve") or []
    if curve:
        blocks += [_horizon_chart(view, curve, names), _horizon_table(curve, names)]
    return Section("alignment", "Alignment and horizon", tuple(blocks))


def _within(view: PassView) -> str:
    share = deep(view.metrics, "alignment", "windows_within_bound")
    horizon = number(deep(view.metrics, "comparison", "horizon"), 0, "m")
    words = percent(None if share is None else 100.0 * share, 0)
    return (
        f"The headline uses windows of {horizon}. In {words} of them the alignment stays within its "
        "χ² bound without help; an adequate model needs 90 %."
    )


def _table(disclosure: Mapping[str, Mapping[str, float]], names: tuple[str, ...]) -> Table:
    rows = tuple(
        (words, *(percent(disclosure[kind].get(name)) for name in names))
        for kind, words in KINDS.items()
        if kind in disclosure
    )
    columns = ("what may move", *(RESPONSES[name] for name in names))
    return Table("disclosure", "Discrepancy by what the alignment may move", columns, rows)


def _moved(windows: Sequence[Mapping[str, Any]]) -> Chart:
    index = np.arange(1.0, len(windows) + 1.0)

    def panel(label: str, key: str, factor: float, role: Any) -> Panel:
        values = np.array([np.nan if w[key] is None else factor * w[key] for w in windows])
        return Panel(label, (Curve(key.split("_")[0], role, index, values, style="bars"),))

    panels = [
        panel("offset, cm", "offset", 100.0, "measured"),
        panel("heading, °", "heading_deg", 1.0, "third"),
    ]
    if any(w["steer_deg"] is not None for w in windows):
        panels.append(panel("steering, °", "steer_deg", 1.0, "simulated"))
    chi2 = np.array([np.nan if w["chi2"] is None else float(w["chi2"]) for w in windows])
    bound = ((BOUND, "bound 7.81"),)
    panels.append(
        Panel("χ²", (Curve("χ² as asked for", "residual", index, chi2, style="bars"),), levels=bound)
    )
    return Chart(
        key="windows", title="What moved in each window", discrete=True,
        x_label="window", panels=tuple(panels),
        caption=(
            "Lateral offset, heading and steering offset of each window, and the χ² that they "
            "would have had with the prior as stated; where it exceeds the bound the prior was made "
            "heavier until it did not."
        ),
        alt=f"Bars for {len(windows)} windows; χ² above the bound in {int(np.nansum(chi2 > BOUND))} of them.",
    )  # fmt: skip


def _places(view: PassView, curve: Sequence[Mapping[str, Any]]) -> np.ndarray:
    """Horizons in m; the whole row stands at its length."""
    rows = deep(view.metrics, "comparison", "rows") or []
    whole = max((float(row["length"]) for row in rows), default=100.0)
    return np.array([whole if entry["horizon"] is None else float(entry["horizon"]) for entry in curve])


def _horizon_chart(view: PassView, curve: Sequence[Mapping[str, Any]], names: tuple[str, ...]) -> Chart:
    x = _places(view, curve)
    order = np.argsort(x, kind="stable")
    curves = []
    for name in names:
        y = np.array([float(entry.get(name, np.nan)) for entry in curve])[order]
        curves.append(Curve(RESPONSES[name], ROLES[name], x[order], y, style="marked"))
    threshold = deep(view.metrics, "verdict", "threshold_percent")
    levels = ((float(threshold), "threshold"),) if threshold is not None else ()
    return Chart(
        key="horizon", title="Discrepancy against the length of the windows",
        x_label="length of the windows, m",
        panels=(Panel("D, %", tuple(curves), levels=levels),),
        caption=(
            "Longer windows let small steering errors grow (heading integrates them twice into "
            "position), so the discrepancy rises with the horizon even for a perfect model; the last "
            "point is the whole row."
        ),
        alt="Discrepancy of each response at each horizon; the table below holds the values.",
    )  # fmt: skip


def _horizon_table(curve: Sequence[Mapping[str, Any]], names: tuple[str, ...]) -> Table:
    rows = tuple(
        ("whole row" if entry["horizon"] is None else number(entry["horizon"], 0, "m"),
         *(percent(entry.get(name)) for name in names))
        for entry in curve
    )  # fmt: skip
    columns = ("horizon", *(RESPONSES[name] for name in names))
    return Table("horizon", "Discrepancy against the horizon", columns, rows)
