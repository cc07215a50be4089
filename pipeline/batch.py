"""Many passes, then the campaign: find, plan, run over any `concurrent.futures.Executor`, sum up."""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .batch_campaign import summarise
from .batch_executors import SerialExecutor, WorkerSlots, dask_executor
from .batch_find import find
from .batch_limits import Limits
from .batch_loop import BatchRun, Watch, run_all
from .batch_plan import Plan, Terms, plan
from .batch_store import Store, open_store, work_folder
from .batch_task import Outcome, Task, run_task
from .run import RunSettings

FAILURES = "failures.json"


@dataclass(frozen=True)
class Request:
    """What to run. workers: processes of this machine, 0: this one alone; scheduler: a Dask address."""

    paths: tuple[str, ...]
    out: str
    workers: int = 1
    scheduler: str | None = None
    resume: bool = True
    campaign: str | None = None
    settings: RunSettings = RunSettings()
    limits: Limits = Limits()
    summarise: bool = True


def run_batch(request: Request, watch: Watch, work: Callable[[Task], Outcome] = run_task) -> dict[str, Any]:
    """Run every pass under the paths, then the campaign over all that have a result.

    Returns the summary: counts, failures, and the campaign's verdict (None without a pass that succeeded).
    Raises FindError when there is nothing to run, InterruptedBatch on Ctrl-C.
    """
    found = find(request.paths, request.out)
    with work_folder(request.out) as folder:
        terms = Terms(request.out, folder, request.settings, request.resume, request.limits)
        planned = plan(found.sources, terms)
        ran = _run(planned, request, watch, work)
        store = open_store(request.out, folder)
        runs = [task.run for task in planned.tasks if task.run not in {f.run for f in ran.failures}]
        return _finish(store, ran, runs, request)


def _run(planned: Plan, request: Request, watch: Watch, work: Callable[[Task], Outcome]) -> BatchRun:
    with _executor(request, len(planned.tasks)) as (executor, slots):
        ran = run_all(planned.tasks, executor, slots, watch, work)
    failures = sorted((*ran.failures, *planned.refused), key=lambda outcome: (outcome.run, outcome.source))
    return replace(ran, total=ran.total + len(planned.refused), failures=tuple(failures))


@contextmanager
def _executor(request: Request, tasks: int) -> Iterator[tuple[Executor, int]]:
    if request.scheduler:
        executor, slots = dask_executor(request.scheduler)
    elif request.workers == 0:
        executor, slots = SerialExecutor(), 1
    else:
        slots = max(1, min(request.workers, tasks))
        executor = WorkerSlots(slots)
    try:
        yield executor, slots
    finally:
        executor.shutdown(wait=False, cancel_futures=True)


def _finish(store: Store, ran: BatchRun, runs: Sequence[str], request: Request) -> dict[str, Any]:
    failures = [{"run": f.run, "source": f.source, "reason": f.reason} for f in ran.failures]
    summary: dict[str, Any] = {
        "out": request.out,
        "passes": ran.total,
        "done": ran.done,
        "unchanged": ran.unchanged,
        "failed": len(failures),
        "seconds": round(ran.seconds, 3),
        "failures": failures,
        "verdict": None,
        "report": None,
    }
    if not request.summarise:
        return summary
    with store.local(runs) as out:
        write_whole(out / FAILURES, {"schema": 1, "failures": failures})
        if runs:
            summary |= summarise(out, runs, request.campaign)
    return summary


def write_whole(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON file under another name and rename it: it is whole or not there."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    os.replace(part, path)


def commands(request: Request) -> list[str]:
    """One shell command a pass, each alone, for a job array, and last the one that makes the campaign.

    The passes' commands may run in any order and at the same time, on any machine that sees the paths.
    """
    found = find(request.paths, request.out)
    tail = ["-o", request.out, *(("--campaign", request.campaign) if request.campaign else ())]
    alone = [["-j", "0", "--no-campaign", *tail, source.path] for source in found.sources]
    return [shlex.join(["smts-validate", "batch", *words]) for words in (*alone, [*tail, *request.paths])]
