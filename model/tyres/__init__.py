"""SHELF: one file a tyre law. A law turns a slip angle into a lateral force limited by adhesion.

Every law is a compiled scalar function `lateral_force(slip_angle, stiffness, limit)` in rad, N/rad and N;
the force opposes the slip. To add one: a file with NAME and `lateral_force`, its line in TYRES and its
branch in `lateral_force` below (compiled code cannot loop over functions).
"""

from __future__ import annotations

from numba import njit

from . import fiala, linear, tanh

TYRES = (linear, tanh, fiala)  # the position is the law's code in the compiled kernels
NAMES = tuple(law.NAME for law in TYRES)

_linear, _tanh, _fiala = linear.lateral_force, tanh.lateral_force, fiala.lateral_force


def law_code(name: str) -> int:
    """Code of a law by its name. Raises ValueError naming the laws there are."""
    if name not in NAMES:
        raise ValueError(f"tyre_law is {name!r}; it must be one of {', '.join(NAMES)}")
    return NAMES.index(name)


@njit(cache=True, error_model="numpy")
def lateral_force(law: int, slip_angle: float, stiffness: float, limit: float) -> float:
    """Lateral force, N, of the law with that code."""
    if law == 1:
        return _tanh(slip_angle, stiffness, limit)
    if law == 0:
        return _linear(slip_angle, stiffness, limit)
    return _fiala(slip_angle, stiffness, limit)
