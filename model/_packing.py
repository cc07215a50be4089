"""Typed objects into the compiled kernels' arrays."""

from __future__ import annotations

import math

import numpy as np

from . import _layout as at
from ._layout import Floats, Options, Tables
from ._steering import RING_SIZE
from .inputs import Controls, Driver, ForceSeries
from .machine import Machine, Tyre
from .settings import SimulationSettings
from .tyres import law_code


def pack_options(settings: SimulationSettings) -> Options:
    """Settings as whole numbers."""
    return Options(
        law=law_code(settings.tyre_law),
        as_printed=int(settings.equations == "as_printed"),
        cramer=int(settings.solver == "cramer"),
        ellipse=int(settings.friction_ellipse),
        draft_on_axis=int(settings.draft_direction == "axis"),
        largest_rate=float(settings.largest_rate),
        relative_tolerance=float(settings.relative_tolerance),
        absolute_tolerance=float(settings.absolute_tolerance),
    )


def _wheel(x: float, y: float, tyre: Tyre, stiffness: float, load: float, share: float) -> list[float]:
    limit, rolling = tyre.friction * load, tyre.rolling_resistance * load
    return [x, y, stiffness, limit, rolling, tyre.relaxation_length, share]


def _tractor_wheels(machine: Machine) -> list[list[float]]:
    """Front left, front right, rear left, rear right (the paper's 11 to 14)."""
    t, tyres, loads = machine.tractor, machine.tyres, machine.wheel_loads()
    driven = 2.0 * (loads.rear + (loads.front if t.driven == "all" else 0.0))
    axles = (
        (t.front_axle, t.front_track, tyres.front, loads.front, loads.front if t.driven == "all" else 0.0),
        (-t.rear_axle, t.rear_track, tyres.rear, loads.rear, loads.rear),
    )
    return [
        _wheel(
            x, side * track / 2.0, tyre, tyre.stiffness_at(machine.tyre_pressure_mpa), load, drive / driven
        )
        for x, track, tyre, load, drive in axles
        for side in (1.0, -1.0)
    ]


def _seeder_wheels(machine: Machine) -> list[list[float]]:
    s, tyre = machine.seeder, machine.tyres.seeder
    if s is None or tyre is None:
        return []
    loads = machine.wheel_loads().seeder
    return [
        _wheel(-axle, side * track / 2.0, tyre, tyre.stiffness_at(None), load, 0.0)
        for axle, track, load in zip(s.com_to_axle, s.track, loads, strict=True)
        for side in (1.0, -1.0)
    ]


def pack_machine(machine: Machine, settings: SimulationSettings) -> Floats:
    """Parameters of one machine, (PARAMETER_SIZE,); a tractor alone has a seeder of no mass that stays
    put."""
    p = np.zeros(at.PARAMETER_SIZE)
    t, s = machine.tractor, machine.seeder
    p[[at.MASS1, at.INERTIA1, at.HITCH, at.WHEELBASE]] = t.mass, t.yaw_inertia, t.hitch, t.wheelbase
    p[at.ACKERMANN] = t.front_track / t.wheelbase if settings.ackermann else 0.0
    p[at.SPEED_RATE] = 1.0 / settings.speed_time_constant
    p[[at.INERTIA2, at.HITCH_TO_COM, at.COS_DRAFT]] = 1.0
    if s is not None:
        angle = math.radians(s.draft_angle_deg)
        p[[at.MASS2, at.INERTIA2, at.HITCH_TO_COM]] = s.mass, s.yaw_inertia, s.hitch_to_com
        p[[at.DRAFT, at.DRAFT_POINT]] = s.draft, s.draft_point
        p[[at.COS_DRAFT, at.SIN_DRAFT]] = math.cos(angle), math.sin(angle)
    wheels = np.array(_tractor_wheels(machine) + _seeder_wheels(machine))
    if len(wheels) > at.MAX_WHEELS:
        raise ValueError(
            f"seeder.com_to_axle lists {len(wheels) // 2 - 2} axles; at most {at.MAX_WHEELS // 2 - 2}"
        )
    p[at.WHEELS : at.WHEELS + wheels.size] = wheels.ravel()
    p[at.SEEDER_WHEELS] = len(wheels) - at.TRACTOR_WHEELS
    p[at.RESISTANCE] = p[at.DRAFT] * p[at.COS_DRAFT] + wheels[:, at.ROLLING].sum()
    p[at.STIFF_RATE] = fastest_sideways_rate(p, wheels)
    p[at.SLIP_RATE] = max((1.0 / length for length in wheels[:, at.RELAXATION] if length > 0.0), default=0.0)
    return p


