"""What the sensors delivered: rates, losses, clocks, fix quality; and every warning with its effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..report_blocks import Block, Missing, Section, Table, Text
from ..report_view import PassView
from ._common import deep, number

MOST_WARNINGS = 40
ABSENT = {
    "wds": (
        "No wheel-mounted unit (WDS): slip is not known, and without a steering sensor the tractor's model "
        "cannot be tested."
    ),
    "steer": (
        "No steering sensor: the steering comes from the units on the front wheels, where there are any."
    ),
}
GNSS_ALONE = "The speed rests on the GNSS alone: an outage is bridged by the accelerometers."
BUS = (
    "The bus's speed counts as that of the rear wheels, its scale (radius and slip) found from the GNSS: it bridges "
    "outages, but does not tell slip from radius."
)
COLUMNS = (
    "sensor", "what", "samples", "rate, Hz", "lost", "doubled", "gaps", "longest gap, ms", "drift, ppm",
    "latency, ms",
)  # fmt: skip
FIXES = {
    "0": "none",
    "1": "single",
    "2": "differential",
    "4": "RTK fixed",
    "5": "RTK float",
    "6": "dead reckoning",
}

Entry = Mapping[str, Any]


def build(view: PassView) -> Section:
    """The section."""
    health: Mapping[str, Entry] = view.metrics.get("health") or {}
    blocks: list[Block] = [_sensors(view, health), *_gnss(view, health), *_clock(health)]
    blocks += [Missing(text) for kind, text in ABSENT.items() if not view.manifest.of_kind(kind)]
    if not view.manifest.of_kind("wds"):
        blocks.append(Text(BUS if view.manifest.of_kind("speed") else GNSS_ALONE))
    warnings = view.metrics.get("warnings") or []
    return Section("health", "Sensors and warnings", (*blocks, *_warnings(warnings)))


def _sensors(view: PassView, health: Mapping[str, Entry]) -> Block:
    rows = tuple(
        (name, _kind(sensor), *_figures(health[name]))
        for name, sensor in view.manifest.sensors.items()
        if name in health
    )
    if not rows:
        return Missing("The result holds no health figures of the sensors.")
    return Table("health", "Health of the sensors", COLUMNS, rows)


def _kind(sensor: Any) -> str:
    place = getattr(sensor, "body", None) or getattr(sensor, "wheel", None) or ""
    return f"{sensor.kind.upper()} {str(place).replace('_', ' ')}".strip()


def _figures(entry: Entry) -> tuple[str, ...]:
    longest = entry.get("longest_gap_s")
    return (
        _count(entry.get("samples")), number(entry.get("rate_hz"), 2), _count(entry.get("lost")),
        _count(entry.get("doubled")), _count(entry.get("gaps")),
        number(None if longest is None else 1000.0 * longest, 0), number(entry.get("drift_ppm"), 0),
        number(deep(entry, "latency_above_least_ms", "median"), 1),
    )  # fmt: skip


def _count(value: Any) -> str:
    return "–" if value is None else str(value)


def _gnss(view: PassView, health: Mapping[str, Entry]) -> list[Block]:
    rows = []
    for name in view.manifest.of_kind("gps"):
        entry = health.get(name) or {}
        fixes = entry.get("quality") or {}
        total = sum(fixes.values())
        shares = (
            ", ".join(f"{FIXES.get(key, key)} {100.0 * n / total:.0f} %" for key, n in fixes.items()) or "–"
        )
        sd = entry.get("median_sd_m")
        rows.append(
            (
                name,
                shares,
                number(None if sd is None else 100.0 * sd, 1, "cm"),
                _count(entry.get("without_position")),
            )
        )
    columns = ("receiver", "fix", "median stated sd", "epochs without position")
    return [Table("fixes", "GNSS fix quality", columns, tuple(rows))] if health else []


def _clock(health: Mapping[str, Entry]) -> list[Block]:
    clock = health.get("clock") or {}
    offset = clock.get("host_minus_utc_s")
    if offset is None:
        return []
    drift = number(clock.get("host_drift_ppm"), 1, "ppm")
    side = "ahead of" if offset >= 0.0 else "behind"
    return [Text(f"The logger's clock was {number(abs(offset), 3, 's')} {side} UTC and ran off by {drift}.")]


def _warnings(warnings: Sequence[Entry]) -> tuple[Block, ...]:
    if not warnings:
        return (Text("Nothing had to be repaired or left out."),)
    rows = tuple(
        (_place(warning), str(warning.get("what") or "–"), str(warning.get("effect") or "–"))
        for warning in warnings[:MOST_WARNINGS]
    )
    table = Table("warnings", "Warnings, and what was done", ("where", "what", "effect"), rows)
    left = len(warnings) - len(rows)
    return (table,) if left <= 0 else (table, Text(f"{left} more warnings are in metrics.json."))


def _place(warning: Entry) -> str:
    place = str(warning.get("file") or warning.get("sensor") or "the log")
    return place if warning.get("row") is None else f"{place}, row {warning['row']}"
