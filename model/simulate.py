"""Controls and an initial state in, simulated motion out."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _layout as at
from ._adaptive import run_adaptive_batch
from ._integrators import run_batch
from ._packing import pack_controls, pack_driver, pack_machine, pack_options
from ._steering import FROM, PROGRESS, RING, RING_SIZE, TO
from .inputs import Controls, Driver
from .machine import Machine
from .settings import SimulationSettings

Floats = NDArray[np.float64]
DEFAULT = SimulationSettings()


class SimulationError(ValueError):
    """A simulation that cannot be set up: one line, what and how to mend."""


@dataclass(frozen=True)
class SimulatedRun:
    """Simulated motion of both bodies; arrays (n,); body 2 is None for a tractor alone.

    t : s; x, y : m, CoM, world; yaw : rad; v, v_lateral : m/s, CoM velocity along the body's x and y axis;
    yaw_rate : rad/s; ax, ay : m/s², CoM acceleration along the body's x and y axis; steer : rad, mean front
    angle
    diverged_at : s, when the run left the finite; the arrays then end before it
    """

    t: Floats
    x1: Floats
    y1: Floats
    yaw1: Floats
    v1: Floats
    v_lateral1: Floats
    yaw_rate1: Floats
    ax1: Floats
    ay1: Floats
    steer: Floats
    x2: Floats | None = None
    y2: Floats | None = None
    yaw2: Floats | None = None
    v2: Floats | None = None
    v_lateral2: Floats | None = None
    yaw_rate2: Floats | None = None
    ax2: Floats | None = None
    ay2: Floats | None = None
    diverged_at: float | None = None


@dataclass(frozen=True)
class BatchRun:
    """Many runs side by side: the fields of `SimulatedRun` as (runs, n) arrays, t (runs, n).

    diverged_at : (runs,) s, NaN where a run did not; its samples from then on are NaN.
    """

    t: Floats
    x1: Floats
    y1: Floats
    yaw1: Floats
    v1: Floats
    v_lateral1: Floats
    yaw_rate1: Floats
    ax1: Floats
    ay1: Floats
    steer: Floats
    x2: Floats | None
    y2: Floats | None
    yaw2: Floats | None
    v2: Floats | None
    v_lateral2: Floats | None
    yaw_rate2: Floats | None
    ax2: Floats | None
    ay2: Floats | None
    diverged_at: Floats

    def run(self, index: int) -> SimulatedRun:
        """One of the runs, cut off where it diverged."""
        when = self.diverged_at[index]
        good = int(np.isfinite(self.x1[index]).sum())
        arrays: dict[str, Any] = {
            name: None if value is None else value[index, :good]
            for name, value in vars(self).items()
            if name != "diverged_at"
        }
        return SimulatedRun(**arrays, diverged_at=None if np.isnan(when) else float(when))


def initial_state(
    x: ArrayLike = 0.0,
    y: ArrayLike = 0.0,
    yaw1: ArrayLike = 0.0,
    yaw2: ArrayLike | None = None,
    v: ArrayLike = 0.0,
    v_lateral: ArrayLike = 0.0,
    yaw_rate1: ArrayLike = 0.0,
    yaw_rate2: ArrayLike = 0.0,
) -> Floats:
    """State (x1, y1, yaw1, yaw2, vx1, vy1, yaw_rate1, yaw_rate2), world frame, from the tractor's pose and
    its CoM velocity along (v) and across (v_lateral) its axis; yaw2 None: in line. Arrays broadcast to
    (..., 8)."""
    x, y, yaw1, v, v_lateral, w1, w2 = np.broadcast_arrays(x, y, yaw1, v, v_lateral, yaw_rate1, yaw_rate2)
    cos, sin = np.cos(yaw1), np.sin(yaw1)
    yaw2_ = yaw1 if yaw2 is None else np.broadcast_to(np.asarray(yaw2, dtype=np.float64), yaw1.shape)
    columns = [x, y, yaw1, yaw2_, cos * v - sin * v_lateral, sin * v + cos * v_lateral, w1, w2]
    return np.stack([np.asarray(c, dtype=np.float64) for c in columns], axis=-1)


def simulate(
    machine: Machine,
    controls: Controls,
    initial: Floats,
    t_out: Floats,
    settings: SimulationSettings = DEFAULT,
) -> SimulatedRun:
    """The machine under its controls, from `initial` at t_out[0].

    Parameters: initial (8,), see `initial_state`; t_out (n,) s, equally spaced, increasing. The step is the
    settings' or the next smaller one that divides the spacing. A run that diverges ends early and says when.

    Raises SimulationError for times that are not equally spaced.
    """
    t = np.asarray(t_out, dtype=np.float64)
    if t.ndim != 1 or t.size < 2 or not (np.diff(t) > 0.0).all():
        raise SimulationError("t_out must hold two or more increasing times")
    spacing = float((t[-1] - t[0]) / (t.size - 1))
    if not np.abs(t - t[0] - spacing * np.arange(t.size)).max() < 1e-6 * max(spacing, 1.0):
        raise SimulationError("t_out must be equally spaced; interpolate the run's result instead")
    batch = simulate_batch(
        machine, controls, np.asarray(initial)[None], t.size, spacing, start=float(t[0]), settings=settings
    )
    return batch.run(0)


def halved_step_error(
    machine: Machine,
    controls: Controls,
    initial: Floats,
    t_out: Floats,
    settings: SimulationSettings = DEFAULT,
) -> float:
    """Error of a run's positions, m: largest distance of either CoM to the same run at half the step."""
    half = dataclasses.replace(settings, step=settings.step / 2.0, largest_rate=settings.largest_rate / 2.0)
    runs = [simulate(machine, controls, initial, t_out, choice) for choice in (settings, half)]
    count = min(run.t.size for run in runs)
    gaps = []
    for x, y in (("x1", "y1"), ("x2", "y2")):
        if getattr(runs[0], x) is not None:
            dx, dy = (getattr(runs[0], n)[:count] - getattr(runs[1], n)[:count] for n in (x, y))
            gaps.append(float(np.hypot(dx, dy).max()))
    return max(gaps)


