"""Seconds of each stage of one pass, raw to report, on the sample: the first run of this process, and the second.

    python benchmarks/chain.py [PASS_FOLDER]

The first run compiles what the disk cache does not hold yet. Wall seconds, and seconds of CPU in all threads.
Last, as processes of their own: warm, the imports alone and the whole command; then the whole command on two cores and
on four where nothing is compiled, and once more after that.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from smts_validate.pipeline.remake import remake
from smts_validate.pipeline.report import finish
from smts_validate.pipeline.result import write_result
from smts_validate.pipeline.run import compute, run_pass
from smts_validate.sensors.ingest import read_pass

Seconds = tuple[float, float]  # wall, CPU
IMPORTS = """
from smts_validate.pipeline.garbage import leave_the_rest, seldom_collected
with seldom_collected():
    import smts_validate.pipeline.run
leave_the_rest()
"""
RUN = "from smts_validate.pipeline.cli import main; main()"


def stages(folder: Path) -> dict[str, Seconds]:
    """Seconds by stage; the last is the pass in one call, as a batch's worker makes it."""
    found: dict[str, Seconds] = {}
    clocks = time.perf_counter, time.process_time

    def lap(name: str, begin: Seconds) -> Seconds:
        now = clocks[0](), clocks[1]()
        found[name] = now[0] - begin[0], now[1] - begin[1]
        return now

    with tempfile.TemporaryDirectory() as out:
        at = clocks[0](), clocks[1]()
        log = read_pass(folder)
        at = lap("read raw", at)
        result = run_pass(log)
        at = lap("fuse, replay, compare, judge", at)
        write_result(Path(out) / "result", result, finish)
        at = lap("tables and reports", at)
        remake(Path(out) / "result")
        at = lap("reports again", at)
        compute(folder, Path(out) / "whole")
        lap("whole pass in one call", at)
    return found


def process(*arguments: str, compiled: str | None = None) -> Seconds:
    """Seconds of a Python process and its children from its start to its end.

    compiled : folder of compiled code; the usual one where it is not given
    """
    environment = os.environ if compiled is None else {**os.environ, "NUMBA_CACHE_DIR": compiled}
    begin, used = time.perf_counter(), _used()
    subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL, env=environment)
    return time.perf_counter() - begin, _used() - used


def on_few_cores(count: int, *arguments: str) -> tuple[Seconds, Seconds]:
    """A process on so many of this machine's cores with nothing compiled, and the same once more."""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, sorted(before)[:count])
        with tempfile.TemporaryDirectory() as compiled:
            return process(*arguments, compiled=compiled), process(*arguments, compiled=compiled)
    finally:
        os.sched_setaffinity(0, before)


def _used() -> float:
    of = resource.getrusage(resource.RUSAGE_CHILDREN)
    return of.ru_utime + of.ru_stime


def best(of: Callable[[], Seconds], times: int = 3) -> Seconds:
    """The run with the least CPU."""
    return min((of() for _ in range(times)), key=lambda seconds: seconds[1])


def main() -> None:
    """Print the table."""
    given = (
        Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "data_samples" / "field1"
    )
    first, second = stages(given), stages(given)
    for name, (wall, cpu) in first.items():
        again = "{:6.2f} s, CPU {:6.2f} s".format(*second[name])
        print(f"{name:30s} first {wall:6.2f} s, CPU {cpu:6.2f} s   second {again}")
    with tempfile.TemporaryDirectory() as out:
        whole = ("-c", RUN, "run", str(given), "-o", f"{out}/result")
        for name, arguments in (("process: imports", ("-c", IMPORTS)), ("process: smts-validate run", whole)):
            wall, cpu = best(lambda arguments=arguments: process(*arguments))
            print(f"{name:30s} {wall:6.2f} s, CPU {cpu:6.2f} s")
        for count in (2, 4):
            if count <= len(os.sched_getaffinity(0)):
                cold, warm = ("{:6.2f} s, CPU {:6.2f} s".format(*of) for of in on_few_cores(count, *whole))
                print(f"{f'the same on {count} cores':30s} not compiled {cold}   compiled {warm}")


if __name__ == "__main__":
    main()
