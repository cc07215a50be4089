"""What measuring error, inputs and parameters leave in the residual, by linearised sensitivities and draws.

The residual's response to each source is one run more a window (a finite difference); draws of the
sources are
then sums of such responses. Tests hold this against full simulations of the same draws.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.inputs import coloured_noise
from ..model.machine import Machine, MachineError
from ..model.simulate import BatchRun
from . import grid as on_grid
from .fusion.motion import Motion, SteerInput
from .replay import V_LATERAL, YAW, YAW_RATE, Drive, V, Window, drive_of, run_windows, shifted
from .window_fit import HEADING, OFFSET, STEER, Context, WindowFit, coarse, trailed_run

Floats = NDArray[np.float64]

STEERING, START, PARAMETERS = "steering", "start", "parameters"
GROUPS = (STEERING, START, PARAMETERS)
KNOT_SPACING = 1.0  # s between the knots of the steering error
STEER_STEP = float(np.deg2rad(0.2))
SCALE_STEP = 0.02
YAW_STEP, RATE_STEP, SPEED_STEP = 0.005, 0.005, 0.02  # rad, rad/s, m/s
STATE_YAW1, STATE_YAW2, STATE_VX1, STATE_VY1, STATE_W1, STATE_W2 = 2, 3, 4, 5, 6, 7  # of the model's state


@dataclass(frozen=True)
class Base:
    """The runs about which a row's responses are linear: where each window's alignment took its sensitivity.

    initial : (W, 8) their states at the start; offset : (W,) rad added to the steering
    """

    context: Context
    drive: Drive
    windows: tuple[Window, ...]
    initial: Floats
    offset: Floats

    def run(self, machine: Machine | None = None, change: Floats | float = 0.0, **changes: Any) -> BatchRun:
        """Every window's run with another machine, a changed start, or `run_windows`' changes."""
        given = {"steer_offset": self.offset} | changes
        machine = self.context.machine if machine is None else machine
        motion = self.context.motion
        return run_windows(machine, self.drive, motion, self.windows, self.initial + change, **given)

    def trailed(self, machine: Machine | None = None, **changes: float) -> BatchRun:
        """The same of the seeder alone behind the measured tractor."""
        machine = self.context.machine if machine is None else machine
        return trailed_run(self.context, self.drive, self.windows, machine, **changes)


def base_of(context: Context, fits: Sequence[WindowFit]) -> Base:
    """The coarse runs about which the windows' responses are taken."""
    windows, row = tuple(f.window for f in fits), context.grid.row
    about = np.stack([f.about for f in fits])
    initial = shifted(context.motion, windows, row, about[:, OFFSET], about[:, HEADING])
    offset = np.zeros(len(windows)) if context.trailed else about[:, STEER]
    return Base(context, coarse(drive_of(context.motion, row, context.settings)), windows, initial, offset)


@dataclass(frozen=True)
class Source:
    """One uncertain quantity: the runs with it changed by one step, and draws of it in steps.

    draws : (D,) where all windows share the quantity, (W, D) where each has its own
    """

    group: str
    run: BatchRun
    draws: Floats


def measuring_changes(context: Context, fit: WindowFit) -> Floats:
    """(N, K) draws of the residual's change by measuring error, before alignment.

    The measured values carry the error itself. The run starts from the same smoothed state, so it carries the
    error of the start's offset and heading as a rigid motion: a constant error cancels.
    """
    motion, row = context.motion, context.grid.row
    error = on_grid.stacked_draws(fit.parts, row, motion)
    at = on_grid.draws_at(motion, motion.t[fit.window.start : fit.window.start + 1])[:, 0]
    offset, heading = on_grid.across_line(at, row.line.heading), at[:, YAW]
    moved = np.outer(fit.sensitivity[:, OFFSET], offset) + np.outer(fit.sensitivity[:, HEADING], heading)
    return np.asarray(moved - error)


def input_changes(
    context: Context, fits: Sequence[WindowFit], parameters: Mapping[str, float], seed: int
) -> list[dict[str, Floats]]:
    """Each window's draws (N, D) of the residual's change by inputs, before alignment, by group.

    parameters : standard deviations by dotted name, SI, as the manifest states them
    """
    row, base = context.grid.row, base_of(context, fits)
    nominal = base.trailed() if context.trailed else base.run()
    plain = [on_grid.stacked_simulated(f.parts, row, nominal, i) for i, f in enumerate(fits)]
    found = [{g: np.zeros((f.start.size, context.settings.draws)) for g in GROUPS} for f in fits]
    for source in _sources(base, parameters, np.random.default_rng(seed)):
        for i, fit in enumerate(fits):
            change = on_grid.stacked_simulated(fit.parts, row, source.run, i) - plain[i]
            draws = source.draws if source.draws.ndim == 1 else source.draws[i]
            found[i][source.group] += np.outer(change, draws)
    return found


def _sources(base: Base, parameters: Mapping[str, float], generator: np.random.Generator) -> Iterator[Source]:
    yield from _parameter_sources(base, parameters, generator)
    if base.context.trailed:
        yield from _trailed_start_sources(base, generator)
        return
    yield from _start_sources(base, generator)
    if base.context.motion.steer_input is not None:
        yield from _constant_steering_sources(base, generator)
        yield from _slow_steering_sources(base, generator)


def _parameter_sources(
    base: Base, parameters: Mapping[str, float], generator: np.random.Generator
) -> Iterator[Source]:
    """One standard deviation of each stated parameter, shared by all windows."""
    for name, sd in parameters.items():
        draws = generator.standard_normal(base.context.settings.draws)
        machine = machine_changed(base.context.machine, name, sd)
        if machine is None:
            continue
        run = base.trailed(machine) if base.context.trailed else base.run(machine)
        yield Source(PARAMETERS, run, draws)


