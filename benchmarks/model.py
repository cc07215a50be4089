"""Speed of the model, all in one run: our compiled integrator, scipy with plain and compiled right-hand
sides, a sweep.

    python benchmarks/model.py            everything (several minutes: scipy on rough ground is slow)
    python benchmarks/model.py --quick    shorter runs and a tenth of the sweep, same ratios

Errors are the largest distance of either CoM to a reference (our Runge–Kutta 4 at 1 ms, which tests hold
against DOP853), over the inputs as given: linear between samples each 10 ms.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp
from smts_validate.model import _layout as at
from smts_validate.model import dynamics
from smts_validate.model._kernels import derivative
from smts_validate.model._packing import pack_controls, pack_machine, pack_options
from smts_validate.model._steering import load_inputs, steering
from smts_validate.model.inputs import Controls, ForceSeries, coloured_noise
from smts_validate.model.machine import Machine
from smts_validate.model.settings import SimulationSettings
from smts_validate.model.simulate import initial_state, simulate
from smts_validate.pipeline.study_plan import VERSIONS, StudyPlan, machine_of
from smts_validate.pipeline.study_sweep import (
    SWEEP_SETTINGS,
    SweepPlan,
    run_sweep,
    sample_designs,
    simulate_designs,
)

SPACING = 0.01
SPEED = 2.8
SIZES = (0.0, 1000.0, 1000.0, 0.0, 600.0, 900.0)
DEFAULT = SimulationSettings()
# No relaxation length: the stiffest and kinkiest case for an adaptive integrator, 8 states for all
NO_RELAXATION = {f"tyres.{axle}.relaxation_length": 0.0 for axle in ("front", "rear", "seeder")}


def make_controls(seconds: float, rough: bool) -> Controls:
    """120 s of weaving at 100 Hz; rough: with disturbance that kinks every 10 ms."""
    t = np.arange(0.0, seconds + SPACING / 2, SPACING)
    ground = None
    if rough:
        generator = np.random.default_rng(1)
        columns = [coloured_noise(generator, t.size, SPACING, sd, 0.15) for sd in SIZES]
        ground = ForceSeries(SPACING, np.stack(columns, axis=1))
    return Controls(t=t, speed=np.full(t.size, SPEED), steer=0.05 * np.sin(0.5 * t), over_time=ground)


def best_time(work: Callable[[], object], repeats: int) -> float:
    """Shortest wall time of some repeats, s."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def plain_rate(machine: Machine, controls: Controls) -> Callable[[float, np.ndarray], np.ndarray]:
    """The NumPy right-hand side with interpolated inputs."""
    force = None if controls.over_time is None else controls.over_time.values

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        place = min(max(t / SPACING, 0.0), controls.t.size - 1.0)
        i = min(int(place), controls.t.size - 2)
        part = place - i
        steer = controls.steer[i] + part * (controls.steer[i + 1] - controls.steer[i])
        disturbance = (0.0,) * 6 if force is None else tuple(force[i] + part * (force[i + 1] - force[i]))
        return dynamics.right_hand_side(
            machine, state, dynamics.Instant(float(steer), SPEED, 0.0, disturbance)
        )

    return rate


@njit(cache=True)
def compiled_rate(t, state, p, driver, memory, change, tables, options, full, u, rate):  # type: ignore[no-untyped-def]
    """The compiled right-hand side behind one call."""
    full[:8] = state
    load_inputs(t, steering(t, memory, driver, change, tables, 0.01), p, change, tables, u)
    derivative(full, p, u, tables.distance_force[0], tables.spacing, options, rate)
    return rate[:8].copy()


def compiled_arguments(machine: Machine, controls: Controls) -> tuple[object, ...]:
    """What `compiled_rate` takes after time and state."""
    change, u = np.zeros(at.CHANGE_SIZE), np.zeros(at.INPUT_SIZE)
    change[[at.STEER_SCALE, at.SPEED_SCALE]] = 1.0
    u[at.FORCE_FACTOR] = 1.0
    return (
        pack_machine(machine, DEFAULT), np.zeros(at.DRIVER_SIZE), np.zeros(300), change,
        pack_controls(controls, SPACING), pack_options(DEFAULT), np.zeros(at.FULL_SIZE), u,
        np.zeros(at.FULL_SIZE),
    )  # fmt: skip


