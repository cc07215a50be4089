"""A process that does one piece of work after another for its parent, and ends with it.

Not `multiprocessing`: that forbids children to Dask's workers (they are daemons), imports the parent's main
module anew in each, and keeps two threads a process to do what one socket does.
"""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor
from contextlib import suppress
from multiprocessing.connection import Connection, Pipe
from queue import SimpleQueue
from typing import Any, TypeVar

Value = TypeVar("Value")
Work = Callable[[], Value]

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")

START = (
    "import json, signal, sys;"
    "signal.signal(signal.SIGINT, signal.SIG_IGN);"  # Ctrl-C is the parent's to handle
    "sys.path[:] = json.loads(sys.argv[1]);"
    f"from {__name__} import serve; serve()"
)


class WorkerLost(BrokenExecutor):
    """The process ended before it answered: killed, or out of memory."""


class Child:
    """A process of its own, started at once; `run` is for one thread at a time.

    environment : of the process; this one's where it is not given
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        ours, theirs = Pipe(duplex=True)
        with theirs:
            # -P: a json.py or signal.py in the working folder is not what START imports
            command = [sys.executable, "-P", "-c", START, json.dumps(sys.path)]
            self._process = subprocess.Popen(command, stdin=theirs.fileno(), env=environment)
        self._pipe = ours

    def run(self, work: Work[Value]) -> Value:
        """What `work` gives when it is called in that process; its exception, with the traceback as a note.

        `work` and its value are pickled. Raises WorkerLost when the process ends first.
        """
        sent = pickle.dumps(work)
        try:
            self._pipe.send_bytes(sent)
            received = self._pipe.recv_bytes()
        except (EOFError, OSError):
            raise WorkerLost("the worker process ended before its work was done") from None
        good, value = pickle.loads(received)
        if not good:
            raise value
        result: Value = value
        return result

    def end(self) -> None:
        """End the process at once, with the work under way."""
        self._process.kill()

    def wait(self) -> None:
        """Wait until the process has ended."""
        self._process.wait()


def serve() -> None:
    """Main function of the process: does what comes through its standard input, a socket, and answers there."""
    pipe = Connection(os.dup(0))
    with open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
    with suppress(OSError):  # there may be none
        os.dup2(2, 1)  # the parent's standard output is its own: lines of JSON, it may be
    waiting: SimpleQueue[bytes] = SimpleQueue()
    threading.Thread(target=_receive, args=(pipe, waiting), daemon=True).start()
    while True:
        pipe.send_bytes(_answer(waiting.get()))


def _receive(pipe: Connection, waiting: SimpleQueue[bytes]) -> None:
    """Listens also while a pass is computed: when the parent is gone, however it went, so is its child."""
    try:
        while True:
            waiting.put(pipe.recv_bytes())
    except (EOFError, OSError):
        # Not sys.exit: it would end this thread only, and the pass under way is nobody's any more.
        os._exit(1)


def _answer(sent: bytes) -> bytes:
    try:
        return pickle.dumps((True, pickle.loads(sent)()))
    except Exception as error:
        return _refusal(error)


def _refusal(error: Exception) -> bytes:
    told = "".join(traceback.format_exception(error))
    error.add_note(f"in a worker process:\n{told}")
    try:
        refusal = pickle.dumps((False, error))
        pickle.loads(refusal)  # some exceptions can be written but not read
    except Exception:
        return pickle.dumps((False, RuntimeError(f"{type(error).__name__}: {error}")))
    return refusal


def one_threaded(without: tuple[str, ...] = ()) -> dict[str, str]:
    """This process's environment for a child that shall keep one core busy, where it says nothing else."""
    given = {name: value for name, value in os.environ.items() if name not in without}
    return dict.fromkeys(ONE_THREAD, "1") | given


_kept = threading.local()  # a child for each thread of a Dask worker


def in_kept_child(work: Work[Any]) -> Any:
    """Do `work` in a process that this thread keeps for it; as `Child.run`.

    For Dask's workers. Computing in their own process would have each of their many small chores take the
    interpreter's lock from the pass; and a nanny has its workers give freed memory back at once
    (MALLOC_TRIM_THRESHOLD_), so that a pass fetches the same pages hundreds of thousands of times.
    """
    child: Child | None = getattr(_kept, "child", None)
    if child is None:
        child = _kept.child = Child(one_threaded(without=("MALLOC_TRIM_THRESHOLD_",)))
    try:
        return child.run(work)
    except WorkerLost:
        del _kept.child
        child.end()
        child.wait()
        raise
