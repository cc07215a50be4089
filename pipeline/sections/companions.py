"""Other measures of agreement that readers may know, each beside the straight line's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..metrics import METRICS, Metric
from ..report_blocks import Missing, Section, Table, Text
from ..report_view import PassView
from ._common import RESPONSES, nothing_compared, number, responses_of, small

WORDS = (
    "They accompany the headline and decide nothing. Each cell holds the model's value, and the "
    "straight line's in brackets. The mean relative error is not among them: it divides by the "
    "deviation's zero crossings."
)
LABELS = {
    "rmse.rmse": "Root mean square error",
    "rmse.bias": "Mean error",
    "rmse.max_abs": "Greatest error",
    "rmse.p95_abs": "95 % of errors within",
    "nrmse.by_range": "RMSE by the range, %",
    "nrmse.by_max": "RMSE by the greatest value, %",
    "nrmse.by_rms": "RMSE by the rms, %",
    "range_error.range": "Relative error of the range, %",
    "range_error.r95": "Relative error of R95, %",
    "nse.nse": "Nash–Sutcliffe efficiency",
    "sprague_geers.magnitude": "Sprague–Geers M",
    "sprague_geers.phase": "Sprague–Geers P",
    "sprague_geers.comprehensive": "Sprague–Geers C",
    "russell.magnitude": "Russell, magnitude",
    "russell.phase": "Russell, phase",
    "russell.comprehensive": "Russell, comprehensive",
    "theil.u1": "Theil's U1",
    "kge.kge": "Kling–Gupta efficiency",
    "kge.kge_centred": "Kling–Gupta, means removed",
    "kge.alpha": "Kling–Gupta α (spread)",
    "kge.beta": "Kling–Gupta β (mean)",
    "iso18571.r": "ISO 18571 rating R",
    "iso18571.corridor": "ISO 18571, corridor",
    "iso18571.phase": "ISO 18571, phase",
    "iso18571.magnitude": "ISO 18571, magnitude",
    "iso18571.slope": "ISO 18571, slope",
    "correlation.pearson": "Pearson's correlation",
    "correlation.concordance": "Concordance correlation",
}

Values = Mapping[str, Mapping[str, Any]]


def build(view: PassView) -> Section:
    """The section."""
    found: Mapping[str, Values] = view.metrics.get("companions") or {}
    names = [n for n in responses_of(view) if n in found]
    if not names:
        return Section("companions", "Companion metrics", (Missing(nothing_compared(view)),))
    null: Mapping[str, Values] = view.metrics.get("companions_null") or {}
    rows = [
        (_label(metric, part), *(_cell(found[n], null.get(n, {}), metric, part, n) for n in names))
        for metric in METRICS
        for part in found[names[0]].get(metric.key, {})
    ]
    columns = ("metric", *(RESPONSES[n] for n in names))
    table = Table("companions", "Companion metrics: model (straight line)", columns, tuple(rows))
    return Section("companions", "Companion metrics", (Text(WORDS), table))


def _label(metric: Metric, part: str) -> str:
    known = LABELS.get(f"{metric.key}.{part}")
    return known or f"{metric.title.split(' (')[0]}: {part.replace('_', ' ')}"


def _cell(model: Values, null: Values, metric: Metric, part: str, response: str) -> str:
    ours = _value(model, metric, part, response)
    # What was measured is the same beside either model.
    return ours if part.startswith("measured") else f"{ours} ({_value(null, metric, part, response)})"


def _value(values: Values, metric: Metric, part: str, response: str) -> str:
    value = values.get(metric.key, {}).get(part)
    if metric.unit == "same":
        return small(value, response)
    return number(value, 1 if metric.unit == "%" else 3)
