"""Fuzz each parser of raw input for a while: `python fuzz/run.py [--seconds 60] [--target nmea]`.

A target may refuse what it is given with its own named error, in one line; anything else is a find, and so
is an answer that breaks the target's promise (a number that is not finite, time that falls back). Each target
runs in a process of its own with a limit on time and memory; inputs that are new stay in `fuzz/found/` (not
under version control). Ends with status 1 when something was found.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
SCRIPTS = {"mcap": (str(HERE / "fuzz_mcap.py"),)}
TARGETS = ("nmea", "csv", "manifest", "gnss", "bus", "mcap")
SECONDS_A_INPUT = 10
MEGABYTES = 3000
SLICE = 60  # s: atheris 3.0 never frees the results of compared arrays, so no process may run for long


def fuzz(target: str, seconds: int, found: Path) -> tuple[int, int]:
    """Run one target, slice by slice on a growing corpus; its number of executions and its exit status."""
    total = 0
    for start in range(0, seconds, SLICE):
        count, status = _slice(target, min(SLICE, seconds - start), found)
        total += count
        if status != 0:
            return total, status
    return total, 0


def _slice(target: str, seconds: int, found: Path) -> tuple[int, int]:
    grown = found / target
    grown.mkdir(parents=True, exist_ok=True)
    command = [
        *(sys.executable, *SCRIPTS.get(target, (str(HERE / "targets.py"), target))),
        *(str(grown), str(HERE / "corpus" / target)),
        f"-max_total_time={seconds}",
        f"-timeout={SECONDS_A_INPUT}",
        f"-rss_limit_mb={MEGABYTES}",
        f"-artifact_prefix={found}/{target}-",
        "-print_final_stats=1",
        "-max_len=6000",
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    log = done.stdout + done.stderr
    executions = re.search(r"number_of_executed_units:\s*(\d+)", log) or re.search(r"Done (\d+) runs", log)
    if done.returncode != 0:
        print(log[-6000:])
    return int(executions.group(1)) if executions else 0, done.returncode


def main() -> int:
    """Fuzz the chosen targets in turn, sharing the time."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=int, default=60, help="in total")
    parser.add_argument("--target", choices=TARGETS, action="append")
    parser.add_argument("--found", type=Path, default=HERE / "found")
    options = parser.parse_args()
    targets = options.target or list(TARGETS)
    worst = 0
    for target in targets:
        count, status = fuzz(target, max(options.seconds // len(targets), 1), options.found)
        print(f"{target:9s} {count:10d} executions, {'nothing found' if status == 0 else 'FOUND, see above'}")
        worst = max(worst, status)
    return 1 if worst else 0


if __name__ == "__main__":
    sys.exit(main())
