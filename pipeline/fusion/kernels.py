"""Compiled functions of the joint filter: process, measurements, forward filter, backward smoother.

Every function is numbers in, numbers out, and runs uncompiled too (`f.py_func`), which the reference engine and
the tests use. Symbols: x state, P covariance, F transition, H measurement row, K gain, S innovation variance.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ...model.machine import GRAVITY
from ...model.parts import part
from .settings import BEND_FROM, DRAG, TAU_TURN, TURN_FROM
from .state import (
    ACCEL_Y,
    BAX,
    BAY,
    BGX,
    BGY,
    BGZ,
    BGZ2,
    EX,
    EY,
    FLOAT_X,
    FX,
    FY,
    GX,
    GY,
    HEADING,
    HEADING1,
    HEADING2,
    HITCH,
    KAPPA,
    LAG,
    LEVEL_PITCH,
    LEVEL_ROLL,
    MAGNETIC1,
    MAGNETIC2,
    N_PITCH2,
    N_ROLL2,
    P_ANT2_X,
    P_ANT2_Y,
    P_ANT2_Z,
    P_ANT_X,
    P_ANT_Y,
    P_ANT_Z,
    P_AXLE2,
    P_BETA1,
    P_BETA2,
    P_BIAS_WALK,
    P_COM2,
    P_COMPLIANCE,
    P_DRAG2,
    P_FORWARD,
    P_GYRO1,
    P_GYRO2,
    P_HITCH,
    P_KAPPA_DRIVE,
    P_KAPPA_WALK,
    P_REAR,
    P_SD_E,
    P_SD_F,
    P_SD_G,
    P_SEEDER,
    P_SWAY,
    P_SWAY2,
    P_TAU_E,
    P_TAU_SLIP,
    P_TILT,
    P_TURN,
    P_TURN2,
    PITCH,
    ROLL,
    SCALE1,
    SCALE2,
    SECOND_X,
    SEEDER_HEADING,
    SLIP1,
    SLIP2,
    STILL_AX,
    STILL_GX,
    STILL_GY,
    STILL_GZ,
    STILL_SLIP,
    STILL_V,
    THIRD_X,
    TURN1,
    TURN2,
    U_DRIVE,
    U_FX,
    U_FY,
    U_GAP1,
    U_GAP2,
    U_REST,
    U_W2,
    U_WX,
    U_WY,
    U_WZ,
    VEL_X,
    WHEEL,
    YAW1,
    YAW2,
    V,
    X,
    Y,
)

POSITION_WALK = 1.0e-3  # m/sqrt(s): what the planar kinematics leaves out
SLOWEST = 0.3  # m/s: slip angles are taken of at least this speed
GAP_RATE = 0.05  # rad/s (tractor, seeder yaw rate) that may hide in a hole of the samples
GAP_ACCEL = 1.0  # m/s²
GATE_2 = 18.42  # χ² with 2 degrees of freedom at 1e-4
GATE_1 = 15.14  # χ² with 1 degree of freedom at 1e-4

Floats = NDArray[np.float64]


@part
def fade(x: Floats, u: Floats, dt: float, p: Floats, F: Floats, out: Floats) -> None:
    """Gauss-Markov components after one step, into `out`, and their factors, on the diagonal of F."""
    slip, slow = math.exp(-dt / p[P_TAU_SLIP]), math.exp(-dt / p[P_TAU_E])
    bent = p[P_SEEDER] * abs(x[YAW1] - x[YAW2]) > BEND_FROM
    turn = math.exp(-dt / TAU_TURN)
    for i in (SLIP1, SLIP2):
        F[i, i] = slip
        out[i] = slip * x[i]
    for i, rate in ((TURN1, u[U_WZ] - x[BGZ]), (TURN2, u[U_W2] - x[BGZ2])):
        turning = bent or abs(x[V] * rate) > TURN_FROM
        F[i, i] = turn if turning else slip  # the slip of a turn ends with the turn
        out[i] = F[i, i] * x[i]
    for i in (EX, EY, FX, FY, GX, GY):
        F[i, i] = slow
        out[i] = slow * x[i]


@njit(cache=True, error_model="numpy")
def transition(x: Floats, u: Floats, dt: float, p: Floats, F: Floats) -> Floats:
    """State after one step and its Jacobian, written into F (which holds the identity outside its pattern).

    Strapdown kinematics of the tractor's rear axle, gyros and accelerometers as inputs:
    yaw' = (q sin roll + r cos roll)/cos pitch, V' = a_forward + yaw' SLIP1, (X, Y)' = Rz(yaw)(V, SLIP1).
    The vertical specific force is taken as g: what it does beside, times the tilt, is less than vibration, while
    its correlation with pitching would let a centimetre of lever arm pass for half a degree of tilt.
    """
    out = x.copy()
    moving = 0.0 if u[U_REST] > 0.5 else 1.0
    h = dt * moving
    s, c = math.sin(x[ROLL]), math.cos(x[ROLL])
    st, ct = math.sin(x[PITCH]), math.cos(x[PITCH])
    tan = st / ct
    wx, wy, wz = u[U_WX] - x[BGX], u[U_WY] - x[BGY], u[U_WZ] - x[BGZ]
    level = wy * s + wz * c
    turn = level / ct * (1.0 - x[SCALE1])
    turn2 = (u[U_W2] - x[BGZ2]) * (1.0 - x[SCALE2])
    out[YAW1] = x[YAW1] + turn * h
    out[ROLL] = x[ROLL] + (wx + tan * level) * h
    out[PITCH] = x[PITCH] + (wy * c - wz * s) * h
    fx, fy = u[U_FX] - x[BAX], u[U_FY] - x[BAY]
    up = s * fy + c * GRAVITY
    across = x[SLIP1] + x[TURN1]
    out[V] = x[V] + (ct * fx + st * up + turn * across) * h
    middle = x[YAW1] + 0.5 * turn * h
    speed = 0.5 * (x[V] + out[V])
    cy, sy = math.cos(middle), math.sin(middle)
    out[X] = x[X] + (speed * cy - across * sy) * dt
    out[Y] = x[Y] + (speed * sy + across * cy) * dt
    out[YAW2] = x[YAW2] + turn2 * h
    fade(x, u, dt, p, F, out)
    F[X, YAW1], F[Y, YAW1] = -(out[Y] - x[Y]), out[X] - x[X]
    F[X, V], F[X, SLIP1] = cy * dt, -sy * dt
    F[Y, V], F[Y, SLIP1] = sy * dt, cy * dt
    F[X, TURN1], F[Y, TURN1], F[V, TURN1] = F[X, SLIP1], F[Y, SLIP1], turn * h
    F[YAW1, ROLL], F[YAW1, PITCH] = (wy * c - wz * s) / ct * h, turn * tan * h
    F[YAW1, BGY], F[YAW1, BGZ] = -s / ct * h, -c / ct * h
    F[ROLL, ROLL] = 1.0 + tan * (wy * c - wz * s) * h
    F[ROLL, PITCH], F[ROLL, BGX] = level / (ct * ct) * h, -h
    F[ROLL, BGY], F[ROLL, BGZ] = -tan * s * h, -tan * c * h
    F[PITCH, ROLL], F[PITCH, BGY], F[PITCH, BGZ] = -level * h, -c * h, s * h
    F[V, ROLL], F[V, PITCH] = st * (c * fy - s * GRAVITY) * h, (ct * up - st * fx) * h
    F[V, BAX], F[V, BAY], F[V, SLIP1] = -ct * h, -st * s * h, turn * h
    F[YAW2, BGZ2] = -h
    F[YAW1, SCALE1], F[YAW2, SCALE2] = -level / ct * h, -(u[U_W2] - x[BGZ2]) * h
    return out


# The off-diagonal elements of F that `transition` writes; products skip all others.
PATTERN = np.array(
    [
        (X, YAW1), (X, V), (X, SLIP1), (Y, YAW1), (Y, V), (Y, SLIP1), (YAW1, ROLL), (YAW1, PITCH), (YAW1, BGY),
        (YAW1, BGZ), (ROLL, PITCH), (ROLL, BGX), (ROLL, BGY), (ROLL, BGZ), (PITCH, ROLL), (PITCH, BGY), (PITCH, BGZ),
        (V, ROLL), (V, PITCH), (V, BAX), (V, BAY), (V, SLIP1), (YAW2, BGZ2), (YAW1, SCALE1), (YAW2, SCALE2),
        (X, TURN1), (Y, TURN1), (V, TURN1),
    ],
    dtype=np.int64,
)  # fmt: skip


@part
def beyond(value: float, least: float) -> float:
    """Size of a value that counts from `least` on, and wholly when it is far beyond."""
    size = abs(value)
    return size - least * least / size if size > least else 0.0


@njit(cache=True, error_model="numpy")
def process_noise(x: Floats, u: Floats, dt: float, p: Floats, q: Floats) -> None:
    """Variances added by one step, into q (SIZE,): Gauss-Markov drives, gyro and accelerometer noise, holes."""
    q[:] = 0.0
    speed = max(abs(x[V]), SLOWEST)
    lateral, lateral2 = abs(x[V] * (u[U_WZ] - x[BGZ])), abs(x[V] * (u[U_W2] - x[BGZ2]))
    swing = 1.0 - math.exp(-2.0 * dt / p[P_TAU_SLIP])
    slow = 1.0 - math.exp(-2.0 * dt / p[P_TAU_E])
    q[SLIP1] = (p[P_BETA1] + p[P_COMPLIANCE] * lateral) ** 2 * speed**2 * swing
    q[SLIP2] = p[P_SEEDER] * (p[P_BETA2] + p[P_COMPLIANCE] * lateral) ** 2 * speed**2 * swing
    bent = beyond(x[YAW1] - x[YAW2], BEND_FROM) * p[P_SEEDER]
    hard1 = p[P_TURN] * beyond(lateral, TURN_FROM) + DRAG * bent
    hard2 = p[P_TURN2] * beyond(lateral2, TURN_FROM) + p[P_DRAG2] * bent
    lasting = 1.0 - math.exp(-2.0 * dt / TAU_TURN)
    q[TURN1] = (hard1 * speed) ** 2 * lasting
    q[TURN2] = p[P_SEEDER] * (hard2 * speed) ** 2 * lasting
    q[EX] = q[EY] = p[P_SD_E] ** 2 * slow
    q[FX] = q[FY] = p[P_SD_F] ** 2 * slow
    q[GX] = q[GY] = p[P_SD_G] ** 2 * slow
    q[BGX] = q[BGY] = q[BGZ] = p[P_BIAS_WALK] ** 2 * dt
    q[BGZ2] = p[P_SEEDER] * p[P_BIAS_WALK] ** 2 * dt
    if u[U_REST] > 0.5:
        return
    q[X] = q[Y] = POSITION_WALK**2 * dt
    gap1 = GAP_RATE * u[U_GAP1]
    q[YAW1] = p[P_GYRO1] ** 2 * dt + 0.25 * gap1 * gap1
    q[ROLL] = q[PITCH] = p[P_GYRO1] ** 2 * dt + 4.0 * gap1 * gap1
    q[V] = p[P_FORWARD] ** 2 * dt + (GAP_ACCEL * u[U_GAP1]) ** 2
    gap2 = GAP_RATE * u[U_GAP2]
    q[YAW2] = p[P_SEEDER] * (p[P_GYRO2] ** 2 * dt + 0.25 * gap2 * gap2)
    q[KAPPA] = (p[P_KAPPA_WALK] ** 2 + (p[P_KAPPA_DRIVE] * u[U_DRIVE]) ** 2) * dt


@part
def antenna_offset(
    roll: float, pitch: float, ax: float, ay: float, az: float
) -> tuple[float, float, float, float, float]:
    """Horizontal place of a point of the tilted body, Ry(pitch)·Rx(roll)·(ax, ay, az), and its derivatives.

    Returns forward, left, d left/d roll, d forward/d roll, d forward/d pitch (left does not depend on pitch).
    """
    s, c = math.sin(roll), math.cos(roll)
    st, ct = math.sin(pitch), math.cos(pitch)
    up = s * ay + c * az
    forward = ct * ax + st * up
    left = c * ay - s * az
    return forward, left, -up, st * left, ct * up - st * ax


@part
def predict_position(kind: int, x: Floats, node: Floats, ahead: float, p: Floats, H: Floats) -> float:
    """East or north of the tractor's antenna `ahead` + LAG seconds after the node; fills H."""
    north = (kind & 1) if kind < THIRD_X else kind - THIRD_X
    third = kind >= THIRD_X
    dt = ahead + x[LAG]
    wz = (node[U_WZ] - x[BGZ]) * (1.0 - x[SCALE1])
    across = x[SLIP1] + x[TURN1]
    roll_rate, pitch_rate = node[U_WX] - x[BGX], node[U_WY] - x[BGY]
    tilt = p[P_TILT]
    roll, pitch = tilt * (x[ROLL] + roll_rate * dt), tilt * (x[PITCH] + pitch_rate * dt)
    ax, ay, az = (p[P_ANT2_X], p[P_ANT2_Y], p[P_ANT2_Z]) if third else (p[P_ANT_X], p[P_ANT_Y], p[P_ANT_Z])
    fwd, left, left_roll, fwd_roll, fwd_pitch = antenna_offset(roll, pitch, ax, ay, az + p[P_SWAY])
    fwd += p[P_REAR]
    yaw = x[YAW1] + wz * dt
    middle = x[YAW1] + 0.5 * wz * dt
    # for north the same expressions hold a quarter turn back: sin(a) = cos(a - π/2)
    quarter = 0.5 * math.pi if north == 1 else 0.0
    c, s = math.cos(yaw - quarter), math.sin(yaw - quarter)
    cm, sm = math.cos(middle - quarter), math.sin(middle - quarter)
    at, slow = (Y, EY) if north == 1 else (X, EX)
    if third:
        slow = GY if north == 1 else GX
    elif kind >= FLOAT_X:
        slow = FY if north == 1 else FX
    H[:] = 0.0
    H[at], H[slow] = 1.0, 1.0
    H[YAW1] = -fwd * s - left * c - (x[V] * sm + across * cm) * dt
    H[V], H[SLIP1], H[TURN1] = cm * dt, -sm * dt, -sm * dt
    H[ROLL] = tilt * (fwd_roll * c - left_roll * s)
    H[PITCH] = tilt * fwd_pitch * c
    swing = tilt * (fwd_pitch * pitch_rate * c + (fwd_roll * c - left_roll * s) * roll_rate)
    H[LAG] = x[V] * cm - across * sm + wz * (-fwd * s - left * c) + swing
    return x[at] + x[slow] + (x[V] * cm - across * sm) * dt + fwd * c - left * s


