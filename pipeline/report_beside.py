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

Finish = Callable[[Path], None]


@contextmanager
def reports_beside(figures: bool = False) -> Iterator[Finish]:
    """What makes the log and the reports of a result's folder, for `write_result`; its process ends with the block.

    figures : whether each figure is also left as files. On a single core it is this process that makes them.
    """
    if cores() < 2:
        yield partial(make_reports, figures=figures)
        return
    slots = WorkerSlots(1)
    try:
        slots.submit(get_ready)
        yield partial(_made_by, slots, figures=figures)
    finally:
        slots.shutdown(wait=False)


def _made_by(slots: WorkerSlots, folder: Path, figures: bool) -> None:
    try:
        slots.submit(make_reports, folder, figures).result()
    except BrokenExecutor:  # killed, for want of memory say: the pass is not lost for that
        make_reports(folder, figures)


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
