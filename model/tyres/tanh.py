"""Smooth saturating tyre: F = −limit·tanh(C·δ/limit)."""

from __future__ import annotations

import math

from ..parts import part

NAME = "tanh"


@part
def lateral_force(slip_angle: float, stiffness: float, limit: float) -> float:
    """Force F = −limit·tanh(C·δ/limit), N; slope −C at δ = 0, never beyond the limit."""
    if not limit > 0.0:
        return 0.0
    return -limit * math.tanh(stiffness * slip_angle / limit)
