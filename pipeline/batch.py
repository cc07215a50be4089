"""Many passes, then the campaign: find, plan, run over any `concurrent.futures.Executor`, sum up.

What is slow to import is imported late: the workers get ready meanwhile.
"""

from __future__ import annotations

import os
import shlex
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .batch_campaign import summarise
from .batch_executors import SerialExecutor, WorkerSlots, dask_executor
from .batch_find import CAMPAIGN, find, is_url, read_bytes
from .batch_limits import Limits
from .batch_loop import BatchRun, Watch, run_all
from .batch_plan import Plan, Terms, plan
from .batch_store import PASSES, work_folder
from .batch_task import Outcome, Task, get_ready, run_task

if TYPE_CHECKING:
    from .campaign_settings import CampaignSettings


@dataclass(frozen=True)
class Request:
    """What to run. workers: processes of this machine, 0: this one alone; scheduler: a Dask address."""

    paths: tuple[str, ...]
    out: str
    workers: int = 1
    scheduler: str | None = None
    resume: bool = True
    campaign: str | None = None
    limits: Limits = Limits()
    summarise: bool = True


def run_batch(request: Request, watch: Watch, work: Callable[[Task], Outcome] = run_task) -> dict[str, Any]:
    """Run every pass under the paths, then the campaign over all that have a result.

    Returns the summary: counts, failures, and the campaign's verdict (None without a pass that succeeded).
    Raises FindError when there is nothing to run, CampaignError for a campaign.toml that cannot be used,
    InterruptedBatch on Ctrl-C.
    """
    if request.scheduler:
        request = absolute(request)
    found = find(request.paths, request.out)
    executor, slots = _executor(request, len(found.sources))
    with _dismissed_after(executor, request):
        _start_workers(executor, min(slots, len(found.sources)), request)
        campaign = read_campaign(request.campaign or found.campaign)
        # Workers of our own must be gone before the folder that they write in is removed.
        with work_folder(request.out) as folder, _dismissed_after(executor, request):
            planned = plan(found.sources, _terms(request, folder, campaign))
            ran = _with_refused(run_all(planned.tasks, executor, slots, watch, work), planned)
            failed = {outcome.run for outcome in ran.failures}
            runs = tuple(task.run for task in planned.tasks if task.run not in failed)
            summary = _summary(request, ran)
            if request.summarise:
                # A worker sums up: what it reads of the passes stays out of this process.
                arguments = (request.out, runs, summary["failures"], campaign)
                summary |= executor.submit(summarise, *arguments).result()
            return summary


def _terms(request: Request, folder: str, campaign: CampaignSettings) -> Terms:
    from .run_settings import of_campaign

    return Terms(request.out, folder, of_campaign(campaign), request.resume, request.limits)


def absolute(request: Request) -> Request:
    """The request with paths that mean the same on workers with another working folder."""
    paths = tuple(path if is_url(path) else os.path.abspath(path) for path in request.paths)
    out = request.out if is_url(request.out) else os.path.abspath(request.out)
    return replace(request, paths=paths, out=out)


def _with_refused(ran: BatchRun, planned: Plan) -> BatchRun:
    failures = sorted((*ran.failures, *planned.refused), key=lambda outcome: (outcome.run, outcome.source))
    return replace(ran, total=ran.total + len(planned.refused), failures=tuple(failures))


def _summary(request: Request, ran: BatchRun) -> dict[str, Any]:
    failures = [{"run": f.run, "source": f.source, "reason": f.reason} for f in ran.failures]
    return {
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


def _executor(request: Request, passes: int) -> tuple[Executor, int]:
    if request.scheduler:
        return dask_executor(request.scheduler)
    if request.workers == 0:
        return SerialExecutor(), 1
    slots = max(1, min(request.workers, passes))
    return WorkerSlots(slots), slots


def _start_workers(executor: Executor, count: int, request: Request) -> None:
    """Have the workers import what they need while this process is still finding out what is to be done."""
    if isinstance(executor, SerialExecutor):
        return
    nothing_stored = not is_url(request.out) and not (Path(request.out) / PASSES).is_dir()
    for _ in range(count):
        executor.submit(get_ready, nothing_stored or not request.resume)


@contextmanager
def _dismissed_after(executor: Executor, request: Request) -> Iterator[None]:
    """Workers of our own leave with the block's end, those of a cluster stay."""
    try:
        yield
    finally:
        executor.shutdown(wait=not request.scheduler, cancel_futures=True)


def read_campaign(path: str | None) -> CampaignSettings:
    """The settings of a campaign.toml, on disk or behind a URL; the defaults without one."""
    from .campaign_settings import read_settings

    if path is None or not is_url(path):
        return read_settings(None if path is None else Path(path))
    with tempfile.TemporaryDirectory(prefix="smts-") as folder:
        copy = Path(folder) / CAMPAIGN
        copy.write_bytes(read_bytes(path))
        return read_settings(copy)


def commands(request: Request) -> list[str]:
    """One shell command a pass, each alone, for a job array, and last the one that makes the campaign.

    The passes' commands may run in any order and at the same time, on any machine that sees the paths.
    """
    found = find(request.paths, request.out)
    campaign = request.campaign or found.campaign
    tail = ["-o", request.out, *(("--campaign", campaign) if campaign else ())]
    alone = [["-j", "0", "--no-campaign", *tail, source.path] for source in found.sources]
    return [shlex.join(["smts-validate", "batch", *words]) for words in (*alone, [*tail, *request.paths])]
