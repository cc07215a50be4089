"""Fiala's brush tyre (parabolic pressure): a cubic in tan δ up to full sliding.

Source: E. Fiala, "Seitenkräfte am rollenden Luftreifen", VDI-Zeitschrift 96 (1954); in this form
R. N. Jazar, "Vehicle Dynamics", and H. B. Pacejka, "Tire and Vehicle Dynamics", chapter 3.
"""

from __future__ import annotations

import math

from ..parts import part

NAME = "fiala"


@part
def lateral_force(slip_angle: float, stiffness: float, limit: float) -> float:
    """Force F = −C·z + C²·|z|·z/(3·limit) − C³·z³/(27·limit²) with z = tan δ, N; −limit·sign δ once sliding,
    which begins at |z| = 3·limit/C."""
    if not limit > 0.0:
        return 0.0
    z = math.tan(min(max(slip_angle, -1.57), 1.57))
    if abs(z) >= 3.0 * limit / stiffness:
        return -math.copysign(limit, slip_angle)
    a = stiffness * z
    return -a + a * abs(a) / (3.0 * limit) - a * a * a / (27.0 * limit * limit)
