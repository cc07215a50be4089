"""Seconds of each stage of one pass, raw to report, on the sample: the first run of this process, and the second.

    python benchmarks/chain.py [PASS_FOLDER]

The first run compiles what the disk cache does not hold yet.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from smts_validate.pipeline.remake import remake
from smts_validate.pipeline.report import finish
from smts_validate.pipeline.result import write_result
from smts_validate.pipeline.run import run_pass
from smts_validate.sensors.ingest import read_pass


def stages(folder: Path) -> dict[str, float]:
    """Wall seconds by stage."""
    found: dict[str, float] = {}

    def lap(name: str) -> None:
        found[name] = time.perf_counter() - begin - sum(found.values())

    with tempfile.TemporaryDirectory() as out:
        begin = time.perf_counter()
        log = read_pass(folder)
        lap("read raw")
        result = run_pass(log)
        lap("fuse, replay, compare, judge")
        write_result(Path(out) / "result", result, finish)
        lap("tables and reports")
        remake(Path(out) / "result")
        lap("reports again")
    return found


if __name__ == "__main__":
    given = (
        Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "data_samples" / "field1"
    )
    first, second = stages(given), stages(given)
    for name, seconds in first.items():
        print(f"{name:30s} first {seconds:6.2f} s   second {second[name]:6.2f} s")
