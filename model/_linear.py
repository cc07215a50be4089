"""Compiled central differences of the right-hand side about straight running."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from . import _layout as at
from ._kernels import derivative
from ._layout import Floats, Options, Tables
from ._steering import inner_angles
from .parts import part

SLIP, FORCE = at.SLIP, at.FORCE
STATES = 4  # lateral velocity of O1, both yaw rates, hitch angle; then the slip states
INPUTS = 5  # steering angle, lateral force and moment at O1, the same at O2
ROWS = STATES + at.MAX_WHEELS + 2  # rates of the states, then the lateral accelerations of O1 and O2
SMALL = 1e-6  # of a state or of the steering angle; forces are moved by SMALL times weight-sized numbers
FORCE_UNIT = 1e4


@part
def straight_rates(
    place: Floats, speed: float, p: Floats, tables: Tables, options: Options, rows: Floats
) -> None:
    """Rates of the lateral states at `place` = (states, inputs) into rows (ROWS,)."""
    s, u, rate = np.zeros(at.FULL_SIZE), np.zeros(at.INPUT_SIZE), np.zeros(at.FULL_SIZE)
    s[at.VX1], s[at.VY1], s[at.W1], s[at.W2], s[at.YAW2] = speed, place[0], place[1], place[2], -place[3]
    for i in range(at.MAX_WHEELS):
        s[SLIP + i] = place[STATES + i]
    first = STATES + at.MAX_WHEELS
    half = inner_angles(place[first], p[at.ACKERMANN])
    left, right = place[first] + half, place[first] - half
    u[at.SIN_LEFT], u[at.COS_LEFT], u[at.SIN_RIGHT], u[at.COS_RIGHT] = (
        math.sin(left), math.cos(left), math.sin(right), math.cos(right),
    )  # fmt: skip
    u[at.SPEED], u[at.FORCE_FACTOR] = speed, 1.0
    u[FORCE + 1], u[FORCE + 2], u[FORCE + 4], u[FORCE + 5] = (
        place[first + 1], place[first + 2], place[first + 3], place[first + 4],
    )  # fmt: skip
    derivative(s, p, u, tables.distance_force[0], tables.spacing, options, rate)
    rows[0] = rate[at.VY1] - speed * place[1]
    rows[1], rows[2], rows[3] = rate[at.W1], rate[at.W2], place[1] - place[2]
    for i in range(at.MAX_WHEELS):
        rows[STATES + i] = rate[SLIP + i]
    rows[ROWS - 2] = rate[at.VY1]
    rows[ROWS - 1] = (
        rate[at.VY1]
        - p[at.HITCH] * rate[at.W1]
        - p[at.HITCH_TO_COM] * math.cos(place[3]) * rate[at.W2]
        + math.sin(place[3]) * rate[at.VX1]
    )


@njit(cache=True, error_model="numpy")
def straight_jacobian(speed: float, p: Floats, tables: Tables, options: Options) -> Floats:
    """∂(rates, lateral accelerations)/∂(states, inputs) at straight running, (ROWS, STATES + wheels +
    INPUTS)."""
    columns = STATES + at.MAX_WHEELS + INPUTS
    result, high, low = np.zeros((ROWS, columns)), np.zeros(ROWS), np.zeros(ROWS)
    place = np.zeros(columns)
    for j in range(columns):
        move = SMALL * (FORCE_UNIT if j > STATES + at.MAX_WHEELS else 1.0)
        place[j] = move
        straight_rates(place, speed, p, tables, options, high)
        place[j] = -move
        straight_rates(place, speed, p, tables, options, low)
        place[j] = 0.0
        for i in range(ROWS):  # not a slice: its check of shapes would be half of this file's compile time
            result[i, j] = (high[i] - low[i]) / (2.0 * move)
    return result
