"""A batch's progress in words, in JSON and as a live table (the command line shows it)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .batch_loop import Progress

if TYPE_CHECKING:
    from rich.table import Table


def line(progress: Progress) -> str:
    """One plain line for a pass that ended, or for a note; empty when only time has passed."""
    if progress.note:
        return progress.note
    last = progress.last
    if last is None:
        return ""
    count = f"[{progress.ended}/{progress.total}]"
    if last.status == "failed":
        return f"{count} {last.run}: failed: {last.reason}"
    if last.status == "unchanged":
        return f"{count} {last.run}: unchanged ({last.verdict})"
    return f"{count} {last.run}: {last.verdict}, {last.seconds:.1f} s{_left(progress)}"


def _left(progress: Progress) -> str:
    return f", {duration(progress.time_left)} left" if progress.time_left else ""


def duration(seconds: float | None) -> str:
    """`1 h 05 min`, `3 min 20 s`, `12 s`."""
    if seconds is None:
        return "-"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"


def event(progress: Progress) -> dict[str, Any] | None:
    """The same for a machine: one object a pass that ended or a note; None when only time has passed."""
    counts = {"total": progress.total, "done": progress.done, "unchanged": progress.unchanged}
    counts |= {"failed": progress.failed}
    if progress.note:
        return {"event": "note", "note": progress.note, **counts}
    last = progress.last
    if last is None:
        return None
    return {
        "event": last.status,
        "run": last.run,
        "source": last.source,
        "reason": last.reason or None,
        "verdict": last.verdict or None,
        "discrepancy": last.discrepancy,
        "seconds": round(last.seconds, 3),
        "cpu_seconds": round(last.cpu_seconds, 3),
        **counts,
    }


def live_table(progress: Progress) -> Table:
    """Done, running, failed and the time left, for a terminal."""
    from rich.table import Table

    table = Table(title=f"{progress.ended} of {progress.total} passes", title_justify="left")
    for header in ("done", "unchanged", "failed", "running", "elapsed", "time left"):
        table.add_column(header)
    table.add_row(
        str(progress.done),
        str(progress.unchanged),
        str(progress.failed),
        ", ".join(progress.running) or "-",
        duration(progress.elapsed),
        duration(progress.time_left),
    )
    return table
