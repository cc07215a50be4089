"""Pilot passes of a planned campaign: a twin of each, through the whole chain, down to what a forecast needs.

The pilots' true machine is the stated one: their residual is what measuring error, inputs and soil alone
make of a right model.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..model.machine import Machine, MachineError
from ..model.simulate import BatchRun
from ..sensors.ingest import read_pass
from .alignment import remaining
from .bounds import PassStatistics
from .compare import RowComparison, compare
from .fusion.fuse import fuse
from .grid import slices, stacked_simulated
from .replay import Drive, Window, drive_of, initial_states, run_windows
from .replay_settings import ReplaySettings
from .source import machine_of
from .twin import make_pass, write_raw
from .twin_plan import TwinPlan
from .uncertainty import SCALE_STEP
from .window_fit import coarse, nominal_run, trailed_run

Floats = NDArray[np.float64]

RELATIVE_STEP = 0.02  # of a parameter's value, for its finite difference
PARAMETERS = (
    "tyres.front.cornering_stiffness",
    "tyres.rear.cornering_stiffness",
    "tyres.seeder.cornering_stiffness",
    "tractor.yaw_inertia",
    "seeder.yaw_inertia",
    "seeder.hitch_to_com",
)


@dataclass(frozen=True)
class Pilot:
    """What one pilot tells: the verdict's numbers of the pass, the information (P, P) that it holds
    on the relative change of each parameter (1 = 100 %), and the score (P,) that one standard deviation of
    the steering's scale leaves, which no number of passes with the same sensor averages out."""

    statistics: PassStatistics
    information: Floats
    scale: Floats


def fly(plan: TwinPlan, seed: int, parameters: Sequence[str], settings: ReplaySettings) -> Pilot | None:
    """One pilot through the chain, its truth the stated machine; None where no row of it can be compared."""
    with tempfile.TemporaryDirectory() as folder:
        write_raw(make_pass(replace(plan, truth={}), seed), Path(folder) / "raw")
        log = read_pass(Path(folder) / "raw")
    motion, machine = fuse(log), machine_of(log)
    comparison = compare(motion, machine, log.manifest, settings)
    if comparison.statistics is None:
        return None
    lean = {n: replace(r, deviation=np.empty(0)) for n, r in comparison.statistics.responses.items()}
    statistics = replace(comparison.statistics, responses=lean)
    found, scale = _nothing(parameters), np.zeros(len(parameters))
    for row in comparison.rows:
        held, score = told(row, statistics, parameters)
        found, scale = found + held, scale + score
    return Pilot(statistics, found, scale)


def known_parameters(machine: Machine, wanted: Sequence[str]) -> tuple[str, ...]:
    """Those of the wanted parameters that the machine has and that are not zero."""
    found = []
    for name in wanted:
        try:
            value = machine.parameter(name)
        except MachineError:
            continue
        if value != 0.0:
            found.append(name)
    return tuple(found)


def _nothing(parameters: Sequence[str]) -> Floats:
    return np.zeros((len(parameters), len(parameters)))


def information(row: RowComparison, statistics: PassStatistics, parameters: Sequence[str]) -> Floats:
    """Fisher information Σ JᵀJ·n_eff/(N·M) over a row's windows and responses, on relative changes.

    J is the residual's change after the bounded alignment has answered it; M the residual's mean square
    and n_eff its independent samples, so that the residual's autocorrelation is paid for (the standard
    errors of least squares with the information scaled by n_eff/N).
    """
    return told(row, statistics, parameters)[0]


def told(row: RowComparison, statistics: PassStatistics, parameters: Sequence[str]) -> tuple[Floats, Floats]:
    """`information` of a row (P, P), and the score (P,) of one standard deviation of the steering's scale."""
    total, score = _nothing(parameters), np.zeros(len(parameters))
    sensitivity = [changes(row, name) for name in parameters]
    scaled = scale_changes(row)
    for i, fit in enumerate(row.fits):
        slopes = np.column_stack([change[i] for change in sensitivity])
        for name, place in slices(fit.parts):
            response = statistics.responses[name]
            points = max(int(row.valid[name].sum()), 1)
            weight = response.n_eff / (points * max(response.mse, 1e-300))
            part = slopes[place][fit.valid[place]]
            total += weight * part.T @ part
            score += weight * part.T @ scaled[i][place][fit.valid[place]]
    return np.asarray(total), score


def scale_changes(row: RowComparison) -> list[Floats]:
    """Each window's residual change (N,) for one standard deviation of the steering's scale, after alignment."""
    steer = row.context.motion.steer_input
    if steer is None or row.context.trailed:
        return [np.zeros(fit.start.size) for fit in row.fits]
    drive, windows = _drive_and_windows(row)
    initial = initial_states(row.context.motion, windows)
    more = run_windows(
        row.context.machine, drive, row.context.motion, windows, initial, steer_scale=1.0 + SCALE_STEP
    )
    left = _left(row, more, nominal_run(row.context, drive, windows))
    return [one * steer.scale_sd / SCALE_STEP for one in left]


def changes(row: RowComparison, name: str) -> list[Floats]:
    """Each window's residual change (N,) for a relative change of 1 of a parameter, after alignment."""
    context = row.context
    value = context.machine.parameter(name)
    machine = context.machine.replace_parameters({name: value * (1.0 + RELATIVE_STEP)})
    drive, windows = _drive_and_windows(row)
    if context.trailed:
        run = trailed_run(context, drive, windows, machine)
    else:
        run = run_windows(machine, drive, context.motion, windows, initial_states(context.motion, windows))
    return [one / RELATIVE_STEP for one in _left(row, run, nominal_run(context, drive, windows))]


def _drive_and_windows(row: RowComparison) -> tuple[Drive, list[Window]]:
    drive = coarse(drive_of(row.context.motion, row.row, row.context.settings))
    return drive, [fit.window for fit in row.fits]


def _left(row: RowComparison, moved: BatchRun, nominal: BatchRun) -> list[Floats]:
    """What of the change between two runs each window's alignment leaves, (N,)."""
    found = []
    for i, fit in enumerate(row.fits):
        change = stacked_simulated(fit.parts, row.row, moved, i) - stacked_simulated(
            fit.parts, row.row, nominal, i
        )
        found.append(np.asarray(remaining(fit.alignment, fit.sensitivity, change[:, None])[:, 0]))
    return found
