"""Where compiled code is not on disk yet, several processes compile it at once, from the moment a command starts."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, wait
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from .batch_executors import WorkerSlots
from .cores import cores
from .kernel_groups import GROUPS, QUIET, compile_group

PACKAGE = Path(__file__).parent.parent
PATIENCE = 120.0  # s, for a helper that has stopped
MOST_HELPERS = 3  # more have nothing to do: the longest group is a quarter of all


@contextmanager
def kernels_beside(
    kernels: Iterable[str] = GROUPS, work: Callable[[str], None] = compile_group
) -> Iterator[Callable[[], None]]:
    """Start compiling what is not on disk; gives a function that lends a hand and returns when all is there.

    Helpers take whole groups of kernels, leave them in numba's cache, and end with the block, however it ends. On a
    single core, or with nothing to share, there are none, and the function compiles all.

    kernels : one of each group, as `on_disk` takes them; work : compiles the group of one
    """
    missing = absent(kernels)
    helpers = min(cores() - 1, len(missing) - 1, MOST_HELPERS)
    if helpers < 1:
        yield lambda: _lend_a_hand(missing, {}, work)
        return
    os.environ.setdefault(QUIET, "1")
    slots = WorkerSlots(helpers)
    try:
        under_way = {kernel: slots.submit(work, kernel) for kernel in missing}
        yield lambda: _lend_a_hand(missing, under_way, work)
    finally:
        slots.shutdown(wait=True, cancel_futures=True)


def _lend_a_hand(
    missing: Iterable[str], under_way: Mapping[str, Future[None]], work: Callable[[str], None]
) -> None:
    """Compile here what no helper has begun, then wait for them.

    What a helper could not do, or was killed over, is compiled where it is called, and an error met there.
    """
    for kernel in missing:
        if kernel not in under_way or under_way[kernel].cancel():
            work(kernel)
    wait([future for future in under_way.values() if not future.cancelled()], PATIENCE)


def absent(kernels: Iterable[str] = GROUPS) -> list[str]:
    """Those that are not on disk; none where numba is told to compile nothing."""
    if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
        return []
    return [kernel for kernel in kernels if not on_disk(kernel)]


def on_disk(kernel: str) -> bool:
    """Whether numba's cache has this kernel, `package/module.function`, for this Python."""
    folder, name = kernel.rsplit("/", 1)
    pattern = f"{name}-*.py{sys.version_info[0]}{sys.version_info[1]}*.nbi"
    beside = PACKAGE / folder / "__pycache__"
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return any(Path(given).glob(f"*/{pattern}"))
    if any(beside.glob(pattern)):
        return True
    if os.access(beside if beside.exists() else beside.parent, os.W_OK):
        return False
    from numba.misc import appdirs

    where: Any = appdirs  # typed in part
    return any(Path(where.user_cache_dir("numba", appauthor=False)).glob(f"*/{pattern}"))
