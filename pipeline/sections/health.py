"""What the sensors delivered: rates, losses, clocks, fix quality; and every warning with its effect."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..report_blocks import Block, Missing, Section, Table, Text
from ..report_view import PassView

MOST_WARNINGS = 40
ABSENT = {
    "wds": (
        "No wheel-mounted unit (WDS): the speed rests on the GNSS alone, slip is not known, and "
        "without a steering sensor the tractor's model cannot be tested."
    ),
    "steer": (
        "No steering sensor: the steering comes from the units on the front wheels, where there are any."
    ),
}


def build(view: PassView) -> Section:
    """The section."""
    blocks: list[Block] = [_sensors(view.metrics.get("health") or {})]
    blocks += [Missing(text) for kind, text in ABSENT.items() if not view.manifest.of_kind(kind)]
    return Section(
        "health", "Sensors and warnings", (*blocks, *_warnings(view.metrics.get("warnings") or []))
    )


def _sensors(health: Mapping[str, Any]) -> Block:
    if not health:
        return Missing("The result holds no health figures of the sensors.")
    columns = list(
        dict.fromkeys(
            key for entry in health.values() if isinstance(entry, Mapping) for key in _scalars(entry)
        )
    )
    rows = tuple(
        (name, *(_cell(entry.get(key)) for key in columns))
        for name, entry in health.items()
        if isinstance(entry, Mapping)
    )
    return Table(
        "health", "Health of the sensors", ("sensor", *(key.replace("_", " ") for key in columns)), rows
    )


def _scalars(entry: Mapping[str, Any]) -> list[str]:
    return [key for key, value in entry.items() if not isinstance(value, Mapping | list)]


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}".replace("-", "−") if isinstance(value, float) else str(value)


def _warnings(warnings: list[Mapping[str, Any]]) -> tuple[Block, ...]:
    if not warnings:
        return (Text("Nothing had to be repaired or left out."),)
    rows = tuple(
        (_place(warning), str(warning.get("what") or "–"), str(warning.get("effect") or "–"))
        for warning in warnings[:MOST_WARNINGS]
    )
    table = Table("warnings", "Warnings, and what was done", ("where", "what", "effect"), rows, numeric=False)
    left = len(warnings) - len(rows)
    return (table,) if left <= 0 else (table, Text(f"{left} more warnings are in metrics.json."))


def _place(warning: Mapping[str, Any]) -> str:
    place = str(warning.get("file") or warning.get("sensor") or "the log")
    return place if warning.get("row") is None else f"{place}, row {warning['row']}"
