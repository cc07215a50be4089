"""CPU of the command line's start: `smts-validate --help`, beside an interpreter that does nothing.

    python benchmarks/start_up.py [--runs 15]

Milliseconds of CPU in all threads, the smallest of several processes each: what else the machine does only adds.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys

EMPTY = [sys.executable, "-c", "pass"]
HELP = [sys.executable, "-m", "smts_validate.pipeline.cli", "--help"]


def cpu(command: list[str]) -> float:
    """CPU seconds of one process."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=15)
    runs = range(parser.parse_args().runs)
    for title, command in (("python alone", EMPTY), ("smts-validate --help", HELP)):
        print(f"{title:<24}{1000.0 * min(cpu(command) for _ in runs):6.0f} ms CPU")
