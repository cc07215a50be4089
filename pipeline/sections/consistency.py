"""Whether the filter's own statistics hold, what noise it assumed, and what it calibrated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..report_blocks import Block, Chart, Curve, Missing, Panel, Section, Table, Text
from ..report_view import PassView, PlotSeries
from ._common import deep, number

HOLDS = (
    "The filter's innovations agree with their stated variances, so the narrow guard factors (0.8 and "
    "1.25) apply."
)
FAILS = (
    "The filter's innovations do not agree with their stated variances on this pass, so the verdict "
    "uses the wide guard factors (0.5 and 2)."
)
EXPLAINED = (
    "NIS is the normalised innovation squared: its mean should be the channel's number of dimensions, "
    "within the bounds given. The autocorrelation at lag one should be near zero."
)
CAPTION = (
    "Each measurement less what the filter expected, over the standard deviation that it stated. Of a "
    "consistent filter 95 % lie within ± 1.96; refused ones are marked."
)
LEVELS = ((1.96, ""), (-1.96, ""))
MOST_PANELS = 6


def build(view: PassView) -> Section:
    """The section."""
    channels = deep(view.metrics, "consistency", "channels")
    words: list[Block] = [Missing("The result holds no innovation statistics.")]
    if channels:
        holds = deep(view.metrics, "consistency", "consistent")
        words = [Text(HOLDS if holds else FAILS), Text(EXPLAINED), _table(channels)]
    blocks = (*words, *_chart(view), *_noise(view), *_calibration(view))
    return Section("consistency", "Consistency of the filter", blocks)


def _table(channels: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (str(c["channel"]), str(c["count"]), str(c["rejected"]), str(c["dof"]), number(c["mean_nis"]),
         f"{number(c['nis_low'])} to {number(c['nis_high'])}", number(c["lag1_autocorrelation"]),
         "yes" if c["consistent"] else "no")
        for c in channels
    )  # fmt: skip
    columns = ("channel", "used", "rejected", "dimensions", "mean NIS", "bounds", "lag-one", "consistent")
    return Table("consistency", "Innovations by channel", columns, rows)


def _chart(view: PassView) -> tuple[Chart, ...]:
    used, refused = view.plots.get("innovations") or {}, view.plots.get("innovations refused") or {}
    start = float(view.trajectory["t"][0])
    groups = list(dict.fromkeys(_group(name) for name in used))[:MOST_PANELS]
    panels = tuple(
        Panel(_short(group), _curves(group, used, refused, start), levels=LEVELS) for group in groups
    )
    if not panels:
        return ()
    chart = Chart(
        key="innovations",
        title="Normalised innovations",
        caption=CAPTION,
        alt=f"Innovations of {len(panels)} channels over time; the table above holds their statistics.",
        x_label="time from the start of the log, s",
        panels=panels,
    )
    return (chart,)


def _group(channel: str) -> str:
    """`gnss position, fixed, east` and `..., north` share a panel."""
    return channel.removesuffix(", east").removesuffix(", north")


def _short(group: str) -> str:
    """A label that fits beside a low panel."""
    return group.replace("gnss", "GNSS").replace("position", "pos.").replace("specific force", "force")


def _curves(
    group: str, used: Mapping[str, PlotSeries], refused: Mapping[str, PlotSeries], start: float
) -> tuple[Curve, ...]:
    members = [name for name in used if _group(name) == group]
    roles: tuple[Any, ...] = ("measured", "third")
    curves = [
        Curve(name.removeprefix(group).removeprefix(", ") or "used", role, used[name].x - start, used[name].y)
        for name, role in zip(members, roles, strict=False)
    ]
    out = [refused[name] for name in members if name in refused]
    if out:
        x, y = (np.concatenate([getattr(series, axis) for series in out]) for axis in ("x", "y"))
        order = np.argsort(x, kind="stable")
        curves.append(Curve("refused", "simulated", x[order] - start, y[order], style="points"))
    return tuple(curves)


def _noise(view: PassView) -> tuple[Table, ...]:
    rows = tuple(
        (
            f"{sensor}, {what.replace('_', ' ')}",
            _value(entry),
            str(entry.get("unit") or ""),
            str(entry.get("source") or ""),
        )
        for sensor, entries in (deep(view.metrics, "fusion", "noise") or {}).items()
        for what, entry in entries.items()
        if isinstance(entry, Mapping)
    )
    columns = ("sensor and quantity", "value", "unit", "where it came from")
    return (
        (Table("noise", "Noise that the filter was given, none of it silently", columns, rows),)
        if rows
        else ()
    )


def _calibration(view: PassView) -> tuple[Table, ...]:
    """Constants of the whole, and those of each sensor beside one another."""
    found: Mapping[str, Mapping[str, Any]] = deep(view.metrics, "fusion", "calibration") or {}
    whole = {name: entry for name, entry in found.items() if "value" in entry}
    sensors = {name: entry for name, entry in found.items() if "value" not in entry}
    rows = tuple(
        (name.replace("_", " "), _estimate(e), str(e.get("unit") or "")) for name, e in whole.items()
    )
    parts = list(dict.fromkeys(part for entry in sensors.values() for part in entry))
    each = tuple(
        (part.replace("_", " "), *(_estimate(e.get(part)) for e in sensors.values())) for part in parts
    )
    tables = (
        Table(
            "calibration",
            "Constants that the filter estimated (± sd)",
            ("constant", "estimate", "unit"),
            rows,
        ),
        Table("wheel-units", "Constants of each wheel-mounted unit (± sd), SI", ("constant", *sensors), each),
    )
    return tuple(table for table in tables if table.rows)


def _estimate(entry: Mapping[str, Any] | None) -> str:
    if entry is None:
        return "–"
    sd = entry.get("sd")
    return _value(entry) + (f" ± {sd:.2g}".replace("e-", "e−") if isinstance(sd, int | float) else "")


def _value(entry: Mapping[str, Any]) -> str:
    value = entry.get("value")
    return f"{value:.4g}".replace("-", "−") if isinstance(value, int | float) else "–"
