"""Where passes are computed: three executors behind `concurrent.futures.Executor`, alike to the batch.

Serial (this process), worker slots (processes of their own, so that a dying one takes nothing with it but its
own pass), and a Dask cluster, whose workers keep such a process each.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial
from typing import Any, ParamSpec, TypeVar

from .batch_child import Child, WorkerLost, in_kept_child, one_threaded

Params = ParamSpec("Params")
Value = TypeVar("Value")


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
    """`count` processes, each fed by a thread of its own and replaced when it dies.

    A pool of `count` workers would break as a whole with any one of them, and could not say whose pass did
    it. The workers leave when this process ends, however it ends.
    """

    def __init__(self, count: int) -> None:
        if not count >= 1:
            raise ValueError(f"{count} workers: there must be at least one")
        self._threads = ThreadPoolExecutor(count, thread_name_prefix="worker-slot")
        self._slot = threading.local()
        self._lock = threading.Lock()  # none may be started when all are being dismissed
        self._children: list[Child] = []
        self._closing = False

    def submit(
        self, fn: Callable[Params, Value], /, *args: Params.args, **kwargs: Params.kwargs
    ) -> Future[Value]:
        """Run `fn` in the next free worker; its future raises WorkerLost when that worker died."""
        return self._threads.submit(self._in_own_process, partial(fn, *args, **kwargs))

    def _in_own_process(self, call: Callable[[], Value]) -> Value:
        child: Child = getattr(self._slot, "child", None) or self._start()
        try:
            return child.run(call)
        except WorkerLost:
            self._slot.child = None
            self._end(child)
            raise

    def _start(self) -> Child:
        with self._lock:
            if self._closing:
                raise WorkerLost("the batch is stopping")
            child = self._slot.child = Child(one_threaded())
            self._children.append(child)
        return child

    def _end(self, child: Child) -> None:
        child.end()
        child.wait()
        with self._lock:
            self._children.remove(child)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Dismiss the workers; a task under way ends with them."""
        self._threads.shutdown(wait=False, cancel_futures=cancel_futures)
        with self._lock:
            self._closing = True
            dismissed = tuple(self._children)
        for child in dismissed:
            child.end()
        if wait:
            for child in dismissed:
                child.wait()
            self._threads.shutdown(wait=True)


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
        """Run `fn` on some worker of the cluster, in a process that the worker keeps for that."""
        future: Future[Value] = self._executor.submit(in_kept_child, partial(fn, *args, **kwargs))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Leave the cluster; its workers stay for others."""
        self._executor.shutdown(wait=wait)
        self._client.close()
