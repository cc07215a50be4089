"""Planar motion of a twin by the two-mass model: driver, speed control and the soil's disturbance at
both bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.inputs import Controls, Driver, ForceSeries
from ..model.inputs import Path as ModelPath
from ..model.machine import GRAVITY, Machine, MachineError
from ..model.settings import SimulationSettings
from ..model.simulate import initial_state, simulate
from .twin_motion import STEP, PlanarMotion, hand, joined
from .twin_path import PITCH, Path, wander
from .twin_plan import TwinPlan
from .twin_tables import PlanError

Floats = NDArray[np.float64]

SPACING = 0.1  # m between points of the disturbance
FADE_IN = 3.0  # m from the start over which the disturbance comes up: a machine at rest is not pushed
LEAST_PREVIEW = 3.5  # m


def dynamic(
    plan: TwinPlan, table: Mapping[str, Any], path: Path, speed: Floats, rng: np.random.Generator
) -> PlanarMotion:
    """Motion by the equations of `model`. table: the true [machine] table.

    Raises PlanError where the machine cannot be, or is thrown off by its inputs.
    """
    try:
        machine = Machine.from_mapping(table, plan.run.tyre_pressure_mpa)
    except MachineError as error:
        raise PlanError(f"machine: {error}") from None
    t: Floats = STEP * np.arange(speed.size, dtype=np.float64)
    controls = Controls(
        t=t,
        speed=speed,
        steer=hand(plan.driver, speed, rng),
        driver=_driver(plan),
        path=ModelPath(PITCH, path.x, path.y, path.heading, path.curvature),
        over_distance=ForceSeries(
            SPACING, disturbance(plan, machine, rng) + weight_load(plan, machine, path)
        ),
    )
    run = simulate(machine, controls, _start(plan, machine, path), t, SimulationSettings(step=STEP))
    if run.diverged_at is not None:
        raise PlanError(f"the machine is thrown off its path at {run.diverged_at:.1f} s; calm driver or soil")
    yaw2 = run.yaw1 if run.yaw2 is None else run.yaw2
    return joined(t, run.x1, run.y1, run.yaw1, yaw2, run.steer, table)


def _driver(plan: TwinPlan) -> Driver:
    driver = plan.driver
    return Driver(
        preview=max(driver.preview * plan.path.speed, LEAST_PREVIEW),
        delay=driver.delay,
        lag=driver.lag,
        max_angle=math.radians(driver.limit_deg),
    )


def _start(plan: TwinPlan, machine: Machine, path: Path) -> Floats:
    """At rest with the rear axle at the path's start, both bodies along it."""
    heading, ahead, left = float(path.heading[0]), machine.tractor.rear_axle, plan.path.start_offset
    c, s = math.cos(heading), math.sin(heading)
    return initial_state(x=ahead * c - left * s, y=ahead * s + left * c, yaw1=heading)


def disturbance(plan: TwinPlan, machine: Machine, rng: np.random.Generator) -> Floats:
    """Side force and yaw moment at both bodies every SPACING m, (n, 6): coloured over distance, and the
    constant load of a crabbing machine."""
    soil, distance = plan.soil, _places(plan)
    n = distance.size
    sizes = np.array([0.0, soil.side_force_tractor, soil.yaw_moment_tractor, 0.0, 0.0, 0.0])
    if machine.seeder is not None:
        sizes[4:] = soil.side_force_seeder, soil.yaw_moment_seeder
    coloured = [size * wander(n, SPACING, soil.correlation_length, rng) for size in sizes]
    fade = np.clip(distance / FADE_IN, 0.0, 1.0)
    return np.asarray(fade[:, None] * (np.column_stack(coloured) + crab_load(plan, machine)))


def _places(plan: TwinPlan) -> Floats:
    """Distances of the disturbance, m, beyond the last row's end."""
    lanes = plan.path.rows
    distance = lanes * plan.path.row_length + (lanes - 1) * math.pi * plan.path.turn_radius + 50.0
    return np.asarray(np.arange(math.ceil(distance / SPACING) + 1) * SPACING, dtype=np.float64)


def weight_load(plan: TwinPlan, machine: Machine, path: Path) -> Floats:
    """The weight's part along the ground across each body, N, every SPACING m along the path, (n, 6): -m·g·slope to
    the left. Zeros where the plan leaves it out."""
    soil, distance = plan.soil, _places(plan)
    load = np.zeros((distance.size, 6))
    if soil.weight_pulls:
        along = PITCH * np.arange(path.heading.size)
        heading = np.interp(distance, along, path.heading)
        fade = np.clip(distance / FADE_IN, 0.0, 1.0)
        downhill = GRAVITY * fade * (np.sin(heading) * soil.slope_east - np.cos(heading) * soil.slope_north)
        load[:, 1] = machine.tractor.mass * downhill
        if machine.seeder is not None:
            load[:, 4] = machine.seeder.mass * downhill
    return load


def crab_load(plan: TwinPlan, machine: Machine) -> Floats:
    """Load that holds each body at its crab angle β, (6,): ΣC·β across it, and ΣC·x·β about its CoM."""
    soil, tyres, pressure = plan.soil, machine.tyres, machine.tyre_pressure_mpa
    first, second = math.radians(soil.crab_tractor_deg), math.radians(soil.crab_seeder_deg)
    front, rear = 2.0 * tyres.front.stiffness_at(pressure), 2.0 * tyres.rear.stiffness_at(pressure)
    tractor = machine.tractor
    load = np.zeros(6)
    load[1] = (front + rear) * first
    load[2] = (front * tractor.front_axle - rear * tractor.rear_axle) * first
    if machine.seeder is not None and tyres.seeder is not None:
        stiffness = 2.0 * len(machine.seeder.com_to_axle) * tyres.seeder.cornering_stiffness
        load[4] = stiffness * second
        load[5] = -stiffness * machine.seeder.mean_axle * second
    return load
