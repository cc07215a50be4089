"""Compiled passes of the posterior draws (see `draws`): K simulated errors forward through the filter, and back."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...model.parts import part
from .filtering import KEEP, unpack
from .kernels import PATTERN, process_noise, transition
from .state import EX, EY, FX, FY, P_ACTIVE, SIZE

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@part
def _step(F: Floats, d: Floats, out: Floats) -> None:
    """F·d for the columns of d (SIZE, K), skipping structural zeros."""
    for i in range(SIZE):
        for c in range(d.shape[1]):
            out[i, c] = F[i, i] * d[i, c]
    for e in range(PATTERN.shape[0]):
        i, m = PATTERN[e, 0], PATTERN[e, 1]
        f = F[i, m]
        for c in range(d.shape[1]):
            out[i, c] += f * d[m, c]


@part
def _adjoint_step(F: Floats, lam: Floats, out: Floats) -> None:
    """Fᵀ·lambda for the columns of lambda (SIZE, K)."""
    for i in range(SIZE):
        for c in range(lam.shape[1]):
            out[i, c] = F[i, i] * lam[i, c]
    for e in range(PATTERN.shape[0]):
        m, i = PATTERN[e, 0], PATTERN[e, 1]
        f = F[m, i]
        for c in range(lam.shape[1]):
            out[i, c] += f * lam[m, c]


@part
def _add_noise(row: Floats, variance: float, rng: np.random.Generator) -> None:
    """Independent normal noise of one variance added to a row, in place."""
    if variance > 0.0:
        sd = np.sqrt(variance)
        for c in range(row.size):
            row[c] += sd * rng.standard_normal()


@part
def _add_product(P: Floats, lam: Floats, out: Floats) -> None:
    """Rows KEEP of P·lambda added to `out`, (kept, K)."""
    for a in range(KEEP.size):
        for j in range(SIZE):
            for c in range(lam.shape[1]):
                out[a, c] += P[KEEP[a], j] * lam[j, c]


@njit(cache=True, error_model="numpy")
def simulate(
    P0: Floats,
    u: Floats,
    dt: float,
    starts: Ints,
    var: Floats,
    inject: Floats,
    p: Floats,
    lin: Floats,
    H: Floats,
    K: Floats,
    used: Bools,
    rng: np.random.Generator,
    gap: int,
    error: Floats,
    nu: Floats,
) -> None:
    """Forward: simulated error less its filter estimate at nodes (every EVERY-th kept), innovations of all draws."""
    draws = nu.shape[1]
    d, ahead = np.empty((SIZE, draws)), np.empty((SIZE, draws))
    F, q = np.eye(SIZE), np.empty(SIZE)
    for i in range(SIZE):
        for c in range(draws):
            d[i, c] = 0.0
    for k in range(lin.shape[0]):
        if k == 0:
            for i in range(SIZE):
                q[i] = P0[i, i]
        else:
            transition(lin[k - 1], u[k - 1], dt, p, F)
            process_noise(lin[k - 1], u[k - 1], dt, p, q)
            q[EX] += inject[k, 0]
            q[EY] += inject[k, 0]
            q[FX] += inject[k, 1]
            q[FY] += inject[k, 1]
            _step(F, d, ahead)
            d, ahead = ahead, d
        for i in range(SIZE):
            _add_noise(d[i], q[i], rng)
        for m in range(starts[k], starts[k + 1]):
            if not used[m]:
                continue
            _add_noise(nu[m], var[m], rng)
            for i in range(SIZE):
                if H[m, i] != 0.0:
                    for c in range(draws):
                        nu[m, c] += H[m, i] * d[i, c]
            for i in range(SIZE):
                for c in range(draws):
                    d[i, c] -= K[m, i] * nu[m, c]
        if k % gap == 0:
            for a in range(KEEP.size):
                for c in range(draws):
                    error[k // gap, a, c] = d[KEEP[a], c]


@njit(cache=True, error_model="numpy")
def smooth(
    u: Floats,
    dt: float,
    starts: Ints,
    p: Floats,
    lin: Floats,
    packed: Floats,
    H: Floats,
    K: Floats,
    S: Floats,
    used: Bools,
    gap: int,
    error: Floats,
    nu: Floats,
) -> None:
    """Backward: turn filter errors into smoother errors, error + P·lambda, in place at the kept nodes."""
    draws = nu.shape[1]
    lam, out = np.zeros((SIZE, draws)), np.empty((SIZE, draws))
    P, F = np.zeros((SIZE, SIZE)), np.eye(SIZE)
    last = lin.shape[0] - 1
    for back in range(last + 1):
        k = last - back
        if back > 0:
            transition(lin[k], u[k], dt, p, F)
            _adjoint_step(F, lam, out)
            lam, out = out, lam
        if k % gap == 0:
            unpack(packed[k], P, int(p[P_ACTIVE]))
            _add_product(P, lam, error[k // gap])
        for m in range(starts[k + 1] - 1, starts[k] - 1, -1):
            if not used[m]:
                continue
            for c in range(draws):
                v = nu[m, c] / S[m]
                for i in range(SIZE):
                    v += K[m, i] * lam[i, c]
                for i in range(SIZE):
                    if H[m, i] != 0.0:
                        lam[i, c] -= H[m, i] * v
