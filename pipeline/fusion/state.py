"""Names of the joint state of tractor and seeder, of the kernels' parameter vector and input columns.

The tractor is followed at the centre of its rear axle, at ground level, where the lateral velocity is side slip
alone; its centre of mass follows from geometry. The rigid hitch is part of the parametrisation: the seeder
adds its yaw only. Slips are first-order Gauss-Markov states, and so are the slow errors of the receivers.
"""

from __future__ import annotations

from typing import Final

# State vector -------------------------------------------------------------------------------------------------
X: Final = 0  # m, East, centre of the tractor's rear axle
Y: Final = 1  # m, North
YAW1: Final = 2  # rad
V: Final = 3  # m/s, forward
SLIP1: Final = 4  # m/s, lateral (left) at the rear axle, fast part
ROLL: Final = 5  # rad, tractor
PITCH: Final = 6  # rad, tractor
BGX: Final = 7  # rad/s, tractor's gyro biases, body axes
BGY: Final = 8
BGZ: Final = 9
BAX: Final = 10  # m/s², tractor's accelerometer biases, body axes
BAY: Final = 11
YAW2: Final = 12  # rad
BGZ2: Final = 13  # rad/s, seeder's vertical gyro bias
SLIP2: Final = 14  # m/s, lateral at the seeder's (mean) axle
EX: Final = 15  # m, slow error of fixed GNSS positions
EY: Final = 16
LAG: Final = 17  # s, inertial time less UTC
KAPPA: Final = 18  # 1, wheel speed over true speed, less one
SCALE1: Final = 19  # 1, scale error of the tractor's vertical gyro
SCALE2: Final = 20  # 1, of the seeder's
TURN1: Final = 21  # m/s, slow lateral velocity at the rear axle while turning hard
TURN2: Final = 22  # m/s, the same at the seeder's axle
# From here on only passes that need them carry them: products stop at P_ACTIVE.
ALWAYS: Final = 23
HEADING: Final = 23  # rad, constant error of a heading on the tractor (dual antenna, magnetometer)
SEEDER_HEADING: Final = 24  # rad, the same on the seeder
FX: Final = 25  # m, slow error of positions that are not fixed (float, DGPS, single)
FY: Final = 26
GX: Final = 27  # m, slow error of a second receiver
GY: Final = 28
SIZE: Final = 29

# Of the smoothed covariance these rows and columns are kept: all that the bodies' motion needs.
KEPT: Final = (X, Y, YAW1, V, SLIP1, ROLL, PITCH, YAW2, BGZ, BGZ2, LAG, TURN1)

# Parameter vector -----------------------------------------------------------------------------------------------
P_REAR: Final = 0  # m, rear axle behind the CoM
P_ANT_X: Final = 1  # m, antenna from the CoM, body axes
P_ANT_Y: Final = 2
P_ANT_Z: Final = 3
P_SWAY: Final = 4  # m, CoM above the roll centre
P_HITCH: Final = 5  # m, hitch behind the rear axle
P_AXLE2: Final = 6  # m, hitch to the seeder's axle
P_COM2: Final = 7  # m, hitch to the seeder's CoM (l5)
P_TAU_SLIP: Final = 8  # s
P_BETA1: Final = 9  # rad, standard deviation of the slip angle at the rear axle
P_BETA2: Final = 10  # rad, at the seeder's axle
P_COMPLIANCE: Final = 11  # rad/(m/s²), slip angle a lateral acceleration may cause
P_TAU_E: Final = 12  # s, of slow GNSS errors
P_SD_E: Final = 13  # m, slow error of fixed positions
P_SD_F: Final = 14  # m, of positions that are not fixed
P_SD_G: Final = 15  # m, of the second receiver
P_GYRO1: Final = 16  # rad/s/sqrt(Hz)
P_GYRO2: Final = 17
P_ACCEL: Final = 18  # m/s²/sqrt(Hz)
P_KAPPA_WALK: Final = 19  # 1/sqrt(s), walk of the wheels' scale: slip follows soil and draft
P_KAPPA_DRIVE: Final = 20  # 1/sqrt(s) per m/s² of acceleration: slip follows traction
P_ANT2_X: Final = 21  # m, second antenna from its body's CoM
P_ANT2_Y: Final = 22
P_ANT2_Z: Final = 23
P_FORWARD: Final = 29  # m/s²/sqrt(Hz), noise of the forward acceleration
P_TURN: Final = 28  # rad/(m/s²), slow slip angle of a turn by lateral acceleration, rear axle
P_BIAS_WALK: Final = 24  # rad/s/sqrt(s), of gyro biases
P_SEEDER: Final = 25  # 1 when there is a seeder
P_TILT: Final = 26  # 1: antenna's sway is compensated by roll and pitch; 0 only to show what that is worth
P_SWAY2: Final = 27  # m, seeder's CoM above its roll centre
P_ACTIVE: Final = 30  # number of leading state components in use, ALWAYS to SIZE
P_TURN2: Final = 31  # rad/(m/s²), the same at the seeder's axle
P_DRAG2: Final = 32  # rad/rad, slow slip angle there by draft, by articulation
P_SIZE: Final = 33

# Inputs of a step from node k to k + 1 (means over the step), body axes at the rear axle -----------------------
U_WX: Final = 0  # rad/s
U_WY: Final = 1
U_WZ: Final = 2
U_FX: Final = 3  # m/s², specific force moved to the rear axle
U_FY: Final = 4
U_W2: Final = 5  # rad/s, seeder's yaw rate, tilt already resolved
U_REST: Final = 6  # 1 while the machine stands
U_GAP1: Final = 7  # s, longest hole in the tractor's samples inside the step beyond one nominal period
U_GAP2: Final = 8  # s, the same of the seeder
U_DRIVE: Final = 9  # m/s², size of the acceleration by the wheels
U_SIZE: Final = 10
# At the nodes themselves (means over half a step to either side): the same columns U_WX ... U_W2, then
N_ROLL2: Final = 6  # rad, seeder's tilt
N_PITCH2: Final = 7
N_SIZE: Final = 8

# Kinds of scalar measurements; position and velocity come in pairs, east first ---------------------------------
FIXED_X: Final = 0
FIXED_Y: Final = 1
FLOAT_X: Final = 2
FLOAT_Y: Final = 3
VEL_X: Final = 4
VEL_Y: Final = 5
SECOND_X: Final = 6  # second receiver on the seeder
SECOND_Y: Final = 7
ACCEL_Y: Final = 8  # lateral specific force: the tractor's tilt
HITCH: Final = 9  # the seeder's axle slips sideways only by SLIP2
WHEEL: Final = 10
STILL_V: Final = 11
STILL_SLIP: Final = 12
STILL_GX: Final = 13
STILL_GY: Final = 14
STILL_GZ: Final = 15
STILL_GZ2: Final = 16
STILL_AX: Final = 17
HEADING1: Final = 18
THIRD_X: Final = 19  # second receiver on the tractor
THIRD_Y: Final = 20
HEADING2: Final = 21
LEVEL_ROLL: Final = 22  # the ground's own slope, by the receiver's altitudes and a flat prior
LEVEL_PITCH: Final = 23
MAGNETIC1: Final = 24  # magnetic azimuth of the tractor, with a free constant
MAGNETIC2: Final = 25
KINDS: Final = 26
PAIRED: Final = (FIXED_X, FLOAT_X, VEL_X, SECOND_X, THIRD_X)
