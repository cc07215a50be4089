"""What a report is made from: one pass's stored result, read back. Sections see this and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sensors.manifest import Manifest

Floats = NDArray[np.float64]
Columns = Mapping[str, Floats]

BODIES = ("1", "2")
BODY_NAMES = {"1": "tractor", "2": "seeder"}


@dataclass(frozen=True)
class PlotSeries:
    """One curve kept for the report: x, y (N,), and optionally low, high (N,), a band about y."""

    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None


@dataclass(frozen=True)
class PassView:
    """One pass's result as it lies in its folder.

    metrics : metrics.json
    trajectory, simulation : columns of the two parquet files, on one time grid
    comparison : columns of comparison.parquet, on the rows' distance grid (empty when no row was compared)
    plots : curves by plot and series (spectra, innovations, ...)
    lines : the rows' AB lines, {row, a, b} in m ENU, in the direction of travel
    origin : {lat, lon, alt} of the ENU plane
    """

    manifest: Manifest
    manifest_text: str
    metrics: Mapping[str, Any]
    trajectory: Columns
    simulation: Columns
    comparison: Columns = field(default_factory=dict)
    plots: Mapping[str, Mapping[str, PlotSeries]] = field(default_factory=dict)
    lines: tuple[Mapping[str, Any], ...] = ()
    origin: Mapping[str, float] = field(default_factory=dict)

    @property
    def bodies(self) -> tuple[str, ...]:
        """Suffixes of the bodies that this pass has: ("1",) or ("1", "2")."""
        return tuple(b for b in BODIES if f"x{b}" in self.trajectory)

    @property
    def imposed(self) -> bool:
        """Whether the measured tractor was imposed on the model, for want of an independent steering series."""
        return (self.metrics.get("steering") or {}).get("testable") is False

    @property
    def simulated_bodies(self) -> tuple[str, ...]:
        """Suffixes of the bodies that the model itself moved on this pass; an imposed tractor is none of them."""
        moved = (b for b in self.bodies if not (self.imposed and b == "1"))
        return tuple(b for b in moved if np.isfinite(self.simulation[f"x{b}"]).any())

    @property
    def row_indices(self) -> tuple[int, ...]:
        """Indices of the rows found, in order."""
        return tuple(int(r) for r in np.unique(self.trajectory["row"]) if r >= 0)
