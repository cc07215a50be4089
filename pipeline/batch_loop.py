"""Many passes over any `concurrent.futures.Executor`: each is one task, none takes another with it.

plan (find passes, name them) -> run (submit, watch, try lost ones again) -> finish (failures, campaign)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from dataclasses import dataclass, field
from time import monotonic

from .batch_task import Outcome, Task, one_line, run_task

TRIES = 3  # a pass whose worker was lost is tried again twice
LOOK_EVERY = 0.5  # s between looks, when nothing ends: keeps a progress display alive


class InterruptedBatch(Exception):  # noqa: N818 (it is no error)
    """Ctrl-C during a batch, after its workers were dismissed; the text says how to go on."""


@dataclass(frozen=True)
class Progress:
    """How far a batch is. last: the outcome that changed it; None: only time has passed."""

    total: int
    done: int
    unchanged: int
    failed: int
    running: tuple[str, ...]
    elapsed: float
    last: Outcome | None = None
    note: str = ""

    @property
    def ended(self) -> int:
        """Passes that are over, whatever became of them."""
        return self.done + self.unchanged + self.failed

    @property
    def time_left(self) -> float | None:
        """Seconds that the rest will take at the pace so far; None before the first computed pass."""
        computed = self.done + self.failed
        if computed == 0:
            return None
        return self.elapsed / computed * (self.total - self.ended)


Watch = Callable[[Progress], None]


@dataclass
class _Tally:
    """The parent's books while a batch runs: what is out, what is lost, what failed."""

    total: int
    begin: float = field(default_factory=monotonic)
    done: int = 0
    unchanged: int = 0
    pending: dict[Future[Outcome], tuple[Task, int]] = field(default_factory=dict)
    failures: list[Outcome] = field(default_factory=list)
    suspects: list[Task] = field(default_factory=list)

    def progress(self, slots: int, last: Outcome | None = None, note: str = "") -> Progress:
        running = tuple(task.run for task, _ in list(self.pending.values())[:slots])
        elapsed = monotonic() - self.begin
        return Progress(
            self.total, self.done, self.unchanged, len(self.failures), running, elapsed, last, note
        )

    def book(self, outcome: Outcome) -> None:
        if outcome.status == "failed":
            self.failures.append(outcome)
        elif outcome.status == "unchanged":
            self.unchanged += 1
        else:
            self.done += 1


@dataclass(frozen=True)
class BatchRun:
    """What came of running the tasks: counts, and the failures in the order of their runs."""

    total: int
    done: int
    unchanged: int
    failures: tuple[Outcome, ...]
    seconds: float


def run_all(
    tasks: Sequence[Task],
    executor: Executor,
    slots: int,
    watch: Watch = lambda progress: None,
    work: Callable[[Task], Outcome] = run_task,
) -> BatchRun:
    """Run the tasks, at most twice as many submitted as there are slots, and wait for all.

    watch : told of every pass that ends, and twice a second in between
    work : what a worker does with a task

    Raises InterruptedBatch on Ctrl-C, with the executor's pending tasks cancelled.
    """
    tally = _Tally(len(tasks))
    waiting = iter(tasks)
    try:
        _fill(tally, waiting, executor, slots, work)
        while tally.pending or tally.suspects:
            if not tally.pending:
                task = tally.suspects.pop()
                tally.pending[executor.submit(work, task)] = (task, TRIES)
            _collect(tally, executor, slots, watch, work)
            _fill(tally, waiting, executor, slots, work)
    except KeyboardInterrupt:
        executor.shutdown(wait=False, cancel_futures=True)
        ended = tally.done + tally.unchanged
        raise InterruptedBatch(
            f"interrupted: {ended} of {len(tasks)} passes are done; the same command goes on from there"
        ) from None
    failures = tuple(sorted(tally.failures, key=lambda outcome: outcome.run))
    return BatchRun(len(tasks), tally.done, tally.unchanged, failures, monotonic() - tally.begin)


def _fill(
    tally: _Tally, waiting: Iterator[Task], executor: Executor, slots: int, work: Callable[[Task], Outcome]
) -> None:
    while len(tally.pending) < 2 * slots and (task := next(waiting, None)) is not None:
        tally.pending[executor.submit(work, task)] = (task, 1)


def _collect(
    tally: _Tally, executor: Executor, slots: int, watch: Watch, work: Callable[[Task], Outcome]
) -> None:
    ended, _ = wait(tally.pending, timeout=LOOK_EVERY, return_when=FIRST_COMPLETED)
    if not ended:
        watch(tally.progress(slots))
    for future in ended:
        task, tries = tally.pending.pop(future)
        error = _error_of(future)
        if _worker_was_lost(error) and tries < TRIES:
            tally.pending[executor.submit(work, task)] = (task, tries + 1)
            watch(tally.progress(slots, note=f"{task.run}: its worker was lost; trying again on another"))
            continue
        if _may_be_innocent(error) and tries < TRIES:
            tally.suspects.append(task)
            watch(
                tally.progress(slots, note=f"{task.run}: its workers were lost; trying it alone at the end")
            )
            continue
        outcome = future.result() if error is None else _lost(task, tries, error)
        tally.book(outcome)
        watch(tally.progress(slots, last=outcome))


def _error_of(future: Future[Outcome]) -> BaseException | None:
    try:
        return future.exception()
    except CancelledError as error:
        return error


def _worker_was_lost(error: BaseException | None) -> bool:
    return isinstance(error, BrokenExecutor)


def _may_be_innocent(error: BaseException | None) -> bool:
    """Dask tries a lost worker's tasks again by itself, then says KilledWorker: also of a task that only
    waited on the same workers as the one that killed them."""
    return type(error).__name__ == "KilledWorker"


def _lost(task: Task, tries: int, error: BaseException) -> Outcome:
    """A pass that no worker brought to its end."""
    if _worker_was_lost(error) or _may_be_innocent(error):
        reason = (
            f"its worker died each of the {TRIES} times it was tried, as when memory runs out; run it alone"
            " with `smts-validate run`, or with fewer workers (-j)"
        )
    else:
        reason = f"the executor failed: {one_line(error)}"
    return Outcome(task.run, task.source.path, "failed", reason)
