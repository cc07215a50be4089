"""Compiled forward filter and modified Bryson-Frazier smoother over the kernels of the joint state.

The smoother needs no inverse of a covariance: it carries the adjoint state lambda and its covariance backwards
through every scalar update and every step (Bierman 1973, Automatica 9; equal to Rauch-Tung-Striebel, which the
reference engine uses). Sequential scalar updates from one linearisation are the joint update.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...model.parts import part, summing
from .kernels import GATE_1, GATE_2, PATTERN, predict, process_noise, transition
from .state import EX, EY, FX, FY, HITCH, KEPT, P_ACTIVE, PAIRED, SIZE, STILL_AX, STILL_V

KEEP = np.array(KEPT, dtype=np.int64)
PAIRS = np.array(PAIRED, dtype=np.int64)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]


@part
def times_transition(F: Floats, A: Floats, out: Floats, n: int) -> None:
    """F·A into `out`, row by row, skipping the structural zeros of F."""
    for i in range(n):
        d = F[i, i]
        for j in range(n):
            out[i, j] = d * A[i, j]
    for e in range(PATTERN.shape[0]):
        i, m = PATTERN[e, 0], PATTERN[e, 1]
        f = F[i, m]
        for j in range(n):
            out[i, j] += f * A[m, j]


@part
def transpose(A: Floats, out: Floats, n: int) -> None:
    """Aᵀ into `out`."""
    for i in range(n):
        for j in range(n):
            out[j, i] = A[i, j]


@njit(cache=True, error_model="numpy", inline="always")
def propagate(P: Floats, F: Floats, q: Floats, A: Floats, B: Floats, n: int) -> None:
    """F·P·Fᵀ + diag(q) in place: rows only, F·(F·P)ᵀ, as P is symmetric. A, B : scratch (SIZE, SIZE)."""
    times_transition(F, P, A, n)
    transpose(A, B, n)
    times_transition(F, B, P, n)
    for i in range(n):
        P[i, i] += q[i]


@njit(cache=True, error_model="numpy", inline="always")
def carry(F: Floats, x: Floats, point: Floats, there: Floats) -> None:
    """F·(x − point) added to `there` in place, skipping the structural zeros of F."""
    for i in range(SIZE):
        there[i] += F[i, i] * (x[i] - point[i])
    for e in range(PATTERN.shape[0]):
        i, m = PATTERN[e, 0], PATTERN[e, 1]
        there[i] += F[i, m] * (x[m] - point[m])


@summing
def gain(P: Floats, H: Floats, var: float, K: Floats, n: int) -> float:
    """Innovation variance S = H·P·Hᵀ + var and gain K = P·Hᵀ/S of a scalar measurement."""
    K[:] = 0.0
    for j in range(n):
        if H[j] != 0.0:
            h = H[j]
            for i in range(n):  # P is symmetric: row j is column j, and lies together
                K[i] += P[j, i] * h
    S = var
    for i in range(n):
        if H[i] != 0.0:
            S += H[i] * K[i]
    for i in range(n):
        K[i] /= S
    return S


@njit(cache=True, error_model="numpy", inline="always")
def correct(x: Floats, P: Floats, K: Floats, S: float, innovation: float, n: int) -> None:
    """x + K·innovation and P − K·S·Kᵀ in place; products of two gains commute, so P stays symmetric."""
    for i in range(n):
        x[i] += K[i] * innovation
        for j in range(n):
            P[i, j] -= S * (K[i] * K[j])


@njit(cache=True, error_model="numpy", inline="always")
def expected(kind: int, x: Floats, point: Floats, node: Floats, ahead: float, p: Floats, H: Floats) -> float:
    """h(point) + H·(x − point): the measurement expected at x, linearised at `point`; fills H."""
    value = predict(kind, point, node, ahead, p, H)
    for i in range(SIZE):
        if H[i] != 0.0:
            value += H[i] * (x[i] - point[i])
    return value


@summing
def shared(P: Floats, H: Floats, a: int, b: int) -> float:
    """Row a of H times P times row b."""
    total = 0.0
    for i in range(SIZE):
        if H[a, i] != 0.0:
            for j in range(SIZE):
                total += H[a, i] * P[i, j] * H[b, j]
    return total


@njit(cache=True, error_model="numpy", inline="always")
def distance(P: Floats, H: Floats, nu: Floats, var: Floats, m: int, count: int) -> float:
    """Squared Mahalanobis distance of one or two scalar innovations from one linearisation (rows of H).

    var[m], var[m + 1]: their own variances
    """
    a = shared(P, H, 0, 0) + var[m]
    if count == 1:
        return nu[0] * nu[0] / a
    b, c = shared(P, H, 0, 1), shared(P, H, 1, 1) + var[m + 1]
    return (c * nu[0] * nu[0] - 2.0 * b * nu[0] * nu[1] + a * nu[1] * nu[1]) / (a * c - b * b)


@njit(cache=True, error_model="numpy", inline="always")
def is_pair(kind: int) -> bool:
    """Whether this kind is the first of an east-north pair."""
    found = False
    for e in range(PAIRS.size):
        found = found or PAIRS[e] == kind
    return found


@njit(cache=True, error_model="numpy", inline="always")
def is_given(kind: int) -> bool:
    """Whether this kind is mechanics, not a reading: the hitch and standing still have no outliers to refuse.

    Refusing them would leave the seeder's yaw where a bad start put it.
    """
    return kind == HITCH or STILL_V <= kind <= STILL_AX


@njit(cache=True, error_model="numpy", inline="always")
def update_node(
    x: Floats,
    P: Floats,
    lin: Floats,
    linear: bool,
    node: Floats,
    kinds: Ints,
    z: Floats,
    var: Floats,
    ahead: Floats,
    p: Floats,
    first: int,
    last: int,
    H: Floats,
    K: Floats,
    S: Floats,
    nu: Floats,
    used: Bools,
    store: bool,
) -> float:
    """All measurements of one node, in order; returns the Gaussian log-likelihood of those that pass the gate.

    Both of a pair are linearised at one point and judged together; the second's innovation is then what the
    first leaves of it. Row m of H, K, S, nu, used is filled for measurement m when `store`, else row 0 is scratch.
    """
    total = 0.0
    rows, left = np.empty((2, SIZE)), np.empty(2)
    point, before = np.empty(SIZE), np.empty(SIZE)
    m = first
    while m < last:
        count = 2 if is_pair(kinds[m]) else 1
        for e in range(SIZE):
            before[e] = x[e]
            point[e] = lin[e] if linear else x[e]
        for i in range(count):
            left[i] = z[m + i] - expected(kinds[m + i], x, point, node, ahead[m + i], p, rows[i])
        gate = GATE_2 if count == 2 else GATE_1
        passes = is_given(kinds[m]) or distance(P, rows, left, var, m, count) <= gate
        if not passes:
            total -= 0.5 * gate
        for i in range(count):
            r = m + i if store else 0
            S[r] = gain(P, rows[i], var[m + i], K[r], int(p[P_ACTIVE]))
            nu[r] = left[i]
            for e in range(SIZE):
                H[r, e] = rows[i, e]
                nu[r] -= rows[i, e] * (x[e] - before[e])
            used[r] = passes
            total -= 0.5 * np.log(S[r])
            if passes:
                total -= 0.5 * nu[r] * nu[r] / S[r]
                correct(x, P, K[r], S[r], nu[r], int(p[P_ACTIVE]))
        m += count
    return total


@njit(cache=True, error_model="numpy")
def pack(P: Floats, row: Floats, n: int) -> None:
    """Lower triangle of a symmetric matrix into a row."""
    e = 0
    for i in range(n):
        for j in range(i + 1):
            row[e] = P[i, j]
            e += 1


@njit(cache=True, error_model="numpy")
def unpack(row: Floats, P: Floats, n: int) -> None:
    """The symmetric matrix whose lower triangle `pack` wrote."""
    e = 0
    for i in range(n):
        for j in range(i + 1):
            P[i, j] = row[e]
            P[j, i] = row[e]
            e += 1


@njit(cache=True, error_model="numpy")
def forward(
    x0: Floats,
    P0: Floats,
    u: Floats,
    nodes: Floats,
    dt: float,
    kinds: Ints,
    starts: Ints,
    z: Floats,
    var: Floats,
    ahead: Floats,
    inject: Floats,
    p: Floats,
    lin: Floats,
    linear: bool,
    out_x: Floats,
    out_P: Floats,
    H: Floats,
    K: Floats,
    S: Floats,
    nu: Floats,
    used: Bools,
    store: bool,
) -> float:
    """Filter all nodes; returns the log-likelihood. With `linear` everything is linearised at `lin` (N, SIZE)."""
    x, P = x0.copy(), P0.copy()
    n = int(p[P_ACTIVE])
    F, A, B = np.eye(SIZE), np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    q = np.empty(SIZE)
    total = 0.0
    for k in range(nodes.shape[0]):
        if k > 0:
            point = lin[k - 1] if linear else x
            there = transition(point, u[k - 1], dt, p, F)
            process_noise(point, u[k - 1], dt, p, q)
            if linear:
                carry(F, x, point, there)
            x = there
            q[EX] += inject[k, 0]
            q[EY] += inject[k, 0]
            q[FX] += inject[k, 1]
            q[FY] += inject[k, 1]
            propagate(P, F, q, A, B, n)
        total += update_node(
            x, P, lin[k] if linear else x, linear, nodes[k], kinds, z, var, ahead, p,
            starts[k], starts[k + 1], H, K, S, nu, used, store,
        )  # fmt: skip
        if store:
            for i in range(SIZE):
                out_x[k, i] = x[i]
            pack(P, out_P[k], n)
    return total


@summing
def absorb(
    lam: Floats, Lam: Floats, H: Floats, K: Floats, S: float, nu: float, LK: Floats, seen: Ints, n: int
) -> None:
    """Adjoint state and covariance back through one scalar update: (I − KH)ᵀ on both sides, plus HᵀH/S.

    LK (SIZE,), seen (SIZE,) : scratch
    """
    s = 0.0
    kl = 0.0
    count = 0
    for i in range(n):  # Lam is symmetric: by rows
        row = Lam[i]
        v = 0.0
        for j in range(n):
            v += row[j] * K[j]
        LK[i] = v
        s += K[i] * v
        kl += K[i] * lam[i]
        if H[i] != 0.0:
            seen[count] = i
            count += 1
    weight = 1.0 / S + s
    drawn = nu / S + kl
    for e in range(count):
        i = seen[e]
        h = H[i]
        row = Lam[i]
        for j in range(n):
            row[j] -= h * LK[j]
        for c in range(count):
            row[seen[c]] += h * weight * H[seen[c]]
        lam[i] -= h * drawn
    for i in range(n):
        row = Lam[i]
        v = LK[i]
        for c in range(count):
            row[seen[c]] -= v * H[seen[c]]


@part
def times_adjoint(F: Floats, A: Floats, out: Floats, n: int) -> None:
    """Fᵀ·A into `out`, row by row."""
    for i in range(n):
        d = F[i, i]
        for j in range(n):
            out[i, j] = d * A[i, j]
    for e in range(PATTERN.shape[0]):
        m, i = PATTERN[e, 0], PATTERN[e, 1]
        f = F[m, i]
        for j in range(n):
            out[i, j] += f * A[m, j]


@njit(cache=True, error_model="numpy", inline="always")
def retreat(lam: Floats, Lam: Floats, F: Floats, A: Floats, B: Floats, n: int) -> None:
    """Adjoint state and covariance back through one step: Fᵀ·lambda and Fᵀ·Lambda·F. A, B : scratch."""
    a = np.empty(SIZE)
    for i in range(n):
        a[i] = F[i, i] * lam[i]
    for e in range(PATTERN.shape[0]):
        m, i = PATTERN[e, 0], PATTERN[e, 1]
        a[i] += F[m, i] * lam[m]
    for i in range(n):
        lam[i] = a[i]
    times_adjoint(F, Lam, A, n)
    transpose(A, B, n)
    times_adjoint(F, B, Lam, n)


@summing
def kept_covariance(P: Floats, Lam: Floats, A: Floats, out: Floats, n: int) -> None:
    """Rows and columns KEEP of P − P·Lambda·P. A : scratch."""
    for a in range(KEEP.size):
        row = A[a]
        for j in range(n):
            row[j] = 0.0
        for m in range(n):
            f = P[KEEP[a], m]
            other = Lam[m]
            for j in range(n):
                row[j] += f * other[j]
        for b in range(a + 1):
            other = P[KEEP[b]]
            v = P[KEEP[a], KEEP[b]]
            for m in range(n):
                v -= row[m] * other[m]
            out[a, b] = v
            out[b, a] = v


@njit(cache=True, error_model="numpy")
def backward(
    u: Floats,
    dt: float,
    starts: Ints,
    p: Floats,
    lin: Floats,
    out_x: Floats,
    out_P: Floats,
    H: Floats,
    K: Floats,
    S: Floats,
    nu: Floats,
    used: Bools,
    smooth_x: Floats,
    smooth_P: Floats,
) -> None:
    """Modified Bryson-Frazier smoother over stored filter results; `lin` (N, SIZE) is where F was taken.

    Fills smooth_x (N, SIZE) and smooth_P (N, kept, kept).
    """
    lam = np.zeros(SIZE)
    Lam = np.zeros((SIZE, SIZE))
    P = np.zeros((SIZE, SIZE))
    LK, seen = np.empty(SIZE), np.empty(SIZE, dtype=np.int64)
    n = int(p[P_ACTIVE])
    F, A, B = np.eye(SIZE), np.empty((SIZE, SIZE)), np.empty((SIZE, SIZE))
    last = out_x.shape[0] - 1
    for back in range(last + 1):
        k = last - back
        if back > 0:
            transition(lin[k], u[k], dt, p, F)
            retreat(lam, Lam, F, A, B, n)
        unpack(out_P[k], P, n)
        for i in range(SIZE):
            smooth_x[k, i] = out_x[k, i]
        for j in range(n):  # P is symmetric: by rows
            for i in range(SIZE):
                smooth_x[k, i] -= P[j, i] * lam[j]
        kept_covariance(P, Lam, A, smooth_P[k], n)
        for m in range(starts[k + 1] - 1, starts[k] - 1, -1):
            if used[m]:
                absorb(lam, Lam, H[m], K[m], S[m], nu[m], LK, seen, n)
