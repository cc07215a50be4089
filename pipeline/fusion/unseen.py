"""Constant errors that no sensor on the machine sees and no state of the filter holds: lever arms, mounting, crab.

Each cause is one mode of the motion of both bodies: what moves both, such as a slope that is steeper than it was taken
to be, moves them together, in the covariances as in the draws.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from ...sensors.manifest import GRAVITY, Machine
from . import settings as physics
from . import state as s
from .engine_compiled import Smoothed
from .known import Known
from .output import K_ROLL, Smooth, Unseen
from .prepare import STEP
from .problem import Problem, compliances
from .settings import Levels

Floats = NDArray[np.float64]

SLOPE_WINDOW = 750  # nodes, 15 s: the slope of the ground, and not rocking, is what loads tyres for long


@dataclass(frozen=True)
class Doubt:
    """Standard deviations of what is not seen.

    place : m, of a constant error of place, along either axis of the tractor
    slope : rad, of the cross slope; steep : rad, of it by the field's unknown steepness, as far as no turn tells
    crab : rad, of a crab that stays all along a row, of the tractor and of the seeder
    pull : rad/rad, crab of both by the cross slope
    """

    place: float = physics.LEVER_SD
    slope: float = 0.0
    steep: float = 0.0
    crab: tuple[float, float] = (0.0, 0.0)
    pull: tuple[float, float] = (0.0, 0.0)


def doubt_of(known: Known, task: Problem, levels: Levels, smooth: Smoothed) -> Doubt:
    """What is not seen in a pass whose last sweep is given."""
    machine = known.log.manifest.machine
    roll = float(np.median(smooth.P[:, K_ROLL, K_ROLL]))
    across, steep = slope_variances(known, roll)
    return Doubt(
        place_doubt(task.parameters, ground_variance(task), roll), math.sqrt(across + steep), math.sqrt(steep),
        constant_crab(machine, levels), slope_pull(machine),
    )  # fmt: skip


def modes_of(at: Smooth, p: Floats, doubt: Doubt, slope: Floats) -> Unseen:
    """The modes of what is not seen, at instants of the smoothed state; slope : (N,) rad, of the ground across the
    path.

    The cross slope is the tractor's roll, but for what it rocks. So what the state does not know of the roll is a crab
    too: uphill by `pull`, as all of the known slope is, which is stated and not corrected, for tyres differ.
    """
    c, sn, none = np.cos(at.x[:, s.YAW1]), np.sin(at.x[:, s.YAW1]), np.zeros(slope.size)
    ahead, left = np.column_stack([c, sn, none]), np.column_stack([-sn, c, none])
    first, second = crabbing(at, p)
    pulled = doubt.pull[0] * first + doubt.pull[1] * second
    height = p[s.P_ANT_Z] + p[s.P_SWAY]
    both = [doubt.place * ahead, doubt.place * left, doubt.steep * height * left]
    modes = [np.stack([mode, mode]) for mode in both]
    modes[2] += doubt.steep * pulled
    modes += [slope[:, None] * pulled, doubt.crab[0] * first, doubt.crab[1] * second]
    tractor, seeder = (np.stack([mode[body] for mode in modes], axis=1) for body in (0, 1))
    return Unseen(tractor, seeder, pulled[0], pulled[1])


def crabbing(at: Smooth, p: Floats) -> tuple[Floats, Floats]:
    """d(x, y, yaw) of both bodies, (2, N, 3), by a constant error of the tractor's yaw, and of the seeder's.

    The antenna stands over the tractor's CoM; what hangs behind it swings.
    """
    found = []
    for lever, yaw, turned in (
        (p[s.P_REAR] + p[s.P_HITCH], at.x[:, s.YAW1], 0), (p[s.P_COM2], at.x[:, s.YAW2], 1)
    ):  # fmt: skip
        moved = np.zeros((2, yaw.size, 3))
        moved[1, :, 0], moved[1, :, 1] = lever * np.sin(yaw), -lever * np.cos(yaw)
        moved[turned, :, 2] = 1.0
        found.append(moved)
    return found[0], found[1]


def ground_variance(task: Problem) -> float:
    """Variance (rad²) of the mean roll that all readings of the ground's slope and the accelerometer's bias, as it is
    known beforehand, give together: what is known of it without turning."""
    level = task.measurements.var[task.measurements.kind == s.LEVEL_ROLL]
    ground = level.size / float(np.median(level)) if level.size else 0.0
    return 1.0 / (ground + GRAVITY**2 / float(task.P0[s.BAY, s.BAY]))


def slope_variances(known: Known, roll: float) -> tuple[float, float]:
    """Variances (rad²) of the cross slope, mean along the path: by the readings of it, and by the doubt of how steep
    the field is.

    roll : rad², variance of the tractor's roll as smoothed. Where the filter knows it better than the readings without
    turning do, the slope is known as well; and what a wrong prior moves it by shrinks as the variance does.
    """
    left = np.column_stack([-np.sin(known.yaw[0]), np.cos(known.yaw[0])])
    across, steep = (
        float(np.mean(np.einsum("ni,ij,nj->n", left, C, left)))
        for C in (known.slope.known, known.slope.doubt)
    )
    better = min(roll / across, 1.0)
    return better * across, better**2 * steep


def constant_crab(machine: Machine, levels: Levels) -> tuple[float, float]:
    """Standard deviations (rad) of a crab angle that stays all along a row, of the tractor and of the seeder.

    No sensor on a machine that crabs can see it. A share of the slip angles' own deviation, and as much as the
    manifest's draft, where it pulls aside, would make by the stated tyres: draft is known to no better.
    """
    crab = physics.CRAB * np.array([levels.beta1, levels.beta2])
    if machine.seeder is not None and machine.tyres.seeder is not None:
        tractor, seeder = machine.tractor, machine.seeder
        aside = seeder.draft * abs(math.sin(math.radians(seeder.draft_angle_deg)))
        axle = seeder.hitch_to_com + float(np.mean(seeder.axles))
        at_axle = aside * seeder.hitch_to_com / axle
        lever = (tractor.front_axle + tractor.hitch) / (tractor.front_axle + tractor.rear_axle)
        at_rear = abs(aside - at_axle) * lever
        stiffness = np.array(
            [machine.tyres.rear.cornering_stiffness, machine.tyres.seeder.cornering_stiffness]
        )
        wheels = np.array([2.0, 2.0 * len(seeder.axles)])
        crab = np.hypot(crab, np.array([at_rear, at_axle]) / (wheels * stiffness))
    return float(crab[0]), float(crab[1])


def slope_pull(machine: Machine) -> tuple[float, float]:
    """Crab (rad/rad) by the ground's cross slope, of tractor and seeder, with tyres as soft as `compliances`: under the
    weight's part along the ground both turn uphill."""
    tractor, seeder = compliances(machine)
    return GRAVITY * tractor, GRAVITY * seeder


