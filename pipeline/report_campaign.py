"""The report of a campaign: verdict by version, passes with links, repeats, effects, operating curve."""

from __future__ import annotations

import datetime as dt
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from .campaign import read_record
from .report import write_pages
from .report_campaign_parts import CampaignView, drawn_cells, drawn_runs, parts_of
from .report_head import Head, Number
from .result import package_version
from .sections._common import deep, interval, percent, sentence

PAPER = {"trajectory": 11.0, "yaw": 9.0}  # %
NAMES = {"trajectory": "Trajectory discrepancy", "yaw": "Turning angle discrepancy"}
MEANINGS = {
    "adequate": (
        "Over this campaign the model follows the measured machine closely enough in every "
        "response, with the spread of the passes and the uncertainty of the measurement counted."
    ),
    "not adequate": (
        "Over this campaign the model differs from the measured machine by more than the threshold, "
        "and by more than measurement and inputs can explain."
    ),
    "inconclusive": "These passes do not decide whether the model is adequate.",
}
SCOPE = (
    "The pass is the unit: samples along a pass are not independent. Passes combine by their "
    "geometric mean, bodies by their quadratic mean. The interval bounds what is left of a "
    "discrepancy once the measurement's own error is taken out. The paper gives its 11 % and 9 % "
    "without formula, spread or threshold, so they are shown for orientation and decide nothing. "
    "With several versions the campaign's verdict is the worst of them, and the numbers are that "
    "version's."
)


def write_campaign_report(folder: Path) -> CampaignView:
    """Write report.html and report.pdf of a batch's OUT from its campaign.json and its stored passes."""
    view = read_campaign(folder)
    write_pages(head_of(view), parts_of(view), folder, date_of(view))
    return view


def read_campaign(folder: Path) -> CampaignView:
    """What the campaign's report is made from."""
    document = json.loads((folder / "campaign.json").read_text(encoding="utf-8"))
    failures = folder / "failures.json"
    failed = json.loads(failures.read_text(encoding="utf-8"))["failures"] if failures.is_file() else []
    drawn = [run for cell in drawn_cells(document) for run in drawn_runs(cell)]
    records = {run: read_record(folder / "passes" / run) for run in drawn}
    return CampaignView(document, records, tuple(failed))


def date_of(view: CampaignView) -> dt.date:
    """The last drawn pass's day: the same campaign gives the same bytes."""
    return max((record.manifest.run.date for record in view.records.values()), default=dt.date(1970, 1, 1))


def head_of(view: CampaignView) -> Head:
    """The first screen of the campaign's report."""
    document = view.document
    title = str(deep(document, "settings", "title") or "campaign")
    value = str(deep(document, "verdict", "value"))
    return Head(
        title=f"Adequacy report: {title}",
        tested=_tested(document.get("passes") or []),
        verdict=value,
        verdict_label="Verdict on the model, scope: campaign",
        meaning=MEANINGS.get(value, ""),
        reasons=tuple(sentence(str(reason)) for reason in deep(document, "verdict", "reasons") or ()),
        numbers=tuple(_number(document, kind) for kind in NAMES),
        scope=SCOPE,
        footer=f"smts-validate {package_version()}. Charts by uPlot (MIT licence).",
        short=f"smts-validate {package_version()}  ·  {title}",
    )


def _tested(passes: Sequence[Mapping[str, Any]]) -> str:
    def count(key: str, one: str, many: str) -> str:
        number = len({entry[key] for entry in passes})
        return f"{number} {one if number == 1 else many}"

    parts = (
        count("run", "pass", "passes"),
        count("field", "field", "fields"),
        count("direction", "direction", "directions"),
        count("variant", "version of the parameters", "versions of the parameters"),
    )
    return ", ".join(parts) + "."


def _number(document: Mapping[str, Any], kind: str) -> Number:
    found: Mapping[str, Any] = deep(document, "discrepancy", kind) or {}
    ends = found.get("interval")
    words = f"{interval(ends)} with measuring error taken out" if ends else "no interval"
    if found.get("combined") is None:
        words = "no percentage can be given"
    details = (
        ("tractor", percent(found.get("body1"))),
        ("seeder", percent(found.get("body2"))),
        ("paper", percent(PAPER[kind], 0)),
        ("threshold", percent(deep(document, "verdict", "threshold_percent"), 0)),
    )
    return Number(NAMES[kind], percent(found.get("combined")), words, details)
