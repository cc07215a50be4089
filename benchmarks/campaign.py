"""Campaign speed: statistics and report of many stored passes.

    python benchmarks/campaign.py [--passes 100]

A few synthetic passes are run through the whole chain first (not counted) and stored under many names, so that
reading, statistics, operating curves and the report are those of a real campaign. Limit: 60 s for 100 passes.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from smts_validate.pipeline.batch_campaign import write_campaign
from smts_validate.pipeline.campaign import read_record, summarise_campaign
from smts_validate.pipeline.campaign_settings import CampaignSettings
from smts_validate.pipeline.run import compute
from smts_validate.pipeline.tables import campaign_tables
from smts_validate.pipeline.twin import make_pass, write_raw
from smts_validate.pipeline.twin_plan import preset

LIMIT = 60.0  # s for 100 passes
KINDS = 4


def store_passes(folder: Path, count: int) -> list[str]:
    """`count` results under folder/passes, made from four computed ones."""
    base = preset("benign")
    for kind in range(KINDS):
        plan = replace(base, path=replace(base.path, duration=50.0), run=replace(base.run, id=f"kind-{kind}"))
        write_raw(make_pass(plan, kind), folder / "raw" / f"kind-{kind}")
        compute(folder / "raw" / f"kind-{kind}", folder / "made" / f"kind-{kind}")
    runs = [f"pass-{i}" for i in range(count)]
    for i, run in enumerate(runs):
        target = folder / "passes" / run
        shutil.copytree(folder / "made" / f"kind-{i % KINDS}", target)
        rename(target, f"kind-{i % KINDS}", run, ("east", "west")[i % 2])
    return runs


def rename(folder: Path, old: str, new: str, direction: str) -> None:
    """Give a stored pass another name and direction."""
    text = (folder / "run.toml").read_text(encoding="utf-8").replace(f'id = "{old}"', f'id = "{new}"')
    text = text.replace('direction = "east"', f'direction = "{direction}"')
    (folder / "run.toml").write_text(text, encoding="utf-8")
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    (folder / "metrics.json").write_text(json.dumps(metrics | {"run": new}), encoding="utf-8")


def timed(folder: Path, runs: list[str]) -> tuple[float, float]:
    """Seconds for the statistics alone, and for everything that a batch's last task does."""
    start = time.perf_counter()
    campaign_tables(summarise_campaign([read_record(folder / "passes" / run) for run in runs]))
    statistics = time.perf_counter() - start
    start = time.perf_counter()
    write_campaign(folder, runs, CampaignSettings())
    return statistics, time.perf_counter() - start


def main() -> None:
    """Print the timings, and fail above the limit."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--passes", type=int, default=100)
    count = parser.parse_args().passes
    with tempfile.TemporaryDirectory() as name:
        runs = store_passes(Path(name), count)
        statistics, whole = timed(Path(name), runs)
    print(f"{count} passes: statistics and tables {statistics:.1f} s, with reports {whole:.1f} s")
    if whole > LIMIT * max(count / 100.0, 1.0):
        raise SystemExit(f"slower than {LIMIT:.0f} s for 100 passes")


if __name__ == "__main__":
    main()
