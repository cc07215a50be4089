"""Speed of an identification: ours beside a plain serial loop around scipy, and coverage of the intervals.

    python benchmarks/identify.py                 four passes of 130 m, two stiffnesses free: two to three minutes
    python benchmarks/identify.py --coverage 64   how often the intervals hold the truth, in as many campaigns
    python benchmarks/identify.py --coverage 16 --soil 600   the same on ground that pushes both bodies (N, 1 sigma)
    python benchmarks/identify.py --coverage 16 --soil 600 --fine   ... with a steering sensor of 0.03° and 0.1 %

Three ways to the same least squares: ours (compiled replay, its rows and its differences side by side on the
cores); `scipy.optimize.least_squares` with its own serial 3-point differences around the same compiled replay, row
after row; and the same loop around `scipy.integrate.solve_ivp` with a right-hand side in NumPy, of which one
evaluation of the motion is timed (the loop takes as many as the second way's).
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from smts_validate.model import dynamics
from smts_validate.pipeline.compare import compare
from smts_validate.pipeline.identify import SETTINGS
from smts_validate.pipeline.identify_fit import fit, minimise
from smts_validate.pipeline.identify_parameter import Parameter, parameter_of
from smts_validate.pipeline.identify_problem import (
    Stretch,
    aligned,
    bounds_of,
    layout_of,
    stretch_of,
    values_at,
    weights_by_response,
)
from smts_validate.pipeline.identify_profile import profile
from smts_validate.pipeline.replay import OVERRUN, initial_states

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "pipeline"))
from synthetic_motion import Errors, Field, machine_of, manifest_of, motion_of, truth_of

Result = TypeVar("Result")
STATED = {
    "tyres.front.cornering_stiffness": 1.4,
    "tyres.seeder.cornering_stiffness": 0.7,
}  # over the true one
HEADINGS = (0.02, np.pi + 0.02)
SPEED = 2.8
FINE = Errors(steer=np.deg2rad(0.03), steer_zero=np.deg2rad(0.05), steer_scale=0.001)
REPEATS = 3
SOME = 3  # windows that the slowest way replays


def problem(
    first: int, soil: float = 0.0, errors: Errors = Errors()
) -> tuple[list[Stretch], list[Parameter]]:
    """Two passes each way, smoothed motions about a known truth, and two parameters stated wrongly.

    soil : N, 1 sigma of the side force at both bodies, correlated over 1.5 m, with a moment of 0.6 m of it
    """
    manifest = manifest_of()
    truth = machine_of(manifest)
    wrong = truth.replace_parameters({name: f * truth.parameter(name) for name, f in STATED.items()})
    stretches = []
    for k in range(4):
        ground = Field(heading=HEADINGS[k % 2], soil_force=soil, soil_moment=0.6 * soil, soil_length=1.5)
        run = truth_of(truth, ground, SPEED, first + k)
        motion = motion_of(run, truth, errors, 500 + first + k)
        rows = compare(motion, wrong, manifest, SETTINGS).rows
        stretches += [stretch_of(f"pass-{k}", wrong, row) for row in rows]
    return stretches, [parameter_of(name, [wrong]) for name in STATED]


def timed(work: Callable[[], Result], repeats: int = 1) -> tuple[float, Result]:
    """Shortest wall time of some repeats, s, and the result."""
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        found = work()
        times.append(time.perf_counter() - start)
    return min(times), found


def serial_loop(
    stretches: list[Stretch], free: list[Parameter], weights: np.ndarray
) -> tuple[np.ndarray, int]:
    """(P,) estimate of scipy's own serial loop, and how many times it replayed all passes."""
    root, count = np.sqrt(weights), 0

    def residual(z: np.ndarray) -> np.ndarray:
        nonlocal count
        count += 1
        return root * np.concatenate([aligned(s, values_at(free, z)) for s in stretches])

    start = np.zeros(len(free))
    found = least_squares(residual, start, jac="3-point", bounds=bounds_of(free), xtol=1e-4, ftol=1e-6)
    return found.x, count


