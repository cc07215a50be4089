"""Where the numbers come from: hashes, versions, options."""

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
    return Section("provenance", "Provenance", (Text(TEXT), *_command(provenance), table))


def _command(provenance: Mapping[str, Any]) -> tuple[Text, ...]:
    """What to type to have this result again."""
    source = provenance.get("source")
    return (Text(f"Made by: smts-validate run {source}"),) if source else ()


def _lines(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            yield from _lines(value, f"{name} ")
        elif isinstance(value, list):
            yield name, " ".join(str(item) for item in value)
        elif value is not None:
            yield name, str(value)
