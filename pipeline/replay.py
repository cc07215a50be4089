"""Replay: the model driven by a pass's measured steering and speed, in windows that start from the smoother.

Nothing else of the measured motion drives it: in a window the state starts from the smoothed motion,
then only
`Motion.steer_input` and the measured speed act. Without a steering series that is independent of the
body's motion,
the measured tractor's motion is imposed and only the seeder is simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.inputs import Controls
from ..model.machine import Machine
from ..model.settings import SimulationSettings
from ..model.simulate import BatchRun, initial_state, simulate_batch
from .fusion.motion import Motion, SteerInput
from .replay_settings import ReplaySettings
from .rows import Row

Floats = NDArray[np.float64]

X, Y, YAW, V, V_LATERAL, YAW_RATE = range(6)  # order of BodyMotion.covariance
SHORTEST_WINDOW = 0.2  # of the horizon: a shorter remainder of the row joins its last window
LEAST_SD = (1e-3, 1.7e-4, 1.7e-4)  # m, rad, rad (0.01°): no prior is sharper than this
OVERRUN = 1.0  # s that a window's run goes on, so that a slower simulation still covers the chainages


@dataclass(frozen=True)
class Window:
    """One window of a row: samples start to stop (excluded) of the motion's grid; origin m, the chainage
    there."""

    index: int
    start: int
    stop: int
    origin: float


@dataclass(frozen=True)
class Drive:
    """What drives the runs of one row: controls in s since t0 (UTC), and the sampling of the runs."""

    t0: float
    controls: Controls
    spacing: float
    settings: SimulationSettings


def cut_windows(motion: Motion, row: Row, horizon: float) -> tuple[Window, ...]:
    """Consecutive windows of `horizon` m of the tractor's chainage; a remainder under a fifth joins the
    last."""
    s, _ = row.line.project(motion.tractor.x[row.samples], motion.tractor.y[row.samples])
    s = np.maximum.accumulate(s)
    length = float(s[-1] - s[0])
    count = 1 if not np.isfinite(horizon) else max(1, int(np.ceil(length / horizon - SHORTEST_WINDOW)))
    inner = s[0] + horizon * np.arange(1, count) if count > 1 else np.empty(0)
    edges = [0, *np.searchsorted(s, inner).tolist(), s.size]
    return tuple(
        Window(i, row.start + a, row.start + b, float(s[a])) for i, (a, b) in enumerate(pairwise(edges))
    )


def drive_of(motion: Motion, row: Row, settings: ReplaySettings, steering: Floats | None = None) -> Drive:
    """Measured steering and speed over a row and what follows it for `OVERRUN`.

    steering : (rows, N) rad on the motion's grid in place of the measured series, for Monte Carlo
    """
    part = driven_samples(motion, row)
    if steering is None:
        steering = np.zeros(motion.t.size) if motion.steer_input is None else motion.steer_input.angle
    t0 = float(motion.t[row.start])
    held = np.atleast_2d(steering)[:, part]
    # A series may end with the row: what lies beyond is held, as only the windows' overrun needs it.
    last = held[:, [row.stop - 1 - row.start]]
    held = np.where(np.isfinite(held), held, last)
    controls = Controls(t=motion.t[part] - t0, speed=motion.tractor.v[part], steer=held)
    return Drive(t0, controls, settings.spacing, settings.simulation)


def driven_samples(motion: Motion, row: Row) -> slice:
    """The row's samples and those of the overrun behind it."""
    step = float(np.median(np.diff(motion.t)))
    return slice(row.start, min(row.stop + round(OVERRUN / step) + 1, motion.t.size))


def initial_states(
    motion: Motion, windows: Sequence[Window], turn: Floats | float = 0.0, sideways: float = 0.0
) -> Floats:
    """(W, 8) smoothed states at the windows' starts, turned by `turn` rad about the tractor's CoM.

    sideways : m/s added to the tractor's lateral speed
    """
    at = [w.start for w in windows]
    one, two = motion.tractor, motion.seeder
    yaw2 = None if two is None else two.yaw[at] + turn
    rate2 = 0.0 if two is None else two.yaw_rate[at]
    return initial_state(
        one.x[at],
        one.y[at],
        one.yaw[at] + turn,
        yaw2,
        one.v[at],
        one.v_lateral[at] + sideways,
        one.yaw_rate[at],
        rate2,
    )


def shifted(motion: Motion, windows: Sequence[Window], row: Row, offset: Floats, turn: Floats) -> Floats:
    """(W, 8) initial states moved `offset` m to the line's left and turned by `turn` rad about the
    tractor."""
    states = initial_states(motion, windows, turn)
    states[:, 0] -= offset * np.sin(row.line.heading)
    states[:, 1] += offset * np.cos(row.line.heading)
    return states


def run_windows(
    machines: Machine | Sequence[Machine],
    drive: Drive,
    motion: Motion,
    windows: Sequence[Window],
    initial: Floats,
    **changes: Any,
) -> BatchRun:
    """Every window's run in one batch; `changes` are `simulate_batch`'s, one value a run."""
    longest = max(w.stop - w.start for w in windows) * float(np.median(np.diff(motion.t)))
    samples = int(np.ceil((longest + OVERRUN) / drive.spacing)) + 1
    start = np.array([motion.t[w.start] for w in windows]) - drive.t0
    return simulate_batch(
        machines,
        drive.controls,
        initial,
        samples,
        drive.spacing,
        start=start,
        settings=drive.settings,
        **changes,
    )


def steering_prior_variance(steer: SteerInput, settings: ReplaySettings) -> float:
    """Variance in rad² of slow steering error: the stated one, and that of the constant zero.

    A series whose stated error is white (no correlation time) says nothing of slow error and gets the
    default,
    (0.2°)².
    """
    slow = float(np.mean(steer.sd**2)) if steer.correlation_time > 0.0 else settings.slow_steer_sd**2
    return slow + steer.zero_sd**2


def window_prior(motion: Motion, window: Window, row: Row, settings: ReplaySettings) -> Floats:
    """P₀ of (lateral offset m, heading rad, steering offset rad); the last only with a steering series.

    The smoother's covariance at the window's start, turned to the row's line, beside the steering's variance.
    """
    covariance = motion.tractor.covariance[window.start]
    sin, cos = np.sin(row.line.heading), np.cos(row.line.heading)
    across = np.zeros((2, 6))
    across[0, X], across[0, Y], across[1, YAW] = -sin, cos, 1.0
    pose = across @ covariance @ across.T + np.diag(np.square(LEAST_SD[:2]))
    if motion.steer_input is None:
        return np.asarray(pose)
    prior = np.zeros((3, 3))
    prior[:2, :2] = pose
    prior[2, 2] = steering_prior_variance(motion.steer_input, settings) + LEAST_SD[2] ** 2
    return prior
