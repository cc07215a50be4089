"""Where passes are computed: three executors behind `concurrent.futures.Executor`, alike to the batch.

Serial (this process), worker slots (spawned processes, each alone, so that a dying one takes nothing with it
but its own pass), and a Dask cluster.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, ParamSpec, TypeVar

Params = ParamSpec("Params")
Value = TypeVar("Value")

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


class ClusterError(ValueError):
    """A cluster that cannot be reached or used; one line that says how to mend it."""


class SerialExecutor(Executor):
    """Runs each task at once, in the calling thread."""

    def submit(
        self, fn: Callable[Params, Value], /, *args: Params.args, **kwargs: Params.kwargs
    ) -> Future[Value]:
        """Run `fn` now; the future is done when this returns."""
        future: Future[Value] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class WorkerSlots(Executor):
    """`count` spawned processes, each fed by a thread of its own and replaced when it dies.

    A pool of `count` workers would break as a whole with any one of them, and could not say whose pass did
    it. Every worker holds one end of a pipe whose other end is this process's alone: when this process ends,
    however it ends, the pipe closes and the workers leave.
    """

    def __init__(self, count: int) -> None:
        if not count >= 1:
            raise ValueError(f"{count} workers: there must be at least one")
        for name in ONE_THREAD:  # children inherit this; set before numpy is imported in them
            os.environ.setdefault(name, "1")
        self._context = multiprocessing.get_context("spawn")
        self._lifeline, self._our_end = self._context.Pipe(duplex=False)
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="worker-slot")
        self._slot = threading.local()
        self._closing = False

    def submit(
        self, fn: Callable[Params, Value], /, *args: Params.args, **kwargs: Params.kwargs
    ) -> Future[Value]:
        """Run `fn` in the next free worker; its future raises BrokenProcessPool when that worker died."""
        return self._threads.submit(partial(self._in_own_process, partial(fn, *args, **kwargs)))

    def _in_own_process(self, call: Callable[[], Value]) -> Value:
        pool = getattr(self._slot, "pool", None) or self._new_pool()
        try:
            return pool.submit(call).result()
        except BrokenProcessPool:
            self._slot.pool = None
            pool.shutdown(wait=False)
            raise

    def _new_pool(self) -> ProcessPoolExecutor:
        if self._closing:
            raise BrokenProcessPool("the batch is stopping")
        pool = ProcessPoolExecutor(
            1, mp_context=self._context, initializer=_start_worker, initargs=(self._lifeline,)
        )
        self._slot.pool = pool
        return pool

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Dismiss the workers; a task under way ends with them."""
        self._closing = True
        self._threads.shutdown(wait=False, cancel_futures=cancel_futures)
        self._our_end.close()
        self._threads.shutdown(wait=wait)


def _start_worker(lifeline: Connection) -> None:
    """First thing in a worker: Ctrl-C is the parent's to handle, and the parent's end is ours."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with_parent, args=(lifeline,), daemon=True).start()


def _leave_with_parent(lifeline: Connection) -> None:
    try:
        lifeline.recv_bytes()
    except (EOFError, OSError):
        # Not sys.exit: it would end this thread only, and the pass under way is nobody's any more.
        os._exit(1)


def dask_executor(address: str, timeout: float = 15.0) -> tuple[Executor, int]:
    """An executor over the Dask cluster at `address` (tcp://host:8786), and how many tasks it runs at once.

    Raises ClusterError when the extra is not installed or nobody answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise ClusterError("--scheduler needs Dask: pip install 'smts-validate[cluster]'") from None
    client: Any
    connect: Any = Client  # untyped in Dask
    try:
        client = connect(address, timeout=f"{timeout}s", set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"{address}: no Dask scheduler answers there ({error}); start `dask scheduler`"
        ) from None
    threads = sum(client.nthreads().values())
    if threads == 0:
        client.close()
        raise ClusterError(
            f"{address}: the scheduler has no workers; start `dask worker {address} --nthreads 1`"
        )
    return DaskExecutor(client), threads


class DaskExecutor(Executor):
    """Tasks on a Dask cluster. `pure=False`: with the default, equal submissions would run once."""

    def __init__(self, client: Any) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)

    def submit(
        self, fn: Callable[Params, Value], /, *args: Params.args, **kwargs: Params.kwargs
    ) -> Future[Value]:
        """Run `fn` on some worker of the cluster."""
        future: Future[Value] = self._executor.submit(fn, *args, **kwargs)
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; its workers stay for others."""
        self._executor.shutdown(wait=wait)
        self._client.close()