def fastest_sideways_rate(p: Floats, wheels: Floats) -> float:
    """Fastest decay of sideways motion times speed, m/s²: the largest eigenvalue of M⁻¹·Σ C·g·gᵀ, g a wheel's
    lateral velocity by the rates of (y1, yaw1, yaw2) when both bodies are in line."""
    m1, m2, l4, l5 = p[at.MASS1], p[at.MASS2], p[at.HITCH], p[at.HITCH_TO_COM]
    mass = np.array(
        [
            [m1 + m2, -m2 * l4, -m2 * l5],
            [-m2 * l4, p[at.INERTIA1] + m2 * l4**2, m2 * l4 * l5],
            [-m2 * l5, m2 * l4 * l5, p[at.INERTIA2] + m2 * l5**2],
        ]
    )
    x, stiffness = wheels[:, at.WHEEL_X], wheels[:, at.STIFFNESS]
    trailed = np.arange(len(wheels)) >= at.TRACTOR_WHEELS
    lever = np.stack([np.ones(x.size), np.where(trailed, -l4, x), np.where(trailed, x - l5, 0.0)])
    damping = (lever * stiffness) @ lever.T
    return float(np.abs(np.linalg.eigvals(np.linalg.solve(mass, damping))).max())


def pack_driver(driver: Driver | None, step: float) -> Floats:
    """A driver as one row; ACTIVE is 0 without one. The period must be a whole number of steps."""
    row = np.zeros(at.DRIVER_SIZE)
    if driver is None:
        return row
    steps = round(driver.period / step)
    if steps < 1 or abs(steps * step - driver.period) > 1e-9:
        raise ValueError(
            f"driver.period is {driver.period:g} s; it must be a multiple of the step of {step:g} s"
        )
    if not driver.delay / driver.period < RING_SIZE - 2:
        raise ValueError(
            f"driver.delay is {driver.delay:g} s; it must be below {(RING_SIZE - 2) * driver.period:g} s"
        )
    row[[at.ACTIVE, at.PREVIEW, at.DELAY, at.LAG]] = 1.0, driver.preview, driver.delay, driver.lag
    row[[at.MAX_RATE, at.MAX_ANGLE, at.GAIN, at.PERIOD_STEPS]] = (
        driver.max_rate, driver.max_angle, driver.gain, steps,
    )  # fmt: skip
    return row


JITTER = 1e-4  # of the spacing; times that are equal but for this (UTC in double precision) count as equal


def time_grid(controls: Controls, step: float) -> Floats:
    """Times of the tables, s from controls.t[0]: the controls' own where they are equally spaced, else each
    step; finer where the disturbance is."""
    t = controls.t
    spacing = float((t[-1] - t[0]) / (t.size - 1))
    if not np.abs(np.diff(t) - spacing).max() <= JITTER * spacing:
        spacing = step
    if controls.over_time is not None and controls.over_time.spacing < (1.0 - JITTER) * spacing:
        spacing = controls.over_time.spacing
    count = int(np.ceil((t[-1] - t[0]) / spacing - JITTER)) + 1
    return np.arange(count, dtype=np.float64) * spacing


def pack_controls(controls: Controls, step: float, trailed: bool = True) -> Tables:
    """Controls on an equal grid: their own where it is equal, else one at the integration step.

    trailed: whether there is a seeder; without one its share of the disturbance has nothing to act on.
    """
    t, grid = controls.t, time_grid(controls, step)
    now, spacing = t[0] + grid, float(grid[1])
    speed = np.interp(now, t, controls.speed)
    over_distance, path = controls.over_distance, controls.path
    return Tables(
        dt=spacing,
        steer=np.stack([np.interp(now, t, row) for row in controls.steer_rows]),
        speed=speed,
        acceleration=np.gradient(speed, spacing),
        time_force=_felt(_time_force(controls.over_time, now), trailed),
        spacing=1.0 if over_distance is None else float(over_distance.spacing),
        distance_force=np.zeros((1, 0, at.FORCE_SIZE))
        if over_distance is None
        else over_distance.rows.copy(),
        pitch=1.0 if path is None else float(path.spacing),
        path=np.zeros((0, at.PATH_SIZE))
        if path is None
        else np.ascontiguousarray(np.stack([path.x, path.y, path.yaw, path.curvature], axis=1)),
    )


def _felt(force: Floats, trailed: bool) -> Floats:
    felt = np.array(force)
    if not trailed:
        felt[..., at.FORCE_SIZE // 2 :] = 0.0
    return felt


def _time_force(series: ForceSeries | None, grid: Floats) -> Floats:
    if series is None:
        return np.zeros((1, 0, at.FORCE_SIZE))
    t = series.start + series.spacing * np.arange(series.rows.shape[1])
    columns = [[np.interp(grid, t, row[:, k]) for k in range(at.FORCE_SIZE)] for row in series.rows]
    return np.ascontiguousarray(np.array(columns).transpose(0, 2, 1))
