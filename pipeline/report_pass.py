"""The head of one pass's report: its run, verdict and headline numbers from metrics.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .report_head import Head, Number
from .report_view import PassView
from .sections._common import deep, interval, percent, sentence, small

PAPER = {"trajectory": 11.0, "yaw": 9.0}  # %, the paper's own figures
NAMES = {"trajectory": "Trajectory discrepancy", "yaw": "Turning angle discrepancy"}
MEANINGS = {
    "adequate": (
        "On this pass the model follows the measured machine closely enough: the discrepancies "
        "stay under the threshold, with the uncertainty of the measurement counted."
    ),
    "not adequate": (
        "On this pass the model differs from the measured machine by more than the "
        "threshold, and by more than the measurement and its inputs can explain."
    ),
    "inconclusive": "This pass does not decide whether the model is adequate.",
}
SCOPE = (
    "A verdict of scope “pass” speaks of this pass and not of the model: a model is judged over a "
    "campaign of at least four passes in two directions. Discrepancies are root mean squares over "
    "the range R95 of the measured motion. The interval bounds what is left of a discrepancy once "
    "the measurement's own error is taken out, so it may lie below it. The paper gives its figures "
    "without formula; they are shown for orientation and decide nothing."
)


def head_of(view: PassView) -> Head:
    """The first screen of a pass's report."""
    run = view.manifest.run
    value = str(deep(view.metrics, "verdict", "value") or "inconclusive")
    version = deep(view.metrics, "provenance", "versions", "smts-validate") or ""
    return Head(
        title=f"Adequacy report: {run.id}",
        tested=_tested(view),
        verdict=value,
        verdict_label="Verdict on the model, scope: this pass",
        meaning=MEANINGS.get(value, ""),
        reasons=tuple(sentence(str(reason)) for reason in deep(view.metrics, "verdict", "reasons") or ()),
        numbers=tuple(_number(view, kind) for kind in ("trajectory", "yaw")),
        scope=SCOPE,
        footer=f"smts-validate {version}".strip() + f", run {run.id}. Charts by uPlot (MIT licence).",
        short=f"smts-validate {version}".strip() + f"  ·  {run.id}",
    )


def _tested(view: PassView) -> str:
    run, machine = view.manifest.run, view.manifest.machine
    place = ", ".join(
        part
        for part in (
            f"Field {run.field}" if run.field else "",
            f"direction {run.direction}" if run.direction else "",
            f"repeat {run.repeat}",
            f"variant {run.variant}" if run.variant else "",
            run.date.isoformat(),
        )
        if part
    )
    what = "tractor and seeder" if machine.seeder else "tractor alone"
    length = f", l₅ = {machine.seeder.hitch_to_com:g} m" if machine.seeder else ""
    operating = view.manifest.operating
    pressure = f"tyres at {operating.tyre_pressure_mpa:g} MPa"
    return f"{place}. {what.capitalize()} at {operating.speed:g} m/s{length}, {pressure}."


def _body(view: PassView, kind: str, b: str, value: Any) -> str:
    """One body's percentage; where the swing is too small for one, its root mean square error."""
    response = {"trajectory": "deviation", "yaw": "yaw"}[kind] + b
    rmse = deep(view.metrics, "responses", response, "rmse")
    return percent(value) if value is not None or rmse is None else f"RMSE {small(rmse, response)}"


def _number(view: PassView, kind: str) -> Number:
    found: Mapping[str, Any] = deep(view.metrics, "discrepancy", kind) or {}
    ends = found.get("interval")
    if ends and all(isinstance(end, int | float) for end in ends):
        words = f"{interval(ends)} with measuring error taken out"
    elif found.get("combined") is not None:
        words = "no interval"
    else:
        words = "only the seeder is judged" if view.imposed else "no percentage can be given"
    threshold = deep(view.metrics, "verdict", "threshold_percent") or deep(
        view.metrics, "comparison", "threshold_percent"
    )
    bodies = [("tractor", "1"), ("seeder", "2")]
    details = [(name, _body(view, kind, b, found.get(f"body{b}"))) for name, b in bodies]
    if view.manifest.machine.seeder is None:
        details.pop()
    details += [("paper", percent(PAPER[kind], 0))]
    if threshold is not None:
        details.append(("threshold", percent(threshold, 0)))
    return Number(NAMES[kind], percent(found.get("combined")), words, tuple(details))
