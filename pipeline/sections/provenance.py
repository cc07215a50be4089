"""Where the numbers come from: hashes, versions, options."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from ..report_blocks import Block, Missing, Section, Table, Text
from ..report_view import PassView

TEXT = "With the same log, options and versions the same numbers come out again. Digests are SHA-256."


def build(view: PassView) -> Section:
    """The section."""
    rows = tuple(_lines(view.metrics.get("provenance") or {}))
    table: Block = Missing("The result holds no provenance.")
    if rows:
        table = Table("provenance", "Provenance", ("what", "value"), rows)
    return Section("provenance", "Provenance", (Text(TEXT), table))


def _lines(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _lines(value, f"{name} ")
        elif isinstance(value, list):
            yield name, " ".join(str(item) for item in value)
        elif value is not None:
            yield name, str(value)
