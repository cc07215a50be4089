"""Compiled code on disk is dropped when any source that it may hold a copy of has changed.

numba keeps a function's machine code beside its source and compiles it anew when that file changes. What it took in
from other files it does not look at: after an update a filter could run with yesterday's layout of its state.
"""

from __future__ import annotations

import hashlib
from contextlib import suppress
from pathlib import Path


def drop_stale(package: Path) -> None:
    """Delete numba's files under a package's folder unless its sources are those that they were made from.

    A marker named by every source's path, time and size says so. Where the folder cannot be written, numba keeps
    nothing there either.
    """
    with suppress(OSError):
        stamps = [
            (str(p.relative_to(package)), p.stat().st_mtime_ns, p.stat().st_size) for p in _sources(package)
        ]
        name = hashlib.sha256(repr(stamps).encode()).hexdigest()[:16]
        marker = package / "__pycache__" / f"sources-{name}"
        if marker.exists():
            return
        for old in [*package.rglob("__pycache__/*.nb[ic]"), *marker.parent.glob("sources-*")]:
            old.unlink(missing_ok=True)
        marker.parent.mkdir(exist_ok=True)
        marker.touch()


def _sources(package: Path) -> list[Path]:
    return sorted(package.rglob("*.py"))
