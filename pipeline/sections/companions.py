"""Other measures of agreement that readers may know, each beside the straight line's."""

from __future__ import annotations

from ..report_blocks import Missing, Section, Table, Text
from ..report_view import PassView
from ._common import NO_ROW, RESPONSES, number, responses_of

WORDS = (
    "They accompany the headline and decide nothing. Each cell holds the model's value, and the "
    "straight line's in brackets. The mean relative error is not among them: it divides by the "
    "deviation's zero crossings."
)


def build(view: PassView) -> Section:
    """The section."""
    names = [n for n in responses_of(view) if n in (view.metrics.get("companions") or {})]
    if not names:
        return Section("companions", "Companion metrics", (Missing(NO_ROW),))
    return Section("companions", "Companion metrics", (Text(WORDS), _table(view, names)))


def _table(view: PassView, names: list[str]) -> Table:
    model, null = view.metrics["companions"], view.metrics.get("companions_null") or {}
    keys = [(metric, part) for metric, parts in model[names[0]].items() for part in parts]
    rows = tuple(
        (_label(metric, part), *(_cell(model[n], null.get(n) or {}, metric, part) for n in names))
        for metric, part in keys
    )
    columns = ("metric", *(RESPONSES[n] for n in names))
    return Table("companions", "Companion metrics: model (straight line)", columns, rows)


def _label(metric: str, part: str) -> str:
    words = metric if metric == part else f"{metric}, {part}"
    return words.replace("_", " ")


def _cell(
    model: dict[str, dict[str, float]], null: dict[str, dict[str, float]], metric: str, part: str
) -> str:
    ours = number(model.get(metric, {}).get(part), 3)
    return f"{ours} ({number(null.get(metric, {}).get(part), 3)})"
