"""Choices of the comparison, fixed before data are seen; each with its reason in
docs/method-comparison.md."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..model.settings import SimulationSettings


@dataclass(frozen=True)
class ReplaySettings:
    """Choices of the comparison that are fixed before data are seen.

    horizon : m, length of the headline's windows; horizons : m, of the horizon curve (inf: the whole row)
    grid_step : m; spacing : s, samples of a run
    slow_steer_sd : rad, standard deviation of slow steering error where the series states no correlation time
    draws : Monte Carlo draws of inputs and parameters; seed : of their generator
    least_coverage : share of a row's grid that must lie outside GNSS gaps; longest_gap : s
    simulation : equations, tyre law, solver
    """

    horizon: float = 25.0
    horizons: tuple[float, ...] = (10.0, 25.0, 50.0, float("inf"))
    grid_step: float = 0.2
    spacing: float = 0.02
    slow_steer_sd: float = math.radians(0.2)
    draws: int = 200
    seed: int = 1
    least_coverage: float = 0.95
    longest_gap: float = 0.5
    simulation: SimulationSettings = SimulationSettings()
