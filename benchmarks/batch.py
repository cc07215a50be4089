"""Batch speed: passes a minute in one worker process, in two, and on Dask with two workers.

    python benchmarks/batch.py [--passes 24] [--seconds 60] [--workers 2] [--rounds 1]

Synthetic raw passes are made first (not counted), and one is run so that compiled code is cached. To hold it to
two cores: `taskset -c 0,1 python benchmarks/batch.py`. Rounds take the three by turns, and their medians come last: the
speed of a machine that others share changes within minutes.
Efficiency = time with one worker / (workers × time with that many). CPU seconds: of computing the passes, and of
all processes (imports, campaign, Dask's own) over the passes.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import psutil
from smts_validate.pipeline.cores import cores

COMMAND = [sys.executable, "-m", "smts_validate.pipeline.cli"]
FEWER_CHORES = {  # as docs/howto-cluster.md starts scheduler and workers
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__WORKER__MEMORY__MONITOR_INTERVAL": "1s",
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
CAMPAIGN = """
seed = 1
repeats = {repeats}
directions = ["east", "west"]
[base.path]
duration = {seconds}
row_length = {length}
"""


@dataclass(frozen=True)
class Timing:
    """One batch: wall seconds of the whole command, CPU seconds of its passes and of all processes."""

    wall: float
    cpu: float
    cpu_of_all: float
    passes: int


def make_passes(folder: Path, passes: int, seconds: float) -> None:
    """Half of the passes eastward, half westward."""
    plan = folder / "plan.toml"
    length = max(70.0, 2.8 * seconds)
    plan.write_text(CAMPAIGN.format(repeats=passes // 2, seconds=seconds, length=length), encoding="utf-8")
    subprocess.run(
        [*COMMAND, "synth", str(folder / "raw"), "--campaign", str(plan)],
        check=True,
        stdout=subprocess.DEVNULL,
    )


def cpu_so_far() -> float:
    """CPU seconds of this process and all its descendants, ended ones too."""
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    alive = sum(sum(child.cpu_times()[:4]) for child in psutil.Process().children(recursive=True))
    return time.process_time() + ended.ru_utime + ended.ru_stime + alive


def run(raw: Path, out: Path, *options: str) -> Timing:
    """One batch from the command line."""
    begin, cpu = time.perf_counter(), cpu_so_far()
    command = [*COMMAND, "batch", str(raw), "-o", str(out), "--json", *options]
    ran = subprocess.run(
        command, capture_output=True, text=True, env={**os.environ, **ONE_THREAD}, check=False
    )
    wall, cpu = time.perf_counter() - begin, cpu_so_far() - cpu
    events = [json.loads(line) for line in ran.stdout.splitlines()]
    done = [event for event in events if event["event"] == "done"]
    if ran.returncode != 0 or not done:
        sys.exit(f"the batch failed: {ran.stderr.strip()} {[e.get('reason') for e in events]}")
    return Timing(wall, sum(event["cpu_seconds"] for event in done), cpu, len(done))


def report(name: str, timing: Timing, efficiency: float) -> None:
    """One line of the table."""
    print(
        f"{name:<24}{timing.wall:8.1f} s{60.0 * timing.passes / timing.wall:9.1f} passes/min"
        f"{timing.cpu / timing.passes:8.2f} CPU s/pass ({timing.cpu_of_all / timing.passes:.2f} with all else)"
        f"   efficiency {efficiency:.2f}"
    )


def one_round(raw: Path, folder: Path, workers: int) -> dict[str, tuple[int, Timing]]:
    """Each way of running the passes once: its workers and its times."""
    from distributed import LocalCluster

    found = {
        "1 process": (1, run(raw, folder / "one", "-j", "1")),
        f"{workers} processes": (workers, run(raw, folder / "several", "-j", str(workers))),
    }
    with LocalCluster(
        n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        dask = run(raw, folder / "dask", "--scheduler", cluster.scheduler_address)
    return {**found, f"Dask, {workers} workers": (workers, dask)}


def middle(timings: list[Timing]) -> Timing:
    """Median of each figure."""
    wall, cpu, everything = (
        median(getattr(timing, name) for timing in timings) for name in ("wall", "cpu", "cpu_of_all")
    )
    return Timing(wall, cpu, everything, timings[0].passes)


def main() -> None:
    """Make the passes, run the batches, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--passes", type=int, default=24)
    parser.add_argument("--seconds", type=float, default=60.0, help="length of a pass")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=1)
    asked = parser.parse_args()
    os.environ.update(ONE_THREAD | FEWER_CHORES)  # before Dask is imported: it reads its settings then
    with tempfile.TemporaryDirectory(prefix="smts-bench-") as name:
        folder = Path(name)
        make_passes(folder, asked.passes, asked.seconds)
        raw = folder / "raw"
        first = next(path for path in sorted(raw.iterdir()) if (path / "run.toml").is_file())
        run(first, folder / "warm", "-j", "1")
        print(
            f"{asked.passes} passes of {asked.seconds:g} s on {cores()} cores, whole command with campaign and reports"
        )
        times: dict[str, list[Timing]] = {}
        shares: dict[str, list[float]] = {}
        for k in range(asked.rounds):
            found = one_round(raw, folder / f"round{k}", asked.workers)
            alone = found["1 process"][1]
            for title, (workers, timing) in found.items():
                times.setdefault(title, []).append(timing)
                shares.setdefault(title, []).append(alone.wall / (workers * timing.wall))
                report(title, timing, shares[title][-1])
        if asked.rounds > 1:
            print(f"medians of {asked.rounds} rounds")
            for title in times:
                report(title, middle(times[title]), median(shares[title]))


if __name__ == "__main__":
    main()
