"""`fuse`: one pass's streams to both bodies' smoothed motion."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import astuple, fields, replace

import numpy as np
from numpy.typing import NDArray

from ...sensors.streams import FieldLog
from ..wheels import WheelMotion, wheel_motions
from . import engine_compiled, engine_filterpy, tune
from . import state as s
from .assemble import Settled, assemble
from .draws import posterior_errors
from .engine_compiled import Filtered, Smoothed
from .known import (
    LONG,
    Known,
    build,
    headed,
    lag_sd,
    levelled,
    new_float_spans,
    parameters,
    prepare,
    start_of,
)
from .magnetic import with_magnetometers
from .motion import Motion
from .prepare import STEP
from .problem import Measurements, Problem
from .settings import FusionSettings, Levels

Floats = NDArray[np.float64]

TUNED = 6_000  # nodes of motion that the levels are tuned on
ROUGHLY_TUNED = 2_000  # of them, that the first sweep over the levels does with
MORE = 4  # relinearisations beyond those asked for, while the receiver is still refused at new places
NAMES = tuple(f.name for f in fields(Levels))
LEVEL_OF = {  # the level that a kind's variance grows with
    s.FIXED_X: "white_fixed", s.FIXED_Y: "white_fixed", s.FLOAT_X: "white_float", s.FLOAT_Y: "white_float",
    s.SECOND_X: "white_second", s.SECOND_Y: "white_second", s.THIRD_X: "white_second", s.THIRD_Y: "white_second",
    s.VEL_X: "velocity", s.VEL_Y: "velocity", s.ACCEL_Y: "lateral", s.HITCH: "hitch", s.WHEEL: "wheel",
}  # fmt: skip
REFUSED_RUN = 4.0  # s of refused fixed positions after which the receiver, not the filter, sets the place


def fuse(log: FieldLog, options: FusionSettings = FusionSettings()) -> Motion:
    """Both bodies' motion of one pass, smoothed, on a 1/50 s UTC grid, with its uncertainty.

    Extended Kalman filter and smoother over one joint state (see `state`), relinearised about its own smoothed
    path; clocks' lag, slips and noises by likelihood.

    Raises FusionError when the pass has no position, or too little of anything to be fused.
    """
    return assemble(*solved(log, options))


def solved(
    log: FieldLog, options: FusionSettings
) -> tuple[Known, FusionSettings, Levels, tuple[str, ...], Settled, dict[str, WheelMotion]]:
    """What `fuse` makes its motion of: what is known of the pass, its levels (and which the data told), the last sweep,
    the wheels. Raises FusionError."""
    wheels = wheel_motions(log)
    known = prepare(log, wheels)
    wheels = {name: wheel.turning() for name, wheel in wheels.items()}
    if known.t.size > LONG:
        give_back()
    levels, lag = Levels(), 0.0
    if options.adapt:
        lag = tune.best_lag(
            lambda value: score(beginning(build(known, options, levels, value), known)), lag_sd(log)
        )
    path = solve(build(known, options, levels, lag), options)[1].x
    known = levelled(known, path)
    free: tuple[str, ...] = ()
    if options.adapt:
        free = free_levels(known)
        likelihood, rough = (likelihood_of(known, options, path, size) for size in (TUNED, ROUGHLY_TUNED))
        levels = tune.best_levels(levels, free, likelihood, rough)
    if options.magnetometers:
        known = with_magnetometers(known, path)
    return known, options, levels, free, settle(known, options, levels, path), wheels


def give_back() -> None:
    """Return what was freed to the system, where its C library can (glibc): after an hour's wheels 0.4 GB lie idle in
    holes too small for what follows."""
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):
        return


def score(task: Problem) -> float:
    """Log-likelihood of the forward filter's innovations."""
    return engine_compiled.run_filter(task, None, store=False).log_likelihood


def beginning(task: Problem, known: Known) -> Problem:
    """The pass until enough of it has been driven for the clocks to show."""
    driven = np.flatnonzero(np.cumsum(~known.still) >= TUNED)
    if driven.size == 0:
        return task
    return cut(task, 0, int(driven[0]), task.x0[None])


def likelihood_of(
    known: Known, options: FusionSettings, path: Floats, size: int
) -> Callable[[Levels], float]:
    """Likelihood of levels over the `size` nodes of the pass with most motion, starting from the smoothed path there.

    Of a problem only variances depend on the levels, and a measurement's is a + b·level²: two problems give a and b.
    """
    moving = np.concatenate([[0], np.cumsum(~known.still)])
    starts = range(0, max(known.t.size - size, 0) + 1, 500)
    first = max(starts, key=lambda k: int(moving[min(k + size, known.t.size)] - moving[k]))
    lag = float(path[-1, s.LAG])
    last = min(first + size, known.t.size)
    none, one = (
        cut(build(known, options, at, lag), first, last, path)
        for at in (Levels(*[0.0] * len(NAMES)), Levels(*[1.0] * len(NAMES)))
    )
    a, b = none.measurements.var, one.measurements.var - none.measurements.var
    column = np.array([NAMES.index(LEVEL_OF.get(int(kind), NAMES[0])) for kind in one.measurements.kind])

    def likelihood(levels: Levels) -> float:
        squared = np.square(np.array(astuple(levels)))
        measurements = replace(none.measurements, var=a + b * squared[column])
        p = parameters(known, options, levels)
        spans, P0 = new_float_spans(known, lag, p)[first:last], start_of(known, p, lag)[1]
        return score(replace(none, measurements=measurements, inject=spans, parameters=p, P0=P0))

    return likelihood