def machine_changed(machine: Machine, name: str, sd: float) -> Machine | None:
    """The machine with one parameter a standard deviation larger; None for one that the planar model lacks.

    `seeder.com_to_axle` and other lists move as a whole.
    """
    try:
        value = machine.parameter(name)
        return machine.replace_parameters({name: value + sd})
    except MachineError:
        return None


def _trailed_start_sources(base: Base, generator: np.random.Generator) -> Iterator[Source]:
    motion, own = base.context.motion, _own_draws(base, generator)
    yaw = base.trailed(yaw=YAW_STEP)
    yield Source(START, yaw, next(own) * start_sds(motion, base.windows, 2, YAW) / YAW_STEP)
    rate = base.trailed(rate=RATE_STEP)
    yield Source(START, rate, next(own) * start_sds(motion, base.windows, 2, YAW_RATE) / RATE_STEP)


def _start_sources(base: Base, generator: np.random.Generator) -> Iterator[Source]:
    """The start's lateral speed, yaw rates and the seeder's yaw (offset and heading belong to measuring
    error),
    and the measured speed."""
    motion, own = base.context.motion, _own_draws(base, generator)
    changes = [
        (_sideways(base.initial), 1, V_LATERAL, RATE_STEP),
        (_step(base.initial, STATE_W1), 1, YAW_RATE, RATE_STEP),
    ]
    if motion.seeder is not None:
        changes.append((_step(base.initial, STATE_YAW2), 2, YAW, RATE_STEP))
        changes.append((_step(base.initial, STATE_W2), 2, YAW_RATE, RATE_STEP))
    for change, body, component, step in changes:
        yield Source(
            START,
            base.run(change=change),
            next(own) * start_sds(motion, base.windows, body, component) / step,
        )
    run = base.run(speed_offset=SPEED_STEP)
    yield Source(START, run, next(own) * start_sds(motion, base.windows, 1, V) / SPEED_STEP)


def _sideways(initial: Floats) -> Floats:
    """The change of the states by a step of the tractor's lateral speed."""
    change, yaw = np.zeros_like(initial), initial[:, STATE_YAW1]
    change[:, STATE_VX1], change[:, STATE_VY1] = -RATE_STEP * np.sin(yaw), RATE_STEP * np.cos(yaw)
    return change


def _step(initial: Floats, column: int) -> Floats:
    change = np.zeros_like(initial)
    change[:, column] = RATE_STEP
    return change


def start_sds(motion: Motion, windows: Sequence[Window], body: int, component: int) -> Floats:
    """(W, 1) standard deviations of one component of a body's state at the windows' starts."""
    return motion.bodies[body - 1].sd(component)[[w.start for w in windows], np.newaxis]


def _own_draws(base: Base, generator: np.random.Generator) -> Iterator[Floats]:
    while True:
        yield generator.standard_normal((len(base.windows), base.context.settings.draws))


def _constant_steering_sources(base: Base, generator: np.random.Generator) -> Iterator[Source]:
    """Zero and scale of the steering, constant over the row."""
    steer, count = _steer(base.context.motion), base.context.settings.draws
    zero = base.run(steer_offset=base.offset + STEER_STEP)
    yield Source(STEERING, zero, generator.standard_normal(count) * steer.zero_sd / STEER_STEP)
    scale = base.run(steer_scale=1.0 + SCALE_STEP)
    yield Source(STEERING, scale, generator.standard_normal(count) * steer.scale_sd / SCALE_STEP)


def _slow_steering_sources(base: Base, generator: np.random.Generator) -> Iterator[Source]:
    """The steering's changing error, as hats at knots each second of a window: batch k moves every
    window's knot k."""
    context, windows = base.context, base.windows
    motion, steer = context.motion, _steer(context.motion)
    longest = max(motion.t[w.stop - 1] - motion.t[w.start] for w in windows)
    knots = int(np.ceil(longest / KNOT_SPACING)) + 1
    white = float(np.median(np.diff(motion.t)))
    own = np.stack([knot_draws(steer, knots, white, context.settings.draws, generator) for _ in windows])
    sd = np.array([float(np.mean(steer.sd[w.start : w.stop])) for w in windows])
    for k in range(knots):
        centres = [motion.t[w.start] + k * KNOT_SPACING for w in windows]
        hats = np.stack([np.maximum(1.0 - np.abs(motion.t - c) / KNOT_SPACING, 0.0) for c in centres])
        table = drive_of(motion, context.grid.row, context.settings, steer.angle + STEER_STEP * hats)
        run = replace(base, drive=coarse(table)).run(steer_row=np.arange(len(windows)))
        yield Source(STEERING, run, own[:, k] * sd[:, np.newaxis] / STEER_STEP)


def knot_draws(
    steer: SteerInput, knots: int, sample: float, count: int, generator: np.random.Generator
) -> Floats:
    """(knots, count) unit draws of the steering error at the knots.

    A correlation time over the knots' spacing Δ: Gauss–Markov. A shorter one (a white error counts as
    half a sample
    long): independent knots of variance 2τ/Δ, which keeps the error's density at low frequency.
    """
    tau = max(steer.correlation_time, 0.5 * sample)
    if 2.0 * tau > KNOT_SPACING:
        return np.stack(
            [coloured_noise(generator, knots, KNOT_SPACING, 1.0, tau) for _ in range(count)], axis=1
        )
    return np.asarray(np.sqrt(2.0 * tau / KNOT_SPACING) * generator.standard_normal((knots, count)))


def _steer(motion: Motion) -> SteerInput:
    if motion.steer_input is None:
        raise ValueError("this motion has no independent steering series")
    return motion.steer_input
