"""Dynamic time warping within a band, compiled: the alignment inside ISO/TS 18571's magnitude score."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

DIAGONAL, UP, LEFT = 0, 1, 2


@njit(cache=True)
def warp_costs(a: Any, b: Any, band: int, steps: Any) -> float:  # pragma: no cover - compiled
    """Fill `steps` with the cheapest predecessor of each cell (0 diagonal, 1 up, 2 left); returns the
    total cost.

    D(i, j) = (a_i − b_j)² + min(D(i−1, j−1), D(i−1, j), D(i, j−1)) for |i − j| ≤ band, infinite elsewhere.
    """
    n = a.size
    before = np.full(n, np.inf)
    here = np.full(n, np.inf)
    for i in range(n):
        here[:] = np.inf
        for j in range(max(0, i - band), min(n, i + band + 1)):
            diagonal = before[j - 1] if j > 0 else np.inf
            left = here[j - 1] if j > 0 else np.inf
            best, step = diagonal, 0
            if before[j] < best:
                best, step = before[j], 1
            if left < best:
                best, step = left, 2
            if i == 0 and j == 0:
                best = 0.0
            here[j] = (a[i] - b[j]) ** 2 + best
            steps[i, j] = step
        before, here = here, before
    return float(before[n - 1])


@njit(cache=True)
def trace_back(steps: Any, path: Any) -> int:  # pragma: no cover - compiled
    """Walk from the last cell to the first; writes (i, j) into `path` backwards and returns the path's
    length."""
    i = j = steps.shape[0] - 1
    length = 0
    while True:
        path[length, 0], path[length, 1] = i, j
        length += 1
        if i == 0 and j == 0:
            return length
        step = steps[i, j]
        if step != 2:
            i -= 1
        if step != 1:
            j -= 1


def warped(
    a: NDArray[np.float64], b: NDArray[np.float64], band: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Both signals along their cheapest common path, which strays at most `band` samples from the
    diagonal."""
    steps = np.zeros((a.size, a.size), dtype=np.int8)
    path = np.zeros((2 * a.size, 2), dtype=np.int64)
    warp_costs(np.ascontiguousarray(a), np.ascontiguousarray(b), band, steps)
    length = trace_back(steps, path)
    forward = path[:length][::-1]
    return a[forward[:, 0]], b[forward[:, 1]]
