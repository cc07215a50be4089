"""What is known of a pass before the filter runs, and the estimation problem made of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ...sensors.manifest import GRAVITY
from ...sensors.streams import FieldLog
from ..wheels import WheelMotion
from . import initial, problem
from . import settings as physics
from . import state as s
from .epochs import Epochs
from .ground import Leaning, Slope, ground_slope, leaning
from .motion import Origin
from .offsets import Reading, along, offset_sd, risen, upwards
from .prepare import STEP, BodyInputs, body_inputs, grid, node_rates, resolved_yaw_rate, standing, tilt
from .problem import Part, Problem
from .rolling import WheelSpeed, forwards_of, wheel_speed
from .settings import FusionSettings, Levels

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

CREEP = 0.5  # m/s
LONG = 60_000  # nodes: longer passes get a quarter of the draws and one relinearisation, which a steady row needs least
SHORTEST = 100  # nodes: 2 s
FLOAT_PAUSE = 5.0  # s between spans that are not fixed: a new span has a new error


class FusionError(ValueError):
    """A pass that cannot be fused; one line: what, where, how to mend."""


@dataclass(frozen=True)
class Known:
    """What is known of a pass before and between the sweeps: both bodies on the grid, receivers, wheels, rest.

    speed : (N,) m/s over ground, NaN where unknown; forwards : (N,) 1 or -1; yaw : approximate, (N,) each;
    bias : (4,) mean gyro readings at rest (tractor x, y, z, seeder z), None without a rest
    offset : m/s², deviation of an accelerometer's horizontal offset where the manifest states none
    slope, ground : the ground's slope at those headings, and measurements of it; neither levels nor the clocks' lag
    change them
    azimuths : kind, nodes, rad, variance of magnetometers that prove consistent; magnetic : of each magnetometer why it
    is not used ("" where it is), and the deviation of a reading, rad
    """

    log: FieldLog
    origin: Origin
    t: Floats
    one: BodyInputs
    two: BodyInputs | None
    epochs: tuple[Epochs, ...]
    still: Bools
    wheel: WheelSpeed | None
    speed: Floats
    forwards: Floats
    steps: Floats = field(default_factory=lambda: np.empty((0, s.U_SIZE)))
    nodes: Floats = field(default_factory=lambda: np.empty((0, s.N_SIZE)))
    yaw: tuple[Floats, Floats] = field(default_factory=lambda: (np.empty(0), np.empty(0)))
    bias: Floats | None = None
    slope: Slope = field(default_factory=lambda: Slope(np.zeros(2), *[np.zeros((2, 2))] * 3))
    ground: tuple[Part, ...] = ()
    offset: float = physics.ACCEL_BIAS
    azimuths: tuple[tuple[int, Ints, Floats, float], ...] = ()
    magnetic: Mapping[str, tuple[str, float]] = field(default_factory=dict)


def lag_sd(log: FieldLog) -> float:
    """Standard deviation of the clocks' lag, s: what the receivers' latency is known to."""
    return max(float(g.latency_sd) for g in log.manifest.of_kind("gps").values())


def prepare(log: FieldLog, wheels: Mapping[str, WheelMotion]) -> Known:
    """Streams on the grid, rest, first headings. Raises FusionError when there is too little of anything."""
    t = grid(log)
    if t.size < SHORTEST:
        raise FusionError(
            f"{log.source or log.manifest.run.id}: inertial samples of the tractor span under 2 s"
        )
    try:
        origin = problem.origin_of(log)
    except ValueError as error:
        raise FusionError(str(error)) from None
    epochs = tuple(problem.epochs_of(log, origin))
    if not any(e.first and e.t.size >= 10 for e in epochs):
        raise FusionError(
            "gps: fewer than 10 positions of a receiver on the tractor; check the receiver's log"
        )
    machine = log.manifest.machine
    point = np.array([-machine.tractor.rear_axle, 0.0, -problem.sway(machine.tractor)])
    speed = initial.ground_speed(t, epochs[0])
    spin = _mean_spin(t, wheels)
    rates = node_rates(log, "tractor", t)
    still = standing(rates, initial.resting_speed(t, epochs[0], speed), spin)
    one = body_inputs(log, "tractor", point, t, still)
    two = None
    if machine.seeder is not None:
        axle = np.array([-float(np.mean(machine.seeder.axles)), 0.0, 0.0])
        two = body_inputs(log, "seeder", axle, t, still)
    forwards = forwards_of(t, spin, log)
    fixed = bool(np.mean(epochs[0].fixed) > 0.5)
    wheel = wheel_speed(t, wheels, log, one.node_rate[:, 2], forwards, fixed)
    return _aligned(Known(log, origin, t, one, two, epochs, still, wheel, speed, forwards), forwards)


def _mean_spin(t: Floats, wheels: Mapping[str, WheelMotion]) -> Floats | None:
    """Mean spin of all wheels with a unit on the grid, rad/s; None without one."""
    spins = [np.interp(t, w.t, w.spin) for w in wheels.values()]
    return np.mean(spins, axis=0) if spins else None


def _aligned(known: Known, forwards: Floats) -> Known:
    """First headings of both bodies from course and turn, and the seeder's yaw rate with its tilt still unknown."""
    speed = np.nan_to_num(known.speed) * forwards
    known = _with_seeder(known, speed)
    bias = None
    if known.still.sum() > 25:
        bias = known.nodes[known.still][:, [s.U_WX, s.U_WY, s.U_WZ, s.U_W2]].mean(axis=0)
    level = bias if bias is not None else np.zeros(4)
    turned = [
        np.concatenate([[0.0], np.cumsum((known.steps[:, column] - level[i]) * STEP)])
        for column, i in ((s.U_WZ, 2), (s.U_W2, 3))
    ]
    first = [initial.heading_offset(known.t, turn, known.epochs[0], forwards) for turn in turned]
    # each is a circular mean of its own: heading due west, one may come out at +π and the other at -π
    first[1] += 2.0 * math.pi * round((first[0] - first[1]) / (2.0 * math.pi))
    return headed(replace(known, bias=bias), first[0] + turned[0], first[1] + turned[1])


