"""Whether the filter's innovations are what it says: NIS against χ² bounds, whiteness, share refused."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from . import state as s
from .engine_compiled import Filtered
from .motion import SensorConsistency
from .problem import Measurements

Floats = NDArray[np.float64]

CHANNELS = {
    s.FIXED_X: ("gnss position, fixed", 2), s.FLOAT_X: ("gnss position, not fixed", 2), s.VEL_X: ("gnss velocity", 2),
    s.SECOND_X: ("second gnss on the seeder", 2), s.THIRD_X: ("second gnss on the tractor", 2),
    s.ACCEL_Y: ("lateral specific force", 1), s.HITCH: ("seeder's axle", 1), s.WHEEL: ("wheel speed", 1),
    s.HEADING1: ("gnss heading", 1), s.HEADING2: ("gnss heading, seeder", 1),
}  # fmt: skip
LEVEL = 0.999  # of the bounds
MOST = 150  # independent samples the bounds are made for: no field model is exact to more
CAUTION = 0.4  # of the expected NIS: a channel stated too cautiously by less than this misleads nobody
MOST_REFUSED = 0.05
MOST_CORRELATED = 0.4


def assess(q: Measurements, f: Filtered) -> tuple[SensorConsistency, ...]:
    """Statistics of each kind of measurement that decides the result; at least 20 of it."""
    out = []
    for kind, (channel, dof) in CHANNELS.items():
        first = np.flatnonzero(q.kind == kind)
        if first.size < 20:
            continue
        other = np.flatnonzero(q.kind == kind + 1) if dof == 2 else first
        out.append(_channel(channel, dof, first, other, f))
    return tuple(out)


def _channel(
    channel: str, dof: int, a: NDArray[np.int64], b: NDArray[np.int64], f: Filtered
) -> SensorConsistency:
    used = f.used[a]
    normal = f.nu[a] / np.sqrt(f.S[a])
    nis = normal**2 + (f.nu[b] ** 2 / f.S[b] if dof == 2 else 0.0)
    good = nis[used]
    z = normal[used] - (normal[used].mean() if used.any() else 0.0)
    rho = float(z[1:] @ z[:-1] / max(float(z @ z), 1e-300)) if z.size > 2 else 0.0
    independent = min(good.size * (1.0 - rho**2) / (1.0 + rho**2), MOST)
    freedom = max(independent, 1.0) * dof
    tail = 0.5 * (1.0 - LEVEL)
    low, high = (
        float(2.0 * gammaincinv(freedom / 2.0, level) / freedom * dof) for level in (tail, 1.0 - tail)
    )
    low = min(low, CAUTION * dof)
    mean = float(good.mean()) if good.size else float("nan")
    fine = low <= mean <= high and abs(rho) < MOST_CORRELATED and (~used).mean() <= MOST_REFUSED
    return SensorConsistency(channel, int(a.size), int((~used).sum()), dof, mean, low, high, rho, bool(fine))


def innovations(q: Measurements, f: Filtered, t: Floats) -> dict[str, dict[str, Floats]]:
    """Normalised innovations by channel for the report: t (s, UTC), value (1), used (0 or 1)."""
    out = {}
    for kind, (channel, dof) in CHANNELS.items():
        for offset, axis in ((0, ", east"), (1, ", north")) if dof == 2 else ((0, ""),):
            m = np.flatnonzero(q.kind == kind + offset)
            if m.size:
                m = m[:: max(1, m.size // 4000)]
                out[channel + axis] = {
                    "t": t[q.node[m]], "value": f.nu[m] / np.sqrt(f.S[m]), "used": f.used[m].astype(np.float64)
                }  # fmt: skip
    return out
