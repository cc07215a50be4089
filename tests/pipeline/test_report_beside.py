"""Reports made by a process of their own: the same bytes, the same errors, and nobody left behind."""

from __future__ import annotations

import os
import signal
import threading
import time
from pathlib import Path

import psutil
import pytest
import report_samples as samples
from smts_validate.pipeline import report, report_beside
from smts_validate.pipeline.batch_executors import WorkerSlots
from smts_validate.pipeline.report_beside import reports_beside
from smts_validate.pipeline.result import METRICS, ResultError, write_result

PATIENCE = 20.0  # s
PROCESS = "process"  # file that names the one at work


@pytest.fixture(autouse=True)
def nobody_left() -> None:
    """The process of the test before, which a block dismisses without waiting, is gone before the next begins."""
    psutil.wait_procs(psutil.Process().children(), timeout=PATIENCE)


def test_another_process_makes_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    result = samples.pass_result()
    here = write_result(tmp_path / "here", result, report.finish)
    monkeypatch.setattr(report_beside, "cores", lambda: 2)
    with reports_beside() as (_, finish):
        beside = write_result(tmp_path / "beside", result, finish)
    names = {path.name for path in here.iterdir()}
    assert names == {path.name for path in beside.iterdir()}
    assert "report.html" in names
    for name in names:
        assert (beside / name).read_bytes() == (here / name).read_bytes(), name


def test_an_error_of_the_reports_arrives_and_leaves_no_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_beside, "cores", lambda: 2)
    with reports_beside() as (_, finish):

        def without_metrics(folder: Path) -> None:
            (folder / METRICS).unlink()
            finish(folder)

        with pytest.raises(ResultError, match=r"has no metrics\.json"):
            write_result(tmp_path / "out", samples.pass_result(), without_metrics)
    assert list(tmp_path.iterdir()) == []


def test_a_killed_process_costs_no_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_beside, "cores", lambda: 2)
    with reports_beside() as (_, finish):
        for child in children_once_there():
            child.kill()
        out = write_result(tmp_path / "out", samples.pass_result(), finish)
    assert (out / "report.html").stat().st_size > 0


def test_when_interrupted_the_process_is_gone_before_the_folder_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_beside, "cores", lambda: 2)
    monkeypatch.setattr(report_beside, "make_reports", take_forever)
    with reports_beside() as (_, finish):

        def interrupted(folder: Path) -> None:
            threading.Thread(target=interrupt_once_there, args=(folder / PROCESS,)).start()
            try:
                finish(folder)
            finally:
                with pytest.raises(ProcessLookupError):
                    os.kill(int((folder / PROCESS).read_text()), 0)

        with pytest.raises(KeyboardInterrupt):
            write_result(tmp_path / "out", samples.pass_result(), interrupted)
    assert list(tmp_path.iterdir()) == []


def test_the_process_ends_with_the_block_also_when_the_pass_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(report_beside, "cores", lambda: 2)
    with pytest.raises(ValueError, match="refused"), reports_beside():
        started = children_once_there()
        raise ValueError("refused")
    _, alive = psutil.wait_procs(started, timeout=PATIENCE)
    assert not alive, "the process for the reports is still there"


def test_a_single_core_makes_the_reports_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_beside, "cores", lambda: 1)
    monkeypatch.setattr(report_beside, "WorkerSlots", none_wanted)
    with reports_beside(figures=True) as (_, finish):
        out = write_result(tmp_path / "out", samples.pass_result(), finish)
    assert (out / "report.pdf").is_file()
    assert any((out / "figures").glob("*.svg"))


def test_what_must_come_first_is_done_before_the_process_is_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(report_beside, "cores", lambda: 2)
    seen: list[int] = []
    with reports_beside(after=lambda: seen.append(len(psutil.Process().children()))) as (before, _):
        before()
        assert seen == [0]
        assert len(children_once_there()) == 1


def take_forever(folder: Path, figures: bool) -> None:
    """In place of making reports."""
    (folder / "begun").write_text(str(os.getpid()))
    (folder / "begun").rename(folder / PROCESS)
    time.sleep(600.0)


def interrupt_once_there(path: Path) -> None:
    """As Ctrl-C does, once that file is there."""
    until = time.monotonic() + PATIENCE
    while not path.exists() and time.monotonic() < until:
        time.sleep(0.02)
    signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def none_wanted(count: int) -> WorkerSlots:
    """In place of the processes."""
    raise AssertionError("a process of its own was started on a single core")


def children_once_there() -> list[psutil.Process]:
    """Processes of this one, once there is one."""
    until = time.monotonic() + PATIENCE
    while not (found := psutil.Process().children()):
        assert time.monotonic() < until, "no process was started"
        time.sleep(0.02)
    return found
