"""Limits on one pass's time and memory, held by a watching thread: works in any executor's worker."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic

LOOK_EVERY = 0.05  # s
AGAIN = 2.0  # s between asking a pass to stop and asking it again
GRACE = 20.0  # s between asking a pass to stop and ending its process


@dataclass(frozen=True)
class Limits:
    """What one pass may use: seconds of wall time, bytes of its process in RAM; None: no limit."""

    seconds: float | None = None
    memory: int | None = None

    @property
    def any(self) -> bool:
        """Whether there is anything to watch."""
        return self.seconds is not None or self.memory is not None


class LimitReached(BaseException):
    """Raised inside a pass that reached a limit. Not an Exception: no stage may take it for its own error."""


@contextmanager
def limited(limits: Limits) -> Iterator[list[str]]:
    """Run a block under limits; raises LimitReached inside it. Yields a list that then holds the reason.

    An exception is delivered between two bytecodes, so compiled code finishes its call first. Some libraries drop
    any exception (one met while a weak reference goes, say): it is raised again every AGAIN seconds. A block that does
    not end within GRACE seconds takes its process with it (the batch then sees a lost worker).
    """
    reasons: list[str] = []
    if not limits.any:
        yield reasons
        return
    over = threading.Event()
    lock = threading.Lock()
    watched = threading.get_ident()
    arguments = (limits, watched, reasons, over, lock)
    threading.Thread(target=_watch, args=arguments, daemon=True, name="limits").start()
    try:
        yield reasons
    finally:
        try:
            with lock:
                over.set()
        except LimitReached:  # it came while we waited for the lock
            over.set()
            raise


def _watch(
    limits: Limits, watched: int, reasons: list[str], over: threading.Event, lock: threading.Lock
) -> None:
    begin = monotonic()
    while not over.wait(LOOK_EVERY):
        reason = _reason(limits, monotonic() - begin)
        if reason:
            break
    else:
        return
    asked = monotonic()
    while monotonic() - asked < GRACE:
        with lock:
            if over.is_set():
                return
            reasons[:] = [reason]
            ctypes.pythonapi.PyThreadState_SetAsyncExc(
                ctypes.c_ulong(watched), ctypes.py_object(LimitReached)
            )
        if over.wait(AGAIN):
            return
    os._exit(1)


def _reason(limits: Limits, seconds: float) -> str:
    if limits.seconds is not None and not seconds <= limits.seconds:
        return f"took longer than {limits.seconds:g} s (--time-limit)"
    used = resident_bytes() if limits.memory is not None else 0
    if limits.memory is not None and used > limits.memory:
        return f"needed more than {limits.memory / 2**20:.0f} MiB of memory (--memory-limit)"
    return ""


def resident_bytes() -> int:
    """Memory of this process that is in RAM now."""
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def parse_bytes(text: str) -> int:
    """`2G`, `800M`, `1.5GiB` or plain bytes as a number of bytes (powers of 1024).

    Raises ValueError for anything else, and for what is not above zero.
    """
    cleaned = text.strip().upper().removesuffix("IB").removesuffix("B")
    factors = {"K": 2**10, "M": 2**20, "G": 2**30, "T": 2**40}
    factor = factors.get(cleaned[-1:], 1)
    number = float(cleaned[:-1] if factor > 1 else cleaned)
    if not 0.0 < number * factor < 2**60:
        raise ValueError(f"{text}: memory must be above zero, like 2G or 800M")
    return int(number * factor)