def plain_motion(stretch: Stretch) -> float:
    """Seconds a window of `solve_ivp` with a right-hand side in NumPy, over the first windows."""
    context, controls = stretch.context, stretch.drive.controls
    windows = stretch.windows[:SOME]
    states, t = initial_states(context.motion, windows), context.motion.t
    steer = controls.steer_rows[0]

    def rate(at: float, state: np.ndarray) -> np.ndarray:
        angle, speed = (float(np.interp(at, controls.t, y)) for y in (steer, controls.speed))
        return dynamics.right_hand_side(
            stretch.machine, state, dynamics.Instant(angle, speed, 0.0, (0.0,) * 6)
        )

    def run() -> None:
        for window, state in zip(windows, states, strict=True):
            begin = float(t[window.start]) - stretch.drive.t0
            end = begin + float(t[window.stop - 1] - t[window.start]) + OVERRUN
            solve_ivp(rate, (begin, end), state[:8], method="RK45", rtol=1e-6, atol=1e-8)

    return timed(run)[0] / len(windows)


def speed() -> None:
    """Print the table of the three ways."""
    stretches, free = problem(1000)
    layout = layout_of(stretches)
    weights = weights_by_response(np.concatenate([aligned(s, {}) for s in stretches]), layout)
    minimise(stretches, free, weights, np.zeros(len(free)))  # compiles
    ours, estimate = timed(lambda: minimise(stretches, free, weights, np.zeros(len(free))), REPEATS)
    serial, (same, count) = timed(lambda: serial_loop(stretches, free, weights), REPEATS)
    windows = sum(len(s.windows) for s in stretches)
    plain = plain_motion(stretches[0]) * windows * count
    print(f"{len(stretches)} rows, {windows} windows, {len(free)} parameters, {os.cpu_count()} cores")
    print(f"{'way':<52} {'s':>8} {'ratio':>7}")
    for name, seconds in (
        ("ours", ours),
        (f"serial scipy loop, compiled replay ({count} replays)", serial),
        (f"serial scipy loop, solve_ivp in NumPy ({count} replays)", plain),
    ):
        print(f"{name:<52} {seconds:8.2f} {seconds / ours:7.1f}")
    print(f"largest difference of both estimates: {np.abs(estimate - same).max():.1e} (relative change)")


def coverage(campaigns: int, soil: float, errors: Errors, first: int) -> None:
    """Print how often the 95 % intervals of both parameters hold the truth, and the mean error in standard errors."""
    held, pulls = {name: [0, 0] for name in STATED}, {name: list[float]() for name in STATED}
    truth = machine_of(manifest_of())
    for k in range(campaigns):
        stretches, free = problem(first + 4 * k, soil, errors)
        found = fit(stretches, free, k)
        for i, p in enumerate(found.parameters):
            error = found.z[i] - p.change(truth.parameter(p.name))
            pulls[p.name].append(float(error / found.sd[i]))
            for kind, ends in enumerate((found.interval(i), profile(found, i))):
                low, high = (
                    replace_none(end, side) for end, side in zip(ends, (-np.inf, np.inf), strict=True)
                )
                held[p.name][kind] += low < truth.parameter(p.name) < high
    for name, (straight, follow) in held.items():
        print(f"{name}: by standard error {straight}, by profile {follow} of {len(pulls[name])} estimates")
        print(
            f"    error over standard error: mean {np.mean(pulls[name]):+.2f}, sd {np.std(pulls[name]):.2f}"
        )


def replace_none(end: float | None, side: float) -> float:
    """An open end is infinite."""
    return side if end is None else end


def main() -> None:
    """Run what was asked for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--coverage", type=int, metavar="CAMPAIGNS")
    parser.add_argument("--soil", type=float, default=0.0, metavar="N")
    parser.add_argument("--fine", action="store_true", help="a better steering sensor")
    parser.add_argument("--first", type=int, default=1000, metavar="SEED", help="of the first pass")
    options = parser.parse_args()
    if options.coverage:
        coverage(options.coverage, options.soil, FINE if options.fine else Errors(), options.first)
    else:
        speed()


if __name__ == "__main__":
    main()
