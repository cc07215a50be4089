"""The first pass on a machine compiles for all: its workers wait for it, then load what it left on disk."""

from __future__ import annotations

import fcntl
import platform
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

from .kernels_beside import kernels_beside

Value = TypeVar("Value")
CACHE = Path(__file__).parent / "__pycache__"  # where numba puts its own


def compiled_once(digest: str, work: Callable[[], Value], good: Callable[[Value], bool]) -> Value:
    """Do `work`; where this program has not been compiled on this machine yet, one process at a time.

    Without that, workers that start together would each compile everything: numba's cache has no lock.

    Parameters
    ----------
    digest : of the program's sources; an edited one is compiled anew
    work : computes a pass
    good : whether a pass went through, and so left everything compiled
    """
    marker = CACHE / f"compiled-{digest[:16]}-{platform.node()}"
    if marker.exists():
        return work()
    with _alone(marker.with_suffix(".lock")) as locked:
        if locked and not marker.exists():
            with kernels_beside() as compiled:
                compiled()  # the others are waiting: their cores are free
            value = work()
            if good(value):
                _mark(marker)
            return value
    return work()


@contextmanager
def _alone(path: Path) -> Iterator[bool]:
    """Hold a file lock; False where there is nowhere to put one (a package folder that is read-only)."""
    try:
        path.parent.mkdir(exist_ok=True)
        lock = path.open("w")
    except OSError:
        yield False
        return
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield True


def _mark(marker: Path) -> None:
    with suppress(OSError):
        for old in CACHE.glob(f"compiled-*-{platform.node()}"):
            old.unlink()
        marker.touch()
