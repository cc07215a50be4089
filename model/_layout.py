"""Names of the places in the compiled kernels' arrays: state, packed parameters, inputs, output."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# State: generalised coordinates, their rates (world frame), distance travelled by O1, one slip state a wheel.
X1, Y1, YAW1, YAW2, VX1, VY1, W1, W2 = range(8)
STATE_SIZE = 8
DISTANCE = 8
SLIP = 9
MAX_WHEELS = 10
FULL_SIZE = SLIP + MAX_WHEELS

# One output sample: the state, the second derivatives of the coordinates, the mean steering angle.
AX1, AY1, ALPHA1, ALPHA2, STEER = range(8, 13)
OUTPUT_SIZE = 13

# Packed parameters of one machine.
(
    MASS1, INERTIA1, HITCH, MASS2, INERTIA2, HITCH_TO_COM, DRAFT, COS_DRAFT, SIN_DRAFT, DRAFT_POINT,
    WHEELBASE, ACKERMANN, SPEED_RATE, RESISTANCE, STIFF_RATE, SLIP_RATE, SEEDER_WHEELS,
) = range(17)  # fmt: skip
WHEELS = 17
# One wheel: position in its body's frame, tyre, load and share of the traction.
WHEEL_X, WHEEL_Y, STIFFNESS, LIMIT, ROLLING, RELAXATION, SHARE = range(7)
WHEEL_SIZE = 7
PARAMETER_SIZE = WHEELS + MAX_WHEELS * WHEEL_SIZE
TRACTOR_WHEELS = 4

# Inputs at one instant: sines and cosines of the front wheels' angles, speed asked for and its rate,
# disturbance.
SIN_LEFT, COS_LEFT, SIN_RIGHT, COS_RIGHT, SPEED, ACCELERATION, FORCE = range(7)
FORCE_SIZE = 6  # main vector (x, y of the body's frame) and moment at O1, then at O2
FORCE_NOW = FORCE + FORCE_SIZE  # with what is given over distance
FORCE_FACTOR = FORCE_NOW + FORCE_SIZE  # scale of all disturbance
INPUT_SIZE = FORCE_FACTOR + 1

# Driver: one row a run; all zero and ACTIVE = 0 without one.
ACTIVE, PREVIEW, DELAY, LAG, MAX_RATE, MAX_ANGLE, GAIN, PERIOD_STEPS = range(8)
DRIVER_SIZE = 8

# What one run of a batch changes.
START, STEER_OFFSET, STEER_SCALE, SPEED_SCALE, SPEED_OFFSET, STEER_ROW, FORCE_ROW, FORCE_SCALE = range(8)
CHANGE_SIZE = 8

# A path to follow: position, heading and curvature at equal distances.
PATH_X, PATH_Y, PATH_YAW, PATH_CURVATURE = range(4)
PATH_SIZE = 4

# The measured tractor, imposed on the seeder.
(
    IMPOSED_X,
    IMPOSED_Y,
    IMPOSED_YAW,
    IMPOSED_VX,
    IMPOSED_VY,
    IMPOSED_W,
    IMPOSED_AX,
    IMPOSED_AY,
    IMPOSED_ALPHA,
) = range(9)
IMPOSED_SIZE = 9


class Options(NamedTuple):
    """Choices of the compiled code, as whole numbers (0 or 1 but for the law's code), and tolerances."""

    law: int
    as_printed: int
    cramer: int
    ellipse: int
    draft_on_axis: int
    largest_rate: float
    relative_tolerance: float
    absolute_tolerance: float


class Tables(NamedTuple):
    """Inputs on equal grids: time tables each dt from 0, distance tables each spacing, the path each
    pitch."""

    dt: float
    steer: Floats  # (rows, n) rad
    speed: Floats  # (n,) m/s
    acceleration: Floats  # (n,) m/s²
    time_force: Floats  # (rows, n, 6), n = 0: none
    spacing: float
    distance_force: Floats  # (rows, k, 6), k = 0: none
    pitch: float
    path: Floats  # (m, 4), m = 0: none