@part
def predict_velocity(kind: int, x: Floats, node: Floats, p: Floats, H: Floats) -> float:
    """East or north velocity of the tractor's antenna at the node; fills H."""
    wz = (node[U_WZ] - x[BGZ]) * (1.0 - x[SCALE1])
    roll_rate, pitch_rate = node[U_WX] - x[BGX], node[U_WY] - x[BGY]
    tilt = p[P_TILT]
    fwd, left, left_roll, fwd_roll, fwd_pitch = antenna_offset(
        tilt * x[ROLL], tilt * x[PITCH], p[P_ANT_X], p[P_ANT_Y], p[P_ANT_Z] + p[P_SWAY]
    )
    fwd += p[P_REAR]
    quarter = 0.5 * math.pi if kind > VEL_X else 0.0
    c, s = math.cos(x[YAW1] - quarter), math.sin(x[YAW1] - quarter)
    along = x[V] - wz * left + tilt * (fwd_pitch * pitch_rate + fwd_roll * roll_rate)
    across = x[SLIP1] + x[TURN1] + wz * fwd + tilt * left_roll * roll_rate
    H[:] = 0.0
    H[YAW1] = -along * s - across * c
    H[V], H[SLIP1], H[TURN1] = c, -s, -s
    H[BGZ] = left * c + fwd * s
    H[BGX] = -tilt * (fwd_roll * c - left_roll * s)
    H[BGY] = -tilt * fwd_pitch * c
    return along * c - across * s


