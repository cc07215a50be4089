"""Stand-ins for a pass, for tests of the batch's own machinery: quick, and as unkind as asked for."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from smts_validate.pipeline.batch_find import Source
from smts_validate.pipeline.batch_task import Outcome, Task
from smts_validate.pipeline.run_settings import RunSettings


def task(run: str, source: str = "", out: str = "") -> Task:
    return Task(run=run, source=Source(source or run), out=out, work="w", settings=RunSettings())


def succeed(one: Task) -> Outcome:
    return Outcome(one.run, one.source.path, "done", verdict=str(os.getpid()))


def fail_when_named_bad(one: Task) -> Outcome:
    if one.run.startswith("bad"):
        return Outcome(one.run, one.source.path, "failed", "imd1.csv: no rows")
    return succeed(one)


def die_when_named_deadly(one: Task) -> Outcome:
    """Killed as the kernel kills when memory runs out."""
    _count(one)
    if one.run.startswith("deadly"):
        os.kill(os.getpid(), signal.SIGKILL)
    return succeed(one)


def die_the_first_time(one: Task) -> Outcome:
    if _count(one) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return succeed(one)


def nap(one: Task) -> Outcome:
    _count(one)
    time.sleep(0.3)
    return succeed(one)


def _count(one: Task) -> int:
    """How often a pass was tried, kept in a file of its own, as memory dies with the worker."""
    tries = Path(one.out) / f"{one.run}.tries"
    with tries.open("a", encoding="ascii") as file:
        file.write("x")
    return len(tries.read_text(encoding="ascii"))
