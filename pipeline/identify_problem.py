"""The identification as a least-squares problem: free parameters, and the replay's aligned residuals of all passes.

In each window of each row the model is replayed as in the comparison, and what the window's alignment (offset,
heading, steering offset, each within its stated prior P₀) can answer is taken out:
e = (I − J(JᵀS⁻¹J + P₀⁻¹)⁻¹JᵀS⁻¹)·r. So a parameter gets no credit for what an unknown start explains as well.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..model.machine import Machine, MachineError
from . import grid as on_grid
from .compare import RowComparison, effective_count
from .grid import Part
from .identify_parameter import IdentifyError, Parameter
from .replay import Drive, Window, drive_of, initial_states, run_windows, window_prior
from .window_fit import Context, coarse, trailed_run, weights_of

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Result = TypeVar("Result")

STEP = 0.01  # of a parameter's scale, for central differences
INSIDE = 1e-3  # of the bounds' width: how far inside them a search begins


@dataclass(frozen=True)
class Stretch:
    """One row of one pass ready to be replayed with other parameters.

    run : the pass; slopes : (N, 2 or 3) of each window to its alignment; gains : the alignment's answer (λ = 1)
    """

    run: str
    machine: Machine
    context: Context
    windows: tuple[Window, ...]
    parts: tuple[tuple[Part, ...], ...]
    slopes: tuple[Floats, ...]
    gains: tuple[Floats, ...]
    drive: Drive


@dataclass(frozen=True)
class Layout:
    """Where each entry of the stacked residual belongs; all (N,) but `names`.

    valid : outside GNSS gaps; response : index into `names`; cluster : the window; stretch : the row
    """

    names: tuple[str, ...]
    valid: NDArray[np.bool_]
    response: Ints
    cluster: Ints
    stretch: Ints

    @property
    def clusters(self) -> int:
        """How many windows there are."""
        return int(self.cluster.max()) + 1


def stretch_of(run: str, machine: Machine, row: RowComparison) -> Stretch:
    """A compared row, ready to be replayed: its windows and sensitivities are those of the comparison."""
    context = row.context
    windows = tuple(fit.window for fit in row.fits)
    gains = tuple(_gain(context, f.window, f.parts, f.sensitivity) for f in row.fits)
    drive = coarse(drive_of(context.motion, row.row, context.settings))
    return Stretch(
        run, machine, context, windows, tuple(f.parts for f in row.fits),
        tuple(f.sensitivity for f in row.fits), gains, drive,
    )  # fmt: skip


def _gain(context: Context, window: Window, parts: Sequence[Part], slope: Floats) -> Floats:
    size = slope.shape[1]
    prior = window_prior(context.motion, window, context.grid.row, context.settings)[:size, :size]
    weighted = slope.T * weights_of(context, window, parts)
    return np.asarray(np.linalg.solve(weighted @ slope + np.linalg.inv(prior), weighted))


def layout_of(stretches: Sequence[Stretch]) -> Layout:
    """Where each entry of `residual_of` belongs."""
    names: list[str] = []
    valid, response, cluster, stretch = [], [], [], []
    window = 0
    for j, one in enumerate(stretches):
        for parts in one.parts:
            valid.append(on_grid.stacked_valid(parts))
            for name, place in on_grid.slices(parts):
                if name not in names:
                    names.append(name)
                size = place.stop - place.start
                response.append(np.full(size, names.index(name)))
                cluster.append(np.full(size, window))
                stretch.append(np.full(size, j))
            window += 1
    joined = (np.concatenate(x).astype(np.int64) for x in (response, cluster, stretch))
    return Layout(tuple(names), np.concatenate(valid), *joined)


def residual_of(stretches: Sequence[Stretch], values: Mapping[str, float]) -> Floats:
    """(N,) aligned residuals of all windows with the named parameters set to `values`; masked points are 0."""
    return residuals_of(stretches, [values])[0]


def residuals_of(stretches: Sequence[Stretch], many: Sequence[Mapping[str, float]]) -> list[Floats]:
    """`residual_of` at each of many points: every row at every point is a task of its own, spread over the cores."""
    found = in_parallel([partial(aligned, stretch, values) for values in many for stretch in stretches])
    count = len(stretches)
    return [np.concatenate(found[k * count : (k + 1) * count]) for k in range(len(many))]


def in_parallel(tasks: Sequence[Callable[[], Result]]) -> list[Result]:
    """Results of the tasks, in their order, on a thread a core: the compiled integration, three quarters of a
    replay's time, releases the interpreter's lock."""
    workers = min(os.cpu_count() or 1, len(tasks))
    if workers < 2:
        return [task() for task in tasks]
    with ThreadPoolExecutor(workers) as executor:
        return list(executor.map(lambda task: task(), tasks))


def aligned(
    stretch: Stretch, values: Mapping[str, float], drive: Drive | None = None, **changes: Any
) -> Floats:
    """(n,) aligned residuals of one stretch; `drive` and `changes` (see `simulate_batch`) in place of its own."""
    machine, context = changed(stretch.machine, values), stretch.context
    drive = stretch.drive if drive is None else drive
    if context.trailed:
        run = trailed_run(replace(context, machine=machine), drive, stretch.windows, machine)
    else:
        initial = initial_states(context.motion, stretch.windows)
        run = run_windows(machine, drive, context.motion, stretch.windows, initial, **changes)
    found = []
    for i, (parts, slope, gain) in enumerate(zip(stretch.parts, stretch.slopes, stretch.gains, strict=True)):
        residual = on_grid.stacked_simulated(parts, context.grid.row, run, i) - on_grid.stacked_measured(
            parts
        )
        found.append((residual - slope @ (gain @ residual)) * on_grid.stacked_valid(parts))
    return np.concatenate(found)


def changed(machine: Machine, values: Mapping[str, float]) -> Machine:
    """The machine with other parameters; raises IdentifyError where there can be no such machine."""
    try:
        return machine.replace_parameters(values)
    except MachineError as error:
        raise IdentifyError(f"--free: {error}; narrow the bounds as NAME=LOW:HIGH") from None


def values_at(parameters: Sequence[Parameter], z: Floats) -> dict[str, float]:
    """Parameter values by name at relative changes z (P,)."""
    return {p.name: p.value(float(change)) for p, change in zip(parameters, z, strict=True)}


def bounds_of(parameters: Sequence[Parameter]) -> tuple[Floats, Floats]:
    """(P,) lower and upper bounds of the relative changes."""
    return np.array([p.change(p.low) for p in parameters]), np.array([p.change(p.high) for p in parameters])


def inside(parameters: Sequence[Parameter], z: Floats) -> Floats:
    """The relative changes brought a little inside their bounds."""
    low, high = bounds_of(parameters)
    margin = INSIDE * (high - low)
    return np.clip(z, low + margin, high - margin)


def jacobian_of(
    stretches: Sequence[Stretch],
    parameters: Sequence[Parameter],
    z: Floats,
    fixed: Mapping[str, float] | None = None,
) -> Floats:
    """(N, P) derivative of the aligned residuals with respect to the relative changes, by central
    differences (one-sided at a bound); fixed : values of further parameters."""
    low, high = bounds_of(parameters)
    sides, widths = [], []
    for i in range(len(parameters)):
        up, down = z.copy(), z.copy()
        up[i], down[i] = min(z[i] + STEP, high[i]), max(z[i] - STEP, low[i])
        sides += [{**(fixed or {}), **values_at(parameters, side)} for side in (up, down)]
        widths.append(up[i] - down[i])
    found = residuals_of(stretches, sides)
    return np.column_stack([(found[2 * i] - found[2 * i + 1]) / width for i, width in enumerate(widths)])


def weights_by_response(residual: Floats, layout: Layout) -> Floats:
    """(N,) weights n_eff/(N·M) by response, 0 where masked.

    M is the residual's mean square over all passes and n_eff its effective number of independent samples, so
    that Σ w·e² counts independent values, deviation and yaw on one scale, and a prior weighs as it should.
    """
    weights = np.zeros(residual.size)
    for k in range(len(layout.names)):
        here = (layout.response == k) & layout.valid
        if not here.any():
            continue
        rows = np.unique(layout.stretch[here])
        effective = sum(effective_count(residual[here & (layout.stretch == j)]) for j in rows)
        square = max(float(np.mean(residual[here] ** 2)), 1e-300)
        weights[here] = effective / (here.sum() * square)
    return weights
