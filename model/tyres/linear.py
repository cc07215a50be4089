"""Linear tyre, cut off at adhesion: F = −C·δ, |F| ≤ limit."""

from __future__ import annotations

from ..parts import part

NAME = "linear"


@part
def lateral_force(slip_angle: float, stiffness: float, limit: float) -> float:
    """Force F = −clip(C·δ, −limit, limit), N."""
    force = -stiffness * slip_angle
    return min(max(force, -limit), limit)
