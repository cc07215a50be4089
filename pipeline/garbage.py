"""When Python looks for garbage in circles: seldom while a pass is computed, and not at the end."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

SELDOM = (1_000_000, 20, 50)  # new objects between collections of the young; of those between older ones


@contextmanager
def seldom_collected() -> Iterator[None]:
    """Collect circles a thousand times less often than by default, and as before afterwards.

    What a pass leaves lies almost wholly in no circle and goes at once; the libraries' own half a million
    objects stay, and to walk through them time and again is a sixth of a pass. What waits for collection between
    two of them is some twenty megabytes a pass, of figures, and flat after a few passes.
    """
    before = gc.get_threshold()
    gc.set_threshold(*SELDOM)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def leave_the_rest() -> None:
    """Before a process ends: what it holds goes with it, and is not searched for circles on the way out."""
    gc.freeze()