def simulate_batch(
    machines: Machine | Sequence[Machine],
    controls: Controls,
    initial: Floats,
    samples: int,
    spacing: float,
    *,
    start: ArrayLike = 0.0,
    steer_offset: ArrayLike = 0.0,
    steer_scale: ArrayLike = 1.0,
    speed_scale: ArrayLike = 1.0,
    speed_offset: ArrayLike = 0.0,
    steer_row: ArrayLike = 0,
    force_row: ArrayLike = 0,
    force_scale: ArrayLike = 1.0,
    drivers: Sequence[Driver] | None = None,
    settings: SimulationSettings = DEFAULT,
) -> BatchRun:
    """Many runs with the same controls in one compiled call; it releases the GIL, so threads share the work.

    Parameters
    machines : one for all, or one a run
    initial : (runs, 8)
    samples, spacing : every run gives `samples` samples each `spacing` s, from its own `start`
    start : s, in the time of `controls`; steer_offset rad; steer = offset + scale·controls.steer[steer_row]
    speed_scale, speed_offset : speed asked = scale·controls.speed + offset (m/s)
    steer_row, force_row : which row of a two-dimensional steer and of the disturbances a run uses
    force_scale : factor of all disturbance
    drivers : one a run, in place of controls.driver
    All but `samples` and `spacing` broadcast over runs.
    """
    state = _checked_state(initial)
    every = max(int(np.ceil(spacing / settings.step - 1e-9)), 1)
    step = spacing / every
    many = [machines] if isinstance(machines, Machine) else list(machines)
    who = [controls.driver] if drivers is None else list(drivers)
    _require_counts(len(state), many, who)
    since = np.asarray(start, dtype=np.float64) - controls.t[0]
    change = _changes(
        len(state), since, steer_offset, steer_scale, speed_scale, speed_offset, steer_row, force_row,
        force_scale,
    )  # fmt: skip
    tables = pack_controls(controls, step, trailed=many[0].seeder is not None)
    _require_rows(change, tables)
    out = np.full((len(state), samples, at.OUTPUT_SIZE), np.nan)
    good = np.zeros(len(state))
    integrate = run_adaptive_batch if settings.integrator == "dopri45" else run_batch
    integrate(
        state,
        np.stack([pack_machine(m, settings) for m in many]),
        np.stack([pack_driver(d, step) for d in who]),
        change, tables, pack_options(settings), step, every, _memory(state, tables), out, good,
    )  # fmt: skip
    t = controls.t[0] + change[:, at.START, None] + spacing * np.arange(samples)
    return batch_run(many, t, out, good)


