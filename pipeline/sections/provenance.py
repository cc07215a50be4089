"""Where the numbers come from: command, hashes, versions, options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..report_blocks import Missing, Section, Table, Text
from ..report_view import PassView

TEXT = "With the same log, options and versions the same numbers come out again. Digests are SHA-256."


def build(view: PassView) -> Section:
    """The section."""
    provenance: Mapping[str, Any] = view.metrics.get("provenance") or {}
    rows = tuple(_lines(provenance))
    if not rows:
        return Section("provenance", "Provenance", (Missing("The result holds no provenance."),))
    table = Table("provenance", "Provenance", ("what", "value"), rows)
    return Section("provenance", "Provenance", (Text(TEXT), table))


def _lines(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        name = f"{prefix}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _lines(value, f"{name} ")
        elif isinstance(value, list):
            yield name, " ".join("none" if item is None else str(item) for item in value)
        elif value is not None:
            yield name, _plain(value)


def _plain(value: Any) -> str:
    """Yes and no in words, numbers as short as they are exact."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}" if isinstance(value, float) else str(value)