@part
def predict_second(kind: int, x: Floats, node: Floats, ahead: float, p: Floats, H: Floats) -> float:
    """East or north of an antenna on the seeder; fills H."""
    dt = ahead + x[LAG]
    w1 = (node[U_WZ] - x[BGZ]) * (1.0 - x[SCALE1])
    w2 = (node[U_W2] - x[BGZ2]) * (1.0 - x[SCALE2])
    fwd, left, _, _, _ = antenna_offset(
        p[P_TILT] * node[N_ROLL2],
        p[P_TILT] * node[N_PITCH2],
        p[P_ANT2_X],
        p[P_ANT2_Y],
        p[P_ANT2_Z] + p[P_SWAY2],
    )
    fwd -= p[P_COM2]
    north = kind > SECOND_X
    quarter = 0.5 * math.pi if north else 0.0
    c1, s1 = math.cos(x[YAW1] + w1 * dt - quarter), math.sin(x[YAW1] + w1 * dt - quarter)
    c2, s2 = math.cos(x[YAW2] + w2 * dt - quarter), math.sin(x[YAW2] + w2 * dt - quarter)
    at, slow = (Y, GY) if north else (X, GX)
    d = p[P_HITCH]
    H[:] = 0.0
    H[at], H[slow] = 1.0, 1.0
    across = x[SLIP1] + x[TURN1]
    H[YAW1] = d * s1 - (x[V] * s1 + across * c1) * dt
    H[YAW2] = -fwd * s2 - left * c2
    H[V], H[SLIP1], H[TURN1] = c1 * dt, -s1 * dt, -s1 * dt
    H[LAG] = x[V] * c1 - across * s1 + w1 * d * s1 - w2 * (fwd * s2 + left * c2)
    return x[at] + x[slow] + (x[V] * c1 - across * s1) * dt - d * c1 + fwd * c2 - left * s2