def cross_slope(smooth: Smoothed) -> Floats:
    """Cross slope (N,) of the ground along the path, rad.

    The tractor's tilt in the world's axes (a turn leaves it as it is), mean over SLOPE_WINDOW. Of rolling on rough
    ground a part is left in such a mean, by ROUGH_TIME of it; the slopes are as large as the means are beyond that.
    What rough ground pulls aside is slip of the level that the innovations tell, and is not counted here again.
    """
    roll, pitch, yaw = smooth.x[:, s.ROLL], smooth.x[:, s.PITCH], smooth.x[:, s.YAW1]
    size, c, sn = min(SLOPE_WINDOW, yaw.size), np.cos(yaw), np.sin(yaw)
    east = uniform_filter1d(-sn * roll - c * pitch, size, mode="nearest")
    north = uniform_filter1d(c * roll - sn * pitch, size, mode="nearest")
    mean = c * north - sn * east
    rocking = float(np.var(roll - mean)) * 2.0 * physics.ROUGH_TIME / (size * STEP)
    share = max(1.0 - rocking / max(float(np.mean(mean**2)), 1e-12), 0.0)
    return np.asarray(share * mean)


def place_doubt(p: Floats, level: float, roll: float) -> float:
    """Constant doubt of place, m: lever arms by tape, and the unit's mounting where its gyros tell the tilt.

    On a straight row the ground's slope tells the body's mean roll and the mounting is lost in the accelerometer's
    bias. A turn shows the gyros where the vertical is, but against the unit, not the body.

    level, roll : variances (rad²) of the mean roll without turning, and as smoothed
    """
    height = p[s.P_ANT_Z] + p[s.P_SWAY]
    without = min(roll / max(level, 1e-12), 1.0)
    return math.hypot(physics.LEVER_SD, (1.0 - without) * physics.MOUNT_SD * height)
