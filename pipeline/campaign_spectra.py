"""Spectra of one version over its passes: a pass holds few waves, so passes are averaged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bounds import DEVIATION1, DEVIATION2
from .spectra import LOWEST_ACCELERATION, acceleration_peak, spatial_peak
from .traditional import Track
from .welch import Density, band_of, peaks, welch

Floats = NDArray[np.float64]

BODIES = {"tractor": DEVIATION1, "seeder": DEVIATION2}


@dataclass(frozen=True)
class StoredDensity:
    """One pass's density as its result keeps it: frequency and density (n,), degrees of freedom, segments."""

    frequency: Floats
    density: Floats
    dof: float
    segments: int
    segment_length: float


def averaged(stored: Sequence[StoredDensity]) -> Density | None:
    """Mean of the passes' densities on the commonest frequency grid, weighted by degrees of freedom, with its band."""
    if not stored:
        return None
    grids = [(s.frequency.size, round(float(s.frequency[0]), 9)) for s in stored]
    common = max(set(grids), key=grids.count)
    kept = [s for s, grid in zip(stored, grids, strict=True) if grid == common]
    dof = float(sum(s.dof for s in kept))
    density = np.average([s.density for s in kept], axis=0, weights=[s.dof for s in kept])
    low, high = band_of(dof)
    first = kept[0]
    # Stored curves leave out frequency zero; the bins' width is read from the first two, so it is put back.
    frequency = np.concatenate(([0.0], first.frequency))
    density = np.concatenate(([0.0], density))
    return Density(
        frequency,
        density,
        density * low,
        density * high,
        dof,
        sum(s.segments for s in kept),
        first.segment_length,
    )


def version_spectra(
    tracks: Sequence[Mapping[str, Track]], accelerations: Sequence[Mapping[str, StoredDensity]]
) -> dict[str, Any]:
    """Spatial density of the deviation and density of the lateral acceleration, each averaged over passes."""
    found: dict[str, Any] = {"spatial": {}, "acceleration": {}}
    for body, response in BODIES.items():
        records = [t[response] for t in tracks if response in t]
        if records:
            step = float(np.median(np.diff(records[0].s)))
            density = welch([r.measured for r in records], step)
            top = [spatial_peak(p) for p in peaks(density)]
            found["spatial"][body] = _values(density, len(records)) | {"peaks": top}
        stored = [a[body] for a in accelerations if body in a]
        mean = averaged(stored)
        if mean is not None:
            strongest = [p for p in peaks(mean, most=5) if p.frequency >= LOWEST_ACCELERATION][:3]
            top = [acceleration_peak(p) for p in strongest]
            found["acceleration"][body] = _values(mean, len(stored)) | {"peaks": top}
    return found


def _values(density: Density, passes: int) -> dict[str, Any]:
    kept = asdict(density)
    return {"passes": passes} | {key: kept[key] for key in ("segments", "segment_length", "dof")}