def _checked_state(initial: Floats) -> Floats:
    state = np.array(initial, dtype=np.float64, order="C")
    if state.ndim != 2 or state.shape[1] != at.STATE_SIZE or not np.isfinite(state).all():
        raise SimulationError(f"initial has shape {state.shape}; it must be finite and of shape (runs, 8)")
    return state


def _require_counts(runs: int, machines: Sequence[Machine], drivers: Sequence[Driver | None]) -> None:
    for name, count in (("machines", len(machines)), ("drivers", len(drivers))):
        if count not in (1, runs):
            raise SimulationError(f"{name} has {count} entries for {runs} runs; give one, or one a run")
    if len({machine.seeder is None for machine in machines}) > 1:
        raise SimulationError("machines must all have a seeder or none")


def _changes(runs: int, *columns: ArrayLike) -> Floats:
    return np.stack([np.broadcast_to(np.asarray(c, dtype=np.float64), (runs,)) for c in columns], axis=1)


def _require_rows(change: Floats, tables: at.Tables) -> None:
    forces = [len(table) for table in (tables.time_force, tables.distance_force) if table.shape[1] > 0]
    for name, column, count in (
        ("steer_row", at.STEER_ROW, len(tables.steer)),
        ("force_row", at.FORCE_ROW, min(forces, default=1)),
    ):
        used = change[:, column]
        if not ((used >= 0) & (used < count)).all():
            raise SimulationError(f"{name} must lie between 0 and {count - 1}")


def _memory(state: Floats, tables: at.Tables) -> Floats:
    """The drivers' memory at the start: nearest place on the path, wheels straight."""
    memory = np.zeros((len(state), RING + RING_SIZE))
    if len(tables.path):
        dx = state[:, None, at.X1] - tables.path[None, :, at.PATH_X]
        dy = state[:, None, at.Y1] - tables.path[None, :, at.PATH_Y]
        memory[:, PROGRESS] = tables.pitch * np.argmin(dx * dx + dy * dy, axis=1)
    memory[:, [FROM, TO]] = 0.0
    return memory


def batch_run(machines: Sequence[Machine], t: Floats, out: Floats, good: Floats) -> BatchRun:
    """Body-frame quantities of both bodies from output samples (runs, n, 13), of which `good` are good in
    each."""
    last = np.minimum(good, t.shape[1] - 1).astype(int)
    diverged = np.where(good < t.shape[1], t[np.arange(len(t)), last], np.nan)
    x1, y1, yaw1, yaw2, vx1, vy1, w1, w2, ax1, ay1, alpha1, alpha2, steer = np.moveaxis(out, -1, 0)
    c1, s1, c2, s2 = np.cos(yaw1), np.sin(yaw1), np.cos(yaw2), np.sin(yaw2)
    first: dict[str, Floats] = {
        "x1": x1, "y1": y1, "yaw1": yaw1, "v1": c1 * vx1 + s1 * vy1, "v_lateral1": c1 * vy1 - s1 * vx1,
        "yaw_rate1": w1, "ax1": c1 * ax1 + s1 * ay1, "ay1": c1 * ay1 - s1 * ax1, "steer": steer,
    }  # fmt: skip
    names = ("x2", "y2", "yaw2", "v2", "v_lateral2", "yaw_rate2", "ax2", "ay2")
    second: dict[str, Any] = dict.fromkeys(names)
    if machines[0].seeder is not None:
        l4 = np.array([m.tractor.hitch for m in machines])[:, None]
        l5 = np.array([0.0 if m.seeder is None else m.seeder.hitch_to_com for m in machines])[:, None]
        vx2, vy2 = vx1 + l4 * s1 * w1 + l5 * s2 * w2, vy1 - l4 * c1 * w1 - l5 * c2 * w2
        ax2 = ax1 + l4 * (s1 * alpha1 + c1 * w1**2) + l5 * (s2 * alpha2 + c2 * w2**2)
        ay2 = ay1 - l4 * (c1 * alpha1 - s1 * w1**2) - l5 * (c2 * alpha2 - s2 * w2**2)
        second = {
            "x2": x1 - l4 * c1 - l5 * c2, "y2": y1 - l4 * s1 - l5 * s2, "yaw2": yaw2,
            "v2": c2 * vx2 + s2 * vy2, "v_lateral2": c2 * vy2 - s2 * vx2, "yaw_rate2": w2,
            "ax2": c2 * ax2 + s2 * ay2, "ay2": c2 * ay2 - s2 * ax2,
        }  # fmt: skip
    return BatchRun(t=t, **first, **second, diverged_at=diverged)
