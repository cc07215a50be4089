"""Choices of a simulation: equations, tyre law, solver, integrator, step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from .tyres import law_code


@dataclass(frozen=True)
class SimulationSettings:
    """How the equations are set up and solved.

    step : s, of Runge–Kutta 4 (also the grid on which unequal controls are laid)
    largest_rate : of step × fastest decay rate; a step is cut into parts that keep to it (Runge–Kutta 4 is
        stable up to 2.78), which matters towards standstill, where sideways damping grows as 1/v
    equations : "exact" (Lagrange) or "as_printed" (the paper's eqs 4 and 5 to the letter)
    tyre_law : "linear", "tanh" or "fiala"
    solver : of M·q̈ = Q − h, "elimination" or the paper's "cramer"
    integrator : "rk4", or the paper's adaptive "dopri45" with relative_tolerance and absolute_tolerance
    friction_ellipse : whether traction takes from the lateral force's limit
    draft_direction : the draft acts against the "velocity" of its point or along the seeder's "axis"
    ackermann : front wheels by Ackermann geometry, else equal angles
    speed_time_constant : s, of the speed controller
    """

    step: float = 0.01
    largest_rate: float = 1.5
    equations: Literal["exact", "as_printed"] = "exact"
    tyre_law: str = "tanh"
    solver: Literal["elimination", "cramer"] = "elimination"
    integrator: Literal["rk4", "dopri45"] = "rk4"
    relative_tolerance: float = 1e-8
    absolute_tolerance: float = 1e-10
    friction_ellipse: bool = False
    draft_direction: Literal["velocity", "axis"] = "velocity"
    ackermann: bool = True
    speed_time_constant: float = 0.5

    def __post_init__(self) -> None:
        for name in (
            "step",
            "largest_rate",
            "relative_tolerance",
            "absolute_tolerance",
            "speed_time_constant",
        ):
            value = getattr(self, name)
            if not (value > 0.0 and math.isfinite(value)):
                raise ValueError(f"settings.{name} is {value!r}; it must be a finite number above 0")
        law_code(self.tyre_law)
        for name, allowed in _CHOICES.items():
            if getattr(self, name) not in allowed:
                raise ValueError(
                    f"settings.{name} is {getattr(self, name)!r}; it must be one of {', '.join(allowed)}"
                )


_CHOICES = {
    "equations": ("exact", "as_printed"),
    "solver": ("elimination", "cramer"),
    "integrator": ("rk4", "dopri45"),
    "draft_direction": ("velocity", "axis"),
}
