"""From the stored results of a batch to the campaign's verdict, table and report: the batch's last task."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .batch_find import join
from .batch_store import PASSES, open_store
from .garbage import seldom_collected

if TYPE_CHECKING:  # their modules are slow to import, and the batch's parent does without
    from .batch_table import Row
    from .campaign_settings import CampaignSettings

DOCUMENT = "campaign.json"
TABLE = "campaign.parquet"
FAILURES = "failures.json"
REPORT = "report.html"


@seldom_collected()
def summarise(
    out: str, runs: Sequence[str], failures: Sequence[Mapping[str, Any]], settings: CampaignSettings
) -> dict[str, Any]:
    """Write failures.json and, of the runs that have a result, the campaign's files into OUT.

    Returns the campaign's verdict, discrepancy and report for the batch's summary; nothing without a run.
    Raises CampaignError where campaign.toml and the results do not fit.
    """
    with open_store(out, "").local(list(runs)) as folder:
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / FAILURES, json_text({"schema": 1, "failures": list(failures)}))
        if not runs:
            return {}
        document = write_campaign(folder, runs, settings)
    return {
        "verdict": document["verdict"],
        "discrepancy": document["discrepancy"],
        "report": join(out, REPORT) if (Path(out) / REPORT).is_file() else None,
    }


def write_campaign(folder: Path, runs: Sequence[str], settings: CampaignSettings) -> Mapping[str, Any]:
    """campaign.json and campaign.parquet of the stored passes of a local OUT; gives the former's content."""
    from .batch_table import write_rows
    from .campaign import read_record, summarise_campaign
    from .remake import remake_campaign

    part = folder / f".{TABLE}.part"
    write_rows(part, runs, lambda run: stored_row(folder / PASSES / run))
    os.replace(part, folder / TABLE)
    campaign = summarise_campaign([read_record(folder / PASSES / run) for run in runs], settings)
    write_whole(folder / DOCUMENT, json_text(campaign.document))
    remake_campaign(folder)
    return campaign.document


def stored_row(folder: Path) -> Row:
    """The campaign table's row of one stored result."""
    from ..sensors.manifest import read
    from .batch_table import row

    manifest, _ = read(folder / "run.toml")
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    return row(manifest.dated(metrics.get("provenance", {}).get("date")), metrics)


def json_text(document: Mapping[str, Any]) -> str:
    """Readable JSON without NaN."""
    from .result import dump_json

    return dump_json(document)


def write_whole(path: Path, text: str) -> None:
    """Write a file under another name and rename it: it is whole or not there."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)