def _with_seeder(known: Known, speed: Floats) -> Known:
    """Inputs with the seeder's yaw rate about the vertical, its tilt levelled with `speed` (N,) m/s."""
    zero = np.zeros(known.t.size)
    roll2, pitch2, rate_node, rate_step, gap = zero, zero, None, None, None
    if known.two is not None:
        two = known.two
        roll2, pitch2 = tilt(two.node_rate, two.node_force, speed, known.still)
        rate_node = resolved_yaw_rate(two.node_rate, roll2, pitch2)
        rate_step = resolved_yaw_rate(two.step_rate, _halfway(roll2), _halfway(pitch2))
        gap = two.gap
    return replace(
        known,
        steps=problem.inputs_of(known.one, rate_step, gap, known.still, known.wheel),
        nodes=problem.nodes_of(known.one, rate_node, roll2, pitch2),
    )


def _halfway(v: Floats) -> Floats:
    return np.asarray(0.5 * (v[1:] + v[:-1]))


def levelled(known: Known, path: Floats) -> Known:
    """The seeder's tilt and both headings again, now that the speed is known: path (N, SIZE)."""
    return headed(_with_seeder(known, path[:, s.V]), path[:, s.YAW1].copy(), path[:, s.YAW2].copy())


def headed(known: Known, yaw1: Floats, yaw2: Floats) -> Known:
    """At other headings (N,) of tractor and seeder, and the ground's slope as the sensors read it along them."""
    known = replace(known, yaw=(yaw1, yaw2))
    known = replace(known, offset=offset_sd(offset_readings(known)))
    main = next(e for e in known.epochs if e.first)
    slope = ground_slope(main, leanings(known))
    return replace(known, slope=slope, ground=problem.ground_parts(known.t, main, yaw1, slope, way_of(known)))


def build(known: Known, options: FusionSettings, levels: Levels, lag: float) -> Problem:
    """The estimation problem at given levels, its GNSS epochs placed by `lag`."""
    p = parameters(known, options, levels)
    q = problem.measurements_of(
        known.t,
        known.epochs,
        known.nodes,
        known.still,
        known.wheel,
        levels,
        p,
        lag,
        known.yaw,
        creeping(known),
        known.ground,
    )
    q = problem.with_azimuths(q, known.azimuths, lag)
    x0, P0 = start_of(known, p, lag)
    return Problem(known.t, known.steps, known.nodes, q, new_float_spans(known, lag, p), p, x0, P0)


def parameters(known: Known, options: FusionSettings, levels: Levels) -> Floats:
    """Parameter vector of the kernels at given levels."""
    p = problem.parameters_of(known.log.manifest, known.epochs, known.one, known.two)
    p = problem.with_levels(p, levels, known.epochs)
    if known.azimuths:
        p[s.P_ACTIVE] = max(p[s.P_ACTIVE], s.SEEDER_HEADING + 1)
    p[s.P_TILT] = 1.0 if options.tilt_compensation else 0.0
    return p