@part
def predict_hitch(x: Floats, node: Floats, p: Floats, H: Floats) -> float:
    """Lateral velocity at the seeder's axle less its slip: zero, for the hitch is rigid; fills H.

    The gyros' scale errors stay out: here they are less than slip, and slip that turns the seeder would pass for them.
    """
    bend = x[YAW1] - x[YAW2]
    c, s = math.cos(bend), math.sin(bend)
    w1, w2 = node[U_WZ] - x[BGZ], node[U_W2] - x[BGZ2]
    across = x[SLIP1] + x[TURN1] - p[P_HITCH] * w1
    H[:] = 0.0
    H[TURN1], H[TURN2] = c, -1.0
    H[V], H[SLIP1], H[SLIP2] = s, c, -1.0
    H[BGZ], H[BGZ2] = p[P_HITCH] * c, p[P_AXLE2]
    H[YAW1] = x[V] * c - across * s
    H[YAW2] = -H[YAW1]
    return x[V] * s + across * c - p[P_AXLE2] * w2 - x[SLIP2] - x[TURN2]


@part
def predict_lateral(x: Floats, node: Floats, H: Floats) -> float:
    """Lateral specific force at the rear axle that the motion and the tilt explain; fills H.

    f_y = a_left/cos roll + f_z tan roll with a_left = V·yaw': what is left over is vibration.
    """
    c, t = math.cos(x[ROLL]), math.tan(x[ROLL])
    wz = (node[U_WZ] - x[BGZ]) * (1.0 - x[SCALE1])
    H[:] = 0.0
    H[V], H[BGZ] = wz / c, -x[V] / c
    H[ROLL] = (GRAVITY + x[V] * wz * t * c) / (c * c)
    H[BAY] = 1.0
    return x[V] * wz / c + GRAVITY * t + x[BAY]


