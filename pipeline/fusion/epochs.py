"""Positions of one receiver in the plane, as the fusion takes them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Epochs:
    """Positions of one receiver in the plane: t (UTC), x, y, z, stated deviation, whether fixed, velocity or NaN.

    speed : (N,) m/s, by the receiver's own statement, at rest too; NaN or None where it states none
    """

    name: str
    body: str
    first: bool
    t: Floats
    x: Floats
    y: Floats
    z: Floats
    sd: Floats
    fixed: NDArray[np.bool_]
    vx: Floats
    vy: Floats
    heading: Floats
    stated: bool
    speed: Floats | None = None
