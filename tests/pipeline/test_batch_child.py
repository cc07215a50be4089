"""A worker process: does what it is given, says why it could not, and never outlives its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import psutil
import pytest
from smts_validate.pipeline.batch_child import Child, WorkerLost, in_kept_child, one_threaded

PARENT = """
import os, time
from functools import partial
from smts_validate.pipeline.batch_child import Child
child = Child()
print(child.run(os.getpid), flush=True)
child.run(partial(time.sleep, 600))
"""


class UnreadableError(Exception):
    """Can be pickled, but not read again: its constructor wants two arguments."""

    def __init__(self, one: str, other: str) -> None:
        super().__init__(one)


def refuse() -> None:
    raise KeyError("no such pass")


def refuse_unreadably() -> None:
    raise UnreadableError("the tyre", "burst")


def talk() -> int:
    sys.stdout.write("a library's remark\n")
    sys.stdout.flush()
    return 7


def one_child() -> Child:
    return Child(one_threaded())


def test_work_is_done_in_another_process_and_the_same_one_again() -> None:
    child = one_child()
    try:
        first = child.run(os.getpid)
        assert first not in (os.getpid(), 0)
        assert child.run(os.getpid) == first
        assert child.run(partial(pow, 3, 4)) == 81
    finally:
        child.end()
        child.wait()


def test_an_error_arrives_as_it_was_with_the_traceback_of_the_worker_and_the_next_work_is_done() -> None:
    child = one_child()
    try:
        with pytest.raises(KeyError, match="no such pass") as caught:
            child.run(refuse)
        assert "in refuse" in caught.value.__notes__[0]
        with pytest.raises(RuntimeError, match="UnreadableError: the tyre"):
            child.run(refuse_unreadably)
        assert child.run(partial(pow, 2, 5)) == 32
    finally:
        child.end()
        child.wait()


def test_what_a_library_prints_does_not_get_between_the_lines_of_the_parent(
    capfd: pytest.CaptureFixture[str],
) -> None:
    child = one_child()
    try:
        assert child.run(talk) == 7
    finally:
        child.end()
        child.wait()
    printed = capfd.readouterr()
    assert (printed.out, printed.err) == ("", "a library's remark\n")


def test_one_that_is_killed_or_ended_over_its_work_is_told_as_lost() -> None:
    child = one_child()
    pid = child.run(os.getpid)
    threading.Timer(0.2, os.kill, (pid, signal.SIGKILL)).start()
    with pytest.raises(WorkerLost):
        child.run(partial(time.sleep, 600))
    with pytest.raises(WorkerLost):
        child.run(os.getpid)
    other = one_child()
    threading.Timer(0.2, other.end).start()
    with pytest.raises(WorkerLost):
        other.run(partial(time.sleep, 600))
    child.wait()
    other.wait()


def test_modules_in_the_working_folder_do_not_stand_for_pythons_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("json", "signal"):
        (tmp_path / f"{name}.py").write_text("raise ImportError('not the one that was meant')")
    monkeypatch.chdir(tmp_path)
    child = one_child()
    try:
        assert child.run(partial(pow, 3, 2)) == 9
    finally:
        child.end()
        child.wait()


def test_a_worker_at_work_leaves_with_its_killed_parent() -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    worker = psutil.Process(int(parent.stdout.readline()))
    parent.kill()
    parent.communicate()
    _, alive = psutil.wait_procs([worker], timeout=5.0)
    assert not alive


def test_an_interrupt_from_the_terminal_is_not_for_the_worker() -> None:
    child = one_child()
    try:
        pid = child.run(os.getpid)
        os.kill(pid, signal.SIGINT)
        assert child.run(os.getpid) == pid
    finally:
        child.end()
        child.wait()


def test_a_kept_worker_is_one_a_thread_has_none_of_dasks_memory_setting_and_is_replaced_when_it_dies(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    seen: list[int] = []

    def in_a_thread() -> None:
        first = in_kept_child(os.getpid)
        assert in_kept_child(os.getpid) == first
        assert in_kept_child(partial(os.getenv, "MALLOC_TRIM_THRESHOLD_")) is None
        assert in_kept_child(partial(os.getenv, "NUMBA_NUM_THREADS")) == "1"
        assert in_kept_child(partial(os.getenv, "OMP_NUM_THREADS")) == "3"
        with pytest.raises(WorkerLost):
            in_kept_child(partial(os._exit, 1))
        seen.extend((first, in_kept_child(os.getpid)))

    thread = threading.Thread(target=in_a_thread)
    thread.start()
    thread.join()
    here = in_kept_child(os.getpid)
    assert len({*seen, here, os.getpid()}) == 4