@njit(cache=True, error_model="numpy")
def predict(kind: int, x: Floats, node: Floats, ahead: float, p: Floats, H: Floats) -> float:
    """Expected value of one scalar measurement and its row H (SIZE,)."""
    if kind <= FLOAT_X + 1 or THIRD_X <= kind <= THIRD_X + 1:
        return predict_position(kind, x, node, ahead, p, H)
    if kind == VEL_X or kind == VEL_X + 1:
        return predict_velocity(kind, x, node, p, H)
    if kind == SECOND_X or kind == SECOND_X + 1:
        return predict_second(kind, x, node, ahead, p, H)
    if kind == HITCH:
        return predict_hitch(x, node, p, H)
    if kind == ACCEL_Y:
        return predict_lateral(x, node, H)
    H[:] = 0.0
    if kind == WHEEL:
        H[V], H[KAPPA] = 1.0 + x[KAPPA], x[V]
        return x[V] * (1.0 + x[KAPPA])
    if kind == STILL_AX:
        H[BAX], H[PITCH] = 1.0, -GRAVITY / math.cos(x[PITCH]) ** 2
        return x[BAX] - GRAVITY * math.tan(x[PITCH])
    if kind in (HEADING1, MAGNETIC1):
        H[YAW1], H[HEADING] = 1.0, 1.0
        return x[YAW1] + x[HEADING] + (node[U_WZ] - x[BGZ]) * (ahead + x[LAG])
    if kind in (HEADING2, MAGNETIC2):
        H[YAW2], H[SEEDER_HEADING] = 1.0, 1.0
        return x[YAW2] + x[SEEDER_HEADING] + (node[U_W2] - x[BGZ2]) * (ahead + x[LAG])
    state = _still(kind)
    H[state] = 1.0
    return x[state]


@part
def _still(kind: int) -> int:
    """State that a standing machine or the ground's slope shows directly."""
    if kind == STILL_V:
        return V
    if kind == STILL_SLIP:
        return SLIP1
    if kind == LEVEL_ROLL:
        return ROLL
    if kind == LEVEL_PITCH:
        return PITCH
    if kind == STILL_GX:
        return BGX
    if kind == STILL_GY:
        return BGY
    if kind == STILL_GZ:
        return BGZ
    return BGZ2
