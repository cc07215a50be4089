"""The forecast as a page: tables, the chances as curves, and files in a folder."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .identify_report import brief
from .planning import OFTEN, REPEATS, SURE, Forecast, Precision, VariantForecast, forecast
from .planning_chances import Chance
from .report import write_pages
from .report_blocks import Block, Chart, Curve, Panel, Role, Section, Table, Text
from .report_head import Head
from .twin_campaign import read_campaign

DOCUMENT = "plan.json"
ROLES: tuple[Role, ...] = ("measured", "simulated", "third", "fourth", "reference")
GOOD = ((100.0 * OFTEN, "a good chance"),)
LABELS = {
    "deviation1": "tractor's deviation",
    "deviation2": "seeder's deviation",
    "yaw1": "tractor's yaw",
    "yaw2": "seeder's yaw",
}


def plan_to_folder(
    source: Path,
    out: Path,
    repeats: Sequence[int] = REPEATS,
    pilots: int = 6,
    workers: int = 2,
    say: Callable[[str], None] = lambda message: None,
) -> dict[str, Any]:
    """Forecast the campaign plan in `source`; plan.json, report.html and report.pdf land in `out`.

    Gives the forecast's document. Raises PlanError.
    """
    campaign = read_campaign(source)
    found = forecast(campaign, repeats, pilots, workers, say=say)
    document = found.document()
    out.mkdir(parents=True, exist_ok=True)
    (out / DOCUMENT).write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    write_pages(
        head_of(found, source.stem), sections_of(found), out, dt.date.fromisoformat(campaign.base.run.date)
    )
    return {**document, "out": str(out), "report": str(out / "report.html")}


def head_of(found: Forecast, name: str) -> Head:
    """The first screen: what was planned, and the advice for each version."""
    many = len(found.variants) > 1
    reasons = tuple(
        f"version {v.variant}: {line}" if many else line for v in found.variants for line in v.advice
    )
    pilots = sum(v.pilots for v in found.variants)
    return Head(
        title=f"Forecast of a campaign: {name}",
        tested=f"{len(found.cells)} cells of field and direction, {found.repeats} repeats in each, "
        f"{len(found.variants)} versions; threshold {found.threshold_percent:g} %",
        verdict="",
        verdict_label="forecast",
        meaning="What verdicts this campaign would give, by simulation: nothing here was measured.",
        reasons=reasons,
        numbers=(),
        scope="",
        footer=f"From {pilots} simulated pilot passes through the whole chain.",
        short=f"Forecast: {name}",
    )


def sections_of(found: Forecast) -> tuple[Section, ...]:
    """A section a version."""
    return tuple(
        Section(f"version-{k}", f"Version {v.variant}", _blocks(v, k, found))
        for k, v in enumerate(found.variants)
    )


def _blocks(variant: VariantForecast, k: int, found: Forecast) -> tuple[Block, ...]:
    failed = (
        (Text("Pilots that could not be compared: " + "; ".join(variant.failed)),) if variant.failed else ()
    )
    return (
        *failed,
        _readings_table(variant, k),
        _chances_chart(variant, k, found),
        _chances_table(variant, k),
        *_precision_chart(variant, k),
        _precision_table(variant, k),
    )


def _readings_table(variant: VariantForecast, k: int) -> Table:
    rows = tuple(
        (
            LABELS.get(r.response, r.response),
            f"{100.0 * r.r95:.1f} cm" if r.response.startswith("deviation") else f"{np.degrees(r.r95):.2f}°",
            *(f"{value:.1f}" for value in (r.total, r.measuring, r.inputs, r.soil)),
        )
        for r in variant.readings
    )
    return Table(
        f"right-model-{k}",
        "What a right model reads, in percent of R95 (root mean squares): in all, and what measuring error, "
        "inputs and the soil's disturbance (with whatever the fusion gets wrong) make of it.",
        ("response", "R95", "in all", "measuring", "inputs", "soil"),
        rows,
    )


def _chances_table(variant: VariantForecast, k: int) -> Table:
    rows = tuple(
        (
            f"{c.repeats}", f"{c.percent:g}", f"{100.0 * c.adequate:.0f}", f"{100.0 * c.not_adequate:.0f}",
            f"{100.0 * c.inconclusive:.0f}", ", ".join(list(c.doubts)[:3]),
        )
        for c in variant.chances
    )  # fmt: skip
    return Table(
        f"chances-{k}",
        "Chance of each verdict (%) by repeats in a cell and by the model's own discrepancy; and what most "
        "often stands in the way of a decision.",
        ("repeats", "discrepancy, %", "adequate", "not adequate", "inconclusive", "in the way"),
        rows,
    )


def _chances_chart(variant: VariantForecast, k: int, found: Forecast) -> Chart:
    counts = list(dict.fromkeys(c.repeats for c in variant.chances))
    panels = tuple(
        Panel(label, tuple(_curve(variant.chances, n, i, value) for i, n in enumerate(counts)), levels=GOOD)
        for label, value in (("adequate, %", "adequate"), ("not adequate, %", "not_adequate"))
    )
    return Chart(
        key=f"chances-{k}",
        title="Chance of each verdict",
        caption="Share of simulated campaigns by the model's own discrepancy, a curve for each number of "
        f"repeats in a cell; the threshold is {found.threshold_percent:g} %. The rest is inconclusive.",
        alt="The chance of the verdict adequate falls and that of not adequate rises with the model's own "
        "discrepancy; more repeats make both curves steeper.",
        x_label="the model's own discrepancy, % of R95",
        panels=panels,
    )


def _curve(chances: Sequence[Chance], repeats: int, index: int, value: str) -> Curve:
    points = [c for c in chances if c.repeats == repeats]
    return Curve(
        name=f"{repeats} repeats" if repeats > 1 else "1 repeat",
        role=ROLES[index % len(ROLES)],
        x=np.array([c.percent for c in points]),
        y=np.array([100.0 * getattr(c, value) for c in points]),
        style="marked" if index < len(ROLES) else "dash",
    )


def _precision_chart(variant: VariantForecast, k: int) -> tuple[Chart, ...]:
    """Each parameter's uncertainty over the repeats; none where a single number of repeats was tried."""
    known = [p for p in variant.parameters if all(sd is not None for sd in p.sd_percent.values())]
    if not known or len(known[0].sd_percent) < 2:
        return ()
    curves = tuple(
        Curve(
            name=brief(p.parameter),
            role=ROLES[i % len(ROLES)],
            x=np.array(list(p.sd_percent), dtype=np.float64),
            y=np.array(list(p.sd_percent.values()), dtype=np.float64),
            style="marked" if i < len(ROLES) else "dash",
        )
        for i, p in enumerate(known)
    )
    level = (100.0 * SURE, "sure enough")
    return (
        Chart(
            key=f"precision-{k}",
            title="Uncertainty of each parameter",
            caption="Standard deviation with which each parameter could be identified, all others free. What the "
            "steering sensor's scale costs is the same in all passes and does not fall with the repeats.",
            alt="The standard deviation of each parameter falls as the repeats grow, to the floor that the scale "
            "of the steering sensor leaves.",
            x_label="repeats in a cell",
            panels=(Panel("standard deviation, %", curves, log_y=True, levels=(level,)),),
            discrete=True,
        ),
    )


def _precision_table(variant: VariantForecast, k: int) -> Table:
    counts = list(variant.parameters[0].sd_percent) if variant.parameters else []
    return Table(
        f"parameters-{k}",
        "Standard deviation (%) with which each parameter could be identified, by repeats in a cell, all others "
        "free; alone: all others known, at the planned repeats.",
        (
            "parameter",
            "stated",
            *(f"n = {n}" for n in counts),
            "alone",
            "most like",
            "corr.",
            "sure",
        ),
        tuple(_precision_row(p) for p in variant.parameters),
    )


def _precision_row(p: Precision) -> tuple[str, ...]:
    sds = (_number(sd) for sd in p.sd_percent.values())
    known = "yes" if p.identifiable else "no"
    return (
        brief(p.parameter),
        f"{p.value:g}",
        *sds,
        _number(p.alone_percent),
        brief(p.partner),
        f"{p.correlation:.2f}",
        known,
    )


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.1f}"
