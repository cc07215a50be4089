"""The batch's own machinery: every pass ends in the books once, whatever its worker does."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import Future
from pathlib import Path

import batch_killed
import batch_samples
import psutil
import pytest
from smts_validate.pipeline import batch
from smts_validate.pipeline.batch_executors import SerialExecutor, WorkerSlots
from smts_validate.pipeline.batch_loop import InterruptedBatch, Progress, run_all
from smts_validate.pipeline.campaign_settings import CampaignError


def test_each_pass_is_counted_once_and_failures_are_listed_by_run() -> None:
    tasks = [batch_samples.task(run) for run in ("bad-2", "c", "a", "bad-1", "b")]
    result = run_all(tasks, SerialExecutor(), 1, work=batch_samples.fail_when_named_bad)
    assert (result.total, result.done, result.unchanged) == (5, 3, 0)
    assert [failure.run for failure in result.failures] == ["bad-1", "bad-2"]
    assert result.failures[0].reason == "imd1.csv: no rows"


def test_progress_counts_up_to_the_total_and_tells_the_time_left() -> None:
    seen: list[Progress] = []
    tasks = [batch_samples.task(str(i)) for i in range(7)]
    run_all(tasks, SerialExecutor(), 1, watch=seen.append, work=batch_samples.succeed)
    assert [progress.ended for progress in seen] == list(range(1, 8))
    assert seen[-1].time_left == 0.0
    assert all(progress.time_left is not None and progress.time_left >= 0.0 for progress in seen)


def test_workers_are_processes_of_their_own_and_live_on_between_passes() -> None:
    tasks = [batch_samples.task(str(i)) for i in range(8)]
    seen: list[Progress] = []
    with WorkerSlots(2) as slots:
        run_all(tasks, slots, 2, watch=seen.append, work=batch_samples.succeed)
    pids = {progress.last.verdict for progress in seen if progress.last}
    assert 1 <= len(pids) <= 2
    assert str(os.getpid()) not in pids


def test_a_pass_whose_worker_died_once_is_tried_again_and_done(tmp_path: Path) -> None:
    tasks = [batch_samples.task(run, out=str(tmp_path)) for run in ("a", "b")]
    with WorkerSlots(2) as slots:
        result = run_all(tasks, slots, 2, work=batch_samples.die_the_first_time)
    assert (result.done, result.failures) == (2, ())


def test_a_pass_that_kills_its_worker_is_named_after_three_tries_and_takes_no_other_with_it(
    tmp_path: Path,
) -> None:
    tasks = [batch_samples.task(run, out=str(tmp_path)) for run in ("a", "deadly", "b", "c", "d")]
    with WorkerSlots(2) as slots:
        result = run_all(tasks, slots, 2, work=batch_samples.die_when_named_deadly)
    assert result.done == 4
    assert [failure.run for failure in result.failures] == ["deadly"]
    assert "worker died" in result.failures[0].reason
    tries = {path.stem: len(path.read_text()) for path in tmp_path.glob("*.tries")}
    assert tries == {"a": 1, "b": 1, "c": 1, "d": 1, "deadly": 3}


def test_ctrl_c_stops_within_seconds_dismisses_the_workers_and_says_how_to_go_on(tmp_path: Path) -> None:
    tasks = [batch_samples.task(str(i), out=str(tmp_path)) for i in range(400)]
    interrupted_at: list[float] = []

    def press_ctrl_c_after_the_fourth(progress: Progress) -> None:
        if progress.ended >= 4 and not interrupted_at:
            interrupted_at.append(time.monotonic())
            os.kill(os.getpid(), signal.SIGINT)

    slots = WorkerSlots(2)
    with pytest.raises(InterruptedBatch, match=r"of 400 passes are done; the same command goes on"):
        run_all(tasks, slots, 2, watch=press_ctrl_c_after_the_fourth, work=batch_samples.nap)
    slots.shutdown(wait=True)
    assert time.monotonic() - interrupted_at[0] < 5.0
    started = len(list(tmp_path.glob("*.tries")))
    time.sleep(0.7)
    assert len(list(tmp_path.glob("*.tries"))) == started < 20


def test_no_more_than_twice_the_slots_are_ever_submitted() -> None:
    outstanding, most = 0, 0
    lock = threading.Lock()

    class Counting(SerialExecutor):
        def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
            nonlocal outstanding, most
            with lock:
                outstanding += 1
                most = max(most, outstanding)
            return super().submit(fn, *args, **kwargs)

    def ended(progress: Progress) -> None:
        nonlocal outstanding
        outstanding -= 1 if progress.last else 0

    tasks = [batch_samples.task(str(i)) for i in range(50)]
    run_all(tasks, Counting(), 3, watch=ended, work=batch_samples.succeed)
    assert most == 6


def test_a_pass_blamed_for_workers_that_another_killed_is_cleared_by_running_alone() -> None:
    """As Dask does: whoever was on the lost workers is given up, not only who killed them."""
    submitted: list[str] = []

    class KilledWorker(Exception):  # noqa: N818 (Dask's name)
        pass

    class Blaming(SerialExecutor):
        def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
            run = args[0].run
            submitted.append(run)
            future = super().submit(fn, *args, **kwargs)
            if run == "deadly" or (run == "innocent" and submitted.count(run) == 1):
                future = Future()
                future.set_exception(KilledWorker(run))
            return future

    tasks = [batch_samples.task(run) for run in ("innocent", "deadly", "c", "d")]
    result = run_all(tasks, Blaming(), 1, work=batch_samples.succeed)
    assert result.done == 3
    assert [failure.run for failure in result.failures] == ["deadly"]
    assert sorted(submitted[4:]) == ["deadly", "innocent"]


def test_a_slot_count_below_one_is_refused() -> None:
    with pytest.raises(ValueError, match="at least one"):
        WorkerSlots(0)


def test_a_campaign_file_that_is_refused_leaves_no_worker_and_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The workers are started before it is read."""
    (tmp_path / "raw" / "one").mkdir(parents=True)
    (tmp_path / "raw" / "one" / "run.toml").write_text("", encoding="utf-8")
    (tmp_path / "raw" / "campaign.toml").write_text("alfa = 0.05\n", encoding="utf-8")
    monkeypatch.setattr(batch, "get_ready", batch_killed.nothing)
    before = set(psutil.Process().children())
    request = batch.Request((str(tmp_path / "raw"),), str(tmp_path / "out"), workers=2)
    with pytest.raises(CampaignError, match="alfa"):
        batch.run_batch(request, lambda progress: None)
    assert set(psutil.Process().children()) <= before
    assert not (tmp_path / "out").exists()