def cut(task: Problem, first: int, last: int, path: Floats) -> Problem:
    """The problem of nodes first to last alone; it starts at the path with the wide prior of the whole."""
    q = task.measurements
    inside = (q.node >= first) & (q.node < last)
    part = Measurements(q.kind[inside], q.node[inside] - first, q.z[inside], q.var[inside], q.ahead[inside])
    return replace(
        task, t=task.t[first:last], step_inputs=task.step_inputs[first : last - 1],
        node_inputs=task.node_inputs[first:last], measurements=part, inject=task.inject[first:last],
        x0=path[first].copy(),
    )  # fmt: skip


def free_levels(known: Known) -> tuple[str, ...]:
    """Levels with enough data to be tuned."""
    main = known.epochs[0]
    free = ["beta1", "lateral", "forward"]
    free += ["white_fixed"] if main.fixed.sum() > 100 else []
    free += ["white_float"] if (~main.fixed).sum() > 50 else []
    free += ["velocity"] if np.isfinite(main.vx).sum() > 50 else []
    free += ["beta2", "hitch"] if known.two is not None else []
    free += ["wheel"] if known.wheel is not None else []
    free += ["white_second"] if len(known.epochs) > 1 else []
    return tuple(free)


def solve(task: Problem, options: FusionSettings, path: Floats | None = None) -> tuple[Filtered, Smoothed]:
    """Filter and smoother, linearised about the filter's own estimate or a given path (N, SIZE)."""
    engine = engine_filterpy if options.engine == "filterpy" else engine_compiled
    filtered = engine.run_filter(task, path)
    return filtered, engine.run_smoother(task, filtered, path)


def settle(known: Known, options: FusionSettings, levels: Levels, path: Floats) -> Settled:
    """Relinearise about the smoothed path; where the receiver insists on another place, let its error jump.

    What only the draws need of the filter is let go once they are made: an hour's gains are half a gigabyte.
    """
    jumps = np.zeros((known.t.size, 2))
    lag = float(path[-1, s.LAG])
    task = build(known, options, levels, lag)
    passes = options.passes if known.t.size <= LONG else 1
    for done in range(1, passes + (MORE if options.passes > 0 else 0) + 1):
        path, found = relinearised(task, options, path)
        settled = not (found > jumps).any()
        lag = float(path[-1, s.LAG])
        known = headed(known, path[:, s.YAW1].copy(), path[:, s.YAW2].copy())
        jumps = np.maximum(jumps, found)
        task = build(known, options, levels, lag)
        task = replace(task, inject=task.inject + jumps)
        if done >= passes and settled:
            break
    filtered, smooth = solve(task, options, path)
    filtered = replace(filtered, x=filtered.x[-1:].copy())
    count = options.draws if known.t.size <= LONG else max(options.draws // 4, 1)
    when, error = posterior_errors(task, filtered, smooth.x, count, options.seed)
    light = replace(filtered, P=filtered.P[-1:].copy(), H=filtered.H[:0].copy(), K=filtered.K[:0].copy())
    return Settled(task, light, smooth, when, error, int((jumps[:, 0] > 0.0).sum()))


def relinearised(task: Problem, options: FusionSettings, path: Floats) -> tuple[Floats, Floats]:
    """The smoothed path about a path, and the jumps to allow; what the filter stored is let go at once."""
    filtered, smooth = solve(task, options, path)
    return smooth.x, insisting(task, filtered)


def insisting(task: Problem, f: Filtered) -> Floats:
    """Variance (N, 2) for jumps of the positions' slow errors (fixed, others): where and by how much they were refused
    on end.

    A receiver that stays away for REFUSED_RUN seconds has resolved its ambiguities anew; a shorter excursion
    stays refused.
    """
    out = np.zeros((task.t.size, 2))
    for column, kind in enumerate((s.FIXED_X, s.FLOAT_X)):
        m = np.flatnonzero(task.measurements.kind == kind)
        node, refused = task.measurements.node[m], ~f.used[m]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], refused.astype(np.int8), [0]])))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if (node[b - 1] - node[a]) * STEP < REFUSED_RUN:
                continue
            size = float(np.median(f.nu[m[a:b]] ** 2 + f.nu[m[a:b] + 1] ** 2))
            out[node[a], column] = size
            if b < node.size:
                out[node[b], column] = size
    return out