def start_of(known: Known, p: Floats, lag: float) -> tuple[Floats, Floats]:
    """State (SIZE,) at the first node and its covariance, with what is known of this pass's sensors."""
    x0, P0 = problem.starting_state(
        known.log.manifest, p, initial.first_position(known.epochs, known.t[0]),
        (float(known.yaw[0][0]), float(known.yaw[1][0])), float(np.nan_to_num(known.speed[0]) * known.forwards[0]),
        lag_sd(known.log), known.nodes, known.bias,
    )  # fmt: skip
    x0[s.LAG] = lag
    P0[s.BAX, s.BAX] = P0[s.BAY, s.BAY] = (mean_offset(known, "tractor") or known.offset) ** 2
    for kind, *_ in known.azimuths:
        constant = s.HEADING if kind == s.MAGNETIC1 else s.SEEDER_HEADING
        P0[constant, constant] = problem.AZIMUTH_FREE**2
    if known.wheel is not None:
        P0[s.KAPPA, s.KAPPA] = known.wheel.scale_sd**2
    return x0, P0


def way_of(known: Known) -> Floats:
    """Distance (N,) along the heading, m: it stands while the machine creeps or rests, and falls backwards."""
    seen = np.isfinite(known.speed)
    if not seen.any():
        return np.zeros(known.t.size)
    speed = np.interp(known.t, known.t[seen], known.speed[seen])
    return np.asarray(np.cumsum(np.where(speed > CREEP, speed, 0.0) * known.forwards) * STEP)


def mean_offset(known: Known, body: str) -> float | None:
    """Standard deviation of the constant error of a body's accelerometers across, the mean of its units, m/s²; None
    without a unit."""
    units = known.log.manifest.of_kind("imd").values()
    own = [u.accel_bias or known.offset for u in units if u.body == body]
    return math.sqrt(sum(b * b for b in own)) / len(own) if own else None


def offset_readings(known: Known) -> list[Reading]:
    """What each body's accelerometers read along and up beyond what they should have."""
    way, rise = way_of(known), risen(known.epochs[0])
    found: list[Reading | None] = []
    for body, inputs in (("tractor", known.one), ("seeder", known.two)):
        units = [u for u in known.log.manifest.of_kind("imd").values() if u.body == body]
        if inputs is not None and not any(u.accel_bias for u in units):
            found.append(upwards(inputs.node_force, len(units)))
            if rise is not None:
                speed = np.nan_to_num(known.speed)
                found.append(along(inputs.node_force[:, 0], way, speed, rise, len(units)))
    return [r for r in found if r is not None]


def leanings(known: Known) -> tuple[Leaning, ...]:
    """What the accelerometers of the tractor, then of the seeder, say of the ground's slope."""
    speed = np.nan_to_num(known.speed) * known.forwards
    turn = known.nodes[:, s.U_WZ] - (0.0 if known.bias is None else known.bias[2])
    across = known.nodes[:, s.U_FY] - speed * turn
    rolls = {"tractor": np.arcsin(np.clip(across / GRAVITY, -0.5, 0.5)), "seeder": known.nodes[:, s.N_ROLL2]}
    found = []
    for body, yaw in zip(rolls, known.yaw, strict=True):
        offset = mean_offset(known, body)
        if offset is not None:
            sd = math.hypot(offset / GRAVITY, physics.LEAN)
            found.append(leaning(yaw, rolls[body], sd, float(known.t[-1] - known.t[0])))
    return tuple(found)


def creeping(known: Known) -> Bools:
    """Nodes slower than CREEP by the wheels, else by the receiver."""
    speed = np.abs(known.speed) if known.wheel is None else np.abs(known.wheel.speed)
    return np.asarray(np.nan_to_num(speed, nan=np.inf) < CREEP)


def new_float_spans(known: Known, lag: float, p: Floats) -> Floats:
    """Variance (N, 2) that starts each new span of positions that are not fixed with a new slow error."""
    inject = np.zeros((known.t.size, 2))
    loose = known.epochs[0].t[~known.epochs[0].fixed]
    starts = loose[1:][np.diff(loose) > FLOAT_PAUSE]
    at = np.rint((starts + lag - known.t[0]) / STEP).astype(np.int64)
    inject[at[(at >= 0) & (at < known.t.size)], 1] = p[s.P_SD_F] ** 2
    return inject
