"""The seeder alone, behind a tractor whose motion is imposed (measured): row 4 of the equations of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _layout as at
from ._imposed import run_trailed_batch
from ._packing import pack_controls, pack_machine, pack_options
from .inputs import Controls, ForceSeries
from .machine import Machine
from .settings import SimulationSettings
from .simulate import DEFAULT, BatchRun, SimulationError, batch_run

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class ImposedTractor:
    """The tractor's motion on an equal grid of times; arrays (n,), world frame unless said otherwise.

    t : s; x, y : m; yaw : rad, unwrapped; vx, vy : m/s; yaw_rate : rad/s; ax, ay : m/s²; yaw_acceleration :
    rad/s²
    """

    t: Floats
    x: Floats
    y: Floats
    yaw: Floats
    vx: Floats
    vy: Floats
    yaw_rate: Floats
    ax: Floats
    ay: Floats
    yaw_acceleration: Floats

    def __post_init__(self) -> None:
        table = self.table
        steps = np.diff(self.t)
        if len(steps) < 1 or not (steps > 0.0).all() or not np.ptp(steps) <= 1e-4 * steps.mean():
            raise SimulationError(
                "the imposed tractor's t must hold two or more equally spaced increasing times"
            )
        if not np.isfinite(table).all():
            raise SimulationError(
                "the imposed tractor's motion holds a value that is not finite; fill gaps first"
            )

    @property
    def table(self) -> Floats:
        """All but t as columns, (n, 9)."""
        columns = [
            self.x,
            self.y,
            self.yaw,
            self.vx,
            self.vy,
            self.yaw_rate,
            self.ax,
            self.ay,
            self.yaw_acceleration,
        ]
        return np.stack([np.asarray(c, dtype=np.float64) for c in columns], axis=1)


def imposed_from_body(
    t: Floats, x: Floats, y: Floats, yaw: Floats, v: Floats, v_lateral: Floats, yaw_rate: Floats
) -> ImposedTractor:
    """Imposed motion from pose and body-frame velocity of O1 on an equal grid; accelerations by differences.

    v, v_lateral : m/s, along the body's x and y axis; yaw_rate : rad/s; see `ImposedTractor` for the rest.
    """
    cos, sin, spacing = np.cos(yaw), np.sin(yaw), float((t[-1] - t[0]) / (len(t) - 1))
    vx, vy = cos * v - sin * v_lateral, sin * v + cos * v_lateral
    ax, ay, alpha = (np.gradient(series, spacing) for series in (vx, vy, yaw_rate))
    return ImposedTractor(t, x, y, yaw, vx, vy, yaw_rate, ax, ay, alpha)


def simulate_trailed_batch(
    machines: Machine | Sequence[Machine],
    tractor: ImposedTractor,
    yaw2: ArrayLike,
    yaw_rate2: ArrayLike,
    samples: int,
    spacing: float,
    *,
    start: ArrayLike,
    over_time: ForceSeries | None = None,
    over_distance: ForceSeries | None = None,
    force_row: ArrayLike = 0,
    settings: SimulationSettings = DEFAULT,
) -> BatchRun:
    """The seeder's yaw and place behind the imposed tractor:
    yaw2'' = (Q4 − h4 − a41·x1'' − a42·y1'' − a43·yaw1'')/a44.

    Parameters: yaw2 rad and yaw_rate2 rad/s at each run's `start` (s, in the tractor's time); these and
    force_row broadcast over runs; samples, spacing as in `simulate_batch`. The result's tractor is the
    imposed one; its steer is zero.

    Raises SimulationError for a machine without a seeder.
    """
    many = [machines] if isinstance(machines, Machine) else list(machines)
    if many[0].seeder is None:
        raise SimulationError("seeder: this machine has none, so nothing trails behind the imposed tractor")
    columns = np.broadcast_arrays(
        *(np.atleast_1d(np.asarray(c, float)) for c in (yaw2, yaw_rate2, start, force_row))
    )
    initial = np.stack(columns[:2], axis=1)
    every = max(int(np.ceil(spacing / settings.step - 1e-9)), 1)
    held = Controls(
        t=tractor.t, speed=np.zeros(len(tractor.t)), over_distance=over_distance, over_time=over_time
    )
    tables = pack_controls(held, spacing / every)
    now = tractor.t[0] + tables.dt * np.arange(len(tables.speed))
    table = np.stack([np.interp(now, tractor.t, column) for column in tractor.table.T], axis=1)
    out = np.full((len(initial), samples, at.OUTPUT_SIZE), np.nan)
    out[:, :, at.STEER] = 0.0
    good = np.zeros(len(initial))
    run_trailed_batch(
        initial, np.stack([pack_machine(m, settings) for m in many]), columns[2] - tractor.t[0],
        np.ascontiguousarray(table), tables, np.array(columns[3]), pack_options(settings),
        spacing / every, every, out, good,
    )  # fmt: skip
    return batch_run(many, np.array(columns[2])[:, None] + spacing * np.arange(samples), out, good)
