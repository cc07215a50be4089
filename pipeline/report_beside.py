"""Reports made by a process of their own: it gets ready while the pass is being computed, on the second core."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from .batch_executors import WorkerSlots
from .cores import cores
from .garbage import seldom_collected

Work = Callable[[], None]
Finish = Callable[[Path], None]


@contextmanager
def reports_beside(figures: bool = False, after: Work | None = None) -> Iterator[tuple[Work | None, Finish]]:
    """What to call before the pass is computed, if anything, and what makes log and reports of a result's folder.

    The second is for `write_result`. The process ends with the block. On a single core it is this one that makes them.

    figures : whether each figure is also left as files
    after : done by the first, which then has the process get ready; without it, it does so from the start
    """
    if cores() < 2:
        yield after, partial(make_reports, figures=figures)
        return
    slots = WorkerSlots(1)
    finish = partial(_made_by, slots, figures=figures)
    try:
        if after is None:
            slots.submit(get_ready)
            yield None, finish
        else:
            yield partial(_in_turn, after, partial(slots.submit, get_ready)), finish
    finally:
        slots.shutdown(wait=False)


def _in_turn(*works: Callable[[], object]) -> None:
    for work in works:
        work()


def _made_by(slots: WorkerSlots, folder: Path, figures: bool) -> None:
    try:
        slots.submit(make_reports, folder, figures).result()
    except BrokenExecutor:  # killed, for want of memory say: the pass is not lost for that
        make_reports(folder, figures)
    except KeyboardInterrupt:  # it must be gone before the folder that it writes in is removed
        slots.shutdown()
        raise


def get_ready() -> None:
    """Import what reports need, and draw what every one of them holds."""
    with seldom_collected():
        from . import report

        report.draw_equations()


def make_reports(folder: Path, figures: bool) -> None:
    """Make the log and the reports of the result in `folder`, and each figure as files where asked."""
    with seldom_collected():
        from .report import finish, sections_of, write_figures
        from .result import FIGURES, read_result

        finish(folder)
        if figures:
            write_figures(sections_of(read_result(folder)), folder / FIGURES)
