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
from ..sensors.ingest import read_pass
from .alignment import remaining
from .bounds import PassStatistics
from .compare import RowComparison, compare
from .fusion.fuse import fuse
from .grid import slices, stacked_simulated
from .replay import drive_of, initial_states, run_windows
from .replay_settings import ReplaySettings
from .run import machine_of
from .twin import make_pass, write_raw
from .twin_plan import TwinPlan
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
    """What one pilot tells: the verdict's numbers of the pass, and the information (P, P) that it holds
    on the relative change of each parameter (1 = 100 %)."""

    statistics: PassStatistics
    information: Floats


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
    found = sum((information(row, statistics, parameters) for row in comparison.rows), _nothing(parameters))
    return Pilot(statistics, found)


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
    total = _nothing(parameters)
    sensitivity = [changes(row, name) for name in parameters]
    for i, fit in enumerate(row.fits):
        slopes = np.column_stack([change[i] for change in sensitivity])
        for name, place in slices(fit.parts):
            response = statistics.responses[name]
            points = max(int(row.valid[name].sum()), 1)
            weight = response.n_eff / (points * max(response.mse, 1e-300))
            part = slopes[place][fit.valid[place]]
            total += weight * part.T @ part
    return np.asarray(total)


def changes(row: RowComparison, name: str) -> list[Floats]:
    """Each window's residual change (N,) for a relative change of 1 of a parameter, after alignment."""
    context = row.context
    value = context.machine.parameter(name)
    machine = context.machine.replace_parameters({name: value * (1.0 + RELATIVE_STEP)})
    windows = [fit.window for fit in row.fits]
    drive = coarse(drive_of(context.motion, row.row, context.settings))
    base = nominal_run(context, drive, windows)
    if context.trailed:
        run = trailed_run(context, drive, windows, machine)
    else:
        run = run_windows(machine, drive, context.motion, windows, initial_states(context.motion, windows))
    found = []
    for i, fit in enumerate(row.fits):
        moved, nominal = (stacked_simulated(fit.parts, row.row, r, i) for r in (run, base))
        left = remaining(fit.alignment, fit.sensitivity, (moved - nominal)[:, None])
        found.append(left[:, 0] / RELATIVE_STEP)
    return found