def positions(machine: Machine, states: np.ndarray) -> np.ndarray:
    """x and y of both CoMs, (n, 4), from states (n, 8)."""
    l4, l5 = machine.tractor.hitch, machine.seeder.hitch_to_com
    x1, y1, p1, p2 = states[:, :4].T
    return np.stack(
        [x1, y1, x1 - l4 * np.cos(p1) - l5 * np.cos(p2), y1 - l4 * np.sin(p1) - l5 * np.sin(p2)], axis=1
    )


def largest_gap(one: np.ndarray, other: np.ndarray) -> float:
    """Largest distance of either CoM, m."""
    gap = one - other
    return float(max(np.hypot(gap[:, 0], gap[:, 1]).max(), np.hypot(gap[:, 2], gap[:, 3]).max()))


def integrators(seconds: float, rough: bool) -> None:
    """Print one table: our integrator, scipy with either right-hand side."""
    machine, controls = (
        machine_of(VERSIONS["b"]).replace_parameters(NO_RELAXATION),
        make_controls(seconds, rough),
    )
    start, t = initial_state(v=SPEED), controls.t

    def ours(step: float) -> np.ndarray:
        run = simulate(machine, controls, start, t, SimulationSettings(step=step))
        return np.stack([run.x1, run.y1, run.x2, run.y2], axis=1)

    def by_scipy(rate: Callable, arguments: tuple[object, ...]) -> np.ndarray:
        found = solve_ivp(
            rate,
            (t[0], t[-1]),
            start,
            method="RK45",
            t_eval=t,
            rtol=tolerance,
            atol=1e-2 * tolerance,
            args=arguments,
        )
        return positions(machine, found.y.T)

    tolerance = 1e-6
    reference = ours(0.001)
    arguments = compiled_arguments(machine, controls)
    by_scipy(compiled_rate, arguments)
    plain = plain_rate(machine, controls)
    rows = [
        ("ours, RK4 at 10 ms, compiled", best_time(lambda: ours(SPACING), 7)),
        ("scipy RK45, compiled right-hand side", best_time(lambda: by_scipy(compiled_rate, arguments), 1)),
        ("scipy RK45, Python right-hand side", best_time(lambda: by_scipy(plain, ()), 1)),
    ]
    theirs = largest_gap(by_scipy(compiled_rate, arguments), reference)
    errors = [largest_gap(ours(SPACING), reference), theirs, theirs]
    ground = "rough field" if rough else "smooth input"
    print(f"\n{seconds:.0f} s, output at 100 Hz, {ground} (rtol {tolerance:g})")
    for (name, took), error in zip(rows, errors, strict=True):
        print(
            f"  {name:38s} {1e3 * took:10.1f} ms   {took / rows[0][1]:7.1f} x   error {1e6 * error:8.3f} µm"
        )


def sweep(variants: int) -> None:
    """Print the time of a sweep of 48 s runs on two threads, first and last quarter apart, and memory."""
    length = 48.0 * VERSIONS["a"].speed
    study = StudyPlan(length=length, run_in=0.0, settings=SWEEP_SETTINGS)
    plan = SweepPlan(count=variants, seeds=1, base=VERSIONS["a"], study=study, linear=False, workers=2)
    plan = SweepPlan(**{**vars(plan), "parameters": plan.parameters[1:]})
    small = SweepPlan(**{**vars(plan), "count": 64})
    checked = run_sweep(small)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    start, spent = time.perf_counter(), time.process_time()
    simulate_designs(plan, sample_designs(plan))
    took, spent = time.perf_counter() - start, time.process_time() - spent
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(f"\nsweep: {variants} variants of 48 s, step 20 ms, two threads, straightness and spectra of each")
    each = took / variants
    print(f"  {took:.1f} s ({1e3 * each:.2f} ms a variant; 10,000 would take {1e4 * each:.1f} s)")
    print(f"  processor time {spent:.1f} s: {spent / 2:.1f} s on two cores that nobody else uses")
    print(f"  step error by halving: {1e6 * checked.step_error:.1f} µm")
    print(f"  peak memory: {before / 1024:.0f} MB before, {after / 1024:.0f} MB after")


def main() -> None:
    """Run all."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("--quick", action="store_true", help="a quarter of the time, a tenth of the sweep")
    quick = options.parse_args().quick
    for rough in (False, True):
        integrators(30.0 if quick else 120.0, rough)
    sweep(1000 if quick else 10_000)


if __name__ == "__main__":
    main()
