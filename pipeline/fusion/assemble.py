"""From the last sweep to `Motion`: centres of mass in UTC, draws, steering, consistency, calibration, warnings."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ...sensors.streams import Warn
from ..wheels import WheelMotion, choose_steer_input
from . import output
from . import state as s
from .consistency import assess, innovations
from .engine_compiled import Filtered, Smoothed
from .filtering import unpack
from .known import Known
from .motion import Motion, SteerInput
from .prepare import STEP
from .problem import Problem
from .settings import FusionSettings, Levels
from .steering import Steering, best_steering
from .unseen import cross_slope, doubt_of, modes_of

Floats = NDArray[np.float64]

ZERO_FAR = 4.0  # stated standard deviations of a steering sensor's zero, beyond which its reader is told
OUTAGE = 2.0  # s without an accepted position that is worth a warning


@dataclass(frozen=True)
class Settled:
    """The last sweep: problem, filter (of its covariances the last alone), smoother, draws of the KEPT components'
    error at instants `draw_t` (inertial time), and how often the receiver jumped for good."""

    task: Problem
    filtered: Filtered
    smooth: Smoothed
    draw_t: Floats
    errors: Floats
    jumps: int


def assemble(
    known: Known,
    options: FusionSettings,
    levels: Levels,
    free: tuple[str, ...],
    settled: Settled,
    wheels: Mapping[str, WheelMotion],
) -> Motion:
    """The pass's `Motion` from the last filter and smoother."""
    task, filtered, smooth, jumps = settled.task, settled.filtered, settled.smooth, settled.jumps
    lag = float(smooth.x[-1, s.LAG])
    t = output.utc_grid(known.t, lag)
    p = task.parameters
    tilt2 = (known.nodes[:, s.N_ROLL2], known.nodes[:, s.N_PITCH2])
    at = output.at_utc(known.t, t, lag, smooth.x, smooth.P, tilt2)
    lateral1, lateral2 = (np.interp(t + lag, known.t, a) for a in lateral_accelerations(known, smooth.x))
    doubt, slopes = doubt_of(known, task, levels, smooth), cross_slope(smooth)
    slope = np.interp(t + lag, known.t, slopes)
    modes = modes_of(at, p, doubt, slope)
    tractor = output.tractor_motion(at, p, modes, lateral1)
    seeder = output.seeder_motion(at, p, modes, lateral2) if known.two is not None else None
    draw_t = settled.draw_t - lag
    every = output.at_utc(known.t, draw_t, lag, smooth.x, smooth.P, tilt2)
    modes = modes_of(every, p, doubt, np.interp(settled.draw_t, known.t, slopes))
    rng = np.random.default_rng(options.seed + 1)
    draws = output.body_draws(settled.errors, every, p, known.two is not None, modes, rng)
    given = choose_steer_input(known.log, t + lag, wheels)
    bend = tractor.yaw - seeder.yaw if seeder is not None else np.zeros(t.size)
    front = known.log.manifest.machine.tractor.front_axle
    tilted = (slope, np.full(t.size, doubt.slope))
    best = best_steering(t, tractor, given, front, levels.beta1, bend, tilted)
    given, told = with_honest_zero(given, best.angle)
    consistency = assess(task.measurements, filtered)
    gnss_t = accepted_times(task, filtered)
    return Motion(
        t=t, origin=known.origin, tractor=tractor, seeder=seeder, steer=best.angle, sd_steer=best.sd, steer_input=given,
        draw_t=draw_t, draws=draws, gnss_t=gnss_t, consistency=consistency,
        consistent=all(c.consistent for c in consistency), noise=noise_table(known, levels, free, p) | front_slip(best),
        calibration=calibration(smooth.x[-1], filtered.P[-1], int(p[s.P_ACTIVE]), known, wheels),
        innovations=innovations(task.measurements, filtered, known.t - lag),
        warnings=warnings_of(known, gnss_t, t, consistency, jumps, wheels) + told,
    )  # fmt: skip


def lateral_accelerations(known: Known, x: Floats) -> tuple[Floats, Floats]:
    """Lateral acceleration (N,), m/s², of both CoMs: the units' force levelled and moved there; zeros if absent."""
    one = _levelled_lateral(known.one.node_force, x[:, s.ROLL], x[:, s.BAY])
    one = one + known.log.manifest.machine.tractor.rear_axle * _slope(known.nodes[:, s.U_WZ])
    if known.two is None or known.log.manifest.machine.seeder is None:
        return one, np.zeros(known.t.size)
    two = _levelled_lateral(known.two.node_force, known.nodes[:, s.N_ROLL2], 0.0)
    axle = float(np.mean(known.log.manifest.machine.seeder.axles))
    return one, two + axle * _slope(known.nodes[:, s.U_W2])


def _levelled_lateral(force: Floats, roll: Floats, bias: Floats | float) -> Floats:
    return np.asarray(np.cos(roll) * (force[:, 1] - bias) - np.sin(roll) * force[:, 2])


def _slope(rate: Floats) -> Floats:
    return np.asarray(savgol_filter(rate, 5, 2, deriv=1, delta=STEP))


def accepted_times(task: Problem, f: Filtered) -> Floats:
    """UTC of the accepted positions of the main receiver, s."""
    q = task.measurements
    m = np.flatnonzero(((q.kind == s.FIXED_X) | (q.kind == s.FLOAT_X)) & f.used)
    return np.asarray(np.unique(task.t[0] + q.node[m] * STEP + q.ahead[m]))


def calibration(
    x: Floats, packed: Floats, count: int, known: Known, wheels: Mapping[str, WheelMotion]
) -> dict[str, Any]:
    """Estimated constants with standard deviations at the end of the pass."""
    P = np.zeros((s.SIZE, s.SIZE))
    unpack(packed, P, count)
    units = {
        "lag": (s.LAG, "s"), "gyro_bias_x": (s.BGX, "rad/s"), "gyro_bias_y": (s.BGY, "rad/s"),
        "gyro_bias_z": (s.BGZ, "rad/s"), "accel_bias_x": (s.BAX, "m/s2"), "accel_bias_y": (s.BAY, "m/s2"),
    }  # fmt: skip
    units["gyro_scale"] = (s.SCALE1, "1")
    if known.two is not None:
        units["gyro_bias_z_seeder"], units["gyro_scale_seeder"] = (s.BGZ2, "rad/s"), (s.SCALE2, "1")
    if known.wheel is not None:
        units["wheel_scale"] = (s.KAPPA, "1")
    out: dict[str, Any] = {
        name: {"value": float(x[i]), "sd": float(np.sqrt(max(P[i, i], 0.0))), "unit": unit}
        for name, (i, unit) in units.items()
    }
    for name, wheel in wheels.items():
        out[name] = {key: {"value": v, "sd": sd} for key, (v, sd) in wheel.calibration.items()}
    return out


def noise_table(known: Known, levels: Levels, free: tuple[str, ...], p: Floats) -> dict[str, dict[str, Any]]:
    """Every noise figure with its source."""
    table: dict[str, dict[str, Any]] = {name: dict(v) for name, v in known.one.noise.items()}
    if known.two is not None:
        table |= {name: dict(v) for name, v in known.two.noise.items()}
    if known.wheel is not None:
        table |= {name: dict(v) for name, v in known.wheel.noise.items()}
    for e in known.epochs:
        table[e.name] = {
            "position": {
                "value": float(np.median(e.sd)), "unit": "m",
                "source": "receiver (GST)" if e.stated else "assumed by fix quality",
            },
            "slow_part": {"value": float(p[s.P_SD_E if e.first else s.P_SD_G]), "unit": "m", "source": "not white"},
        }  # fmt: skip
    magnetometers(known, table)
    table["levels"] = {
        name: {"value": float(getattr(levels, name)), "source": "innovations" if name in free else "assumed"}
        for name in (
            "beta1",
            "beta2",
            "white_fixed",
            "white_float",
            "velocity",
            "lateral",
            "hitch",
            "forward",
            "wheel",
        )
    }
    return table


def magnetometers(known: Known, table: dict[str, dict[str, Any]]) -> None:
    """Every magnetometer into the noise table, in place: the deviation of its readings, or why it is not used."""
    for name, (reason, sd) in known.magnetic.items():
        told: dict[str, Any] = {"source": f"not used: {reason}"}
        if not reason:
            told = {"value": sd, "unit": "rad", "source": "consistent with the smoothed yaw"}
        table[name] = table.get(name, {}) | {"magnetometer": told}


def front_slip(best: Steering) -> dict[str, dict[str, Any]]:
    """The front wheels' slip that the best steering angle was made with, and its source."""
    source = "innovations" if best.learnt else "assumed: twice the rear wheels'"
    return {"front_wheels": {"slip": {"value": best.slip, "unit": "rad", "source": source}}}


def with_honest_zero(given: SteerInput | None, steer: Floats) -> tuple[SteerInput | None, tuple[Warn, ...]]:
    """The replay's steering, its zero's doubt widened where a sensor's zero lies beyond what is stated, and a warning.

    steer : (N,) best estimate, rad. The angle itself is left alone, so the body's path never steers the replay;
    a model is then not condemned for a sensor's zero.
    """
    both = np.isfinite(given.angle) & np.isfinite(steer) if given is not None else np.zeros(0, dtype=np.bool_)
    if given is None or given.source != "sensor" or not both.any():
        return given, ()
    zero = float(np.median((given.angle - steer)[both]))
    if abs(zero) <= ZERO_FAR * given.zero_sd:
        return given, ()
    told = f"the sensor's zero is {math.degrees(zero):.1f}° off, its stated doubt is {math.degrees(given.zero_sd):.1f}°"
    warn = Warn(told, "its doubt is taken as that large: mend steer.csv or state zero_sd_deg", "steer")
    return replace(given, zero_sd=abs(zero)), (warn,)


def warnings_of(
    known: Known,
    gnss_t: Floats,
    t: Floats,
    consistency: tuple[Any, ...],
    jumps: int,
    wheels: Mapping[str, WheelMotion],
) -> tuple[Warn, ...]:
    """What a reader must know of this pass's fusion."""
    out: list[Warn] = [w for wheel in wheels.values() for w in wheel.warnings]
    main = known.epochs[0]
    if not main.stated:
        out.append(
            Warn("the receiver states no accuracy (GST)", "assumed by fix quality and HDOP", main.name)
        )
    loose = float((~main.fixed).mean())
    if loose > 0.01:
        out.append(
            Warn(
                f"{100 * loose:.0f} % of the positions are not RTK fixed",
                "weighted by their own doubt",
                main.name,
            )
        )
    edges = np.concatenate([[t[0]], gnss_t, [t[-1]]])
    longest = float(np.diff(edges).max())
    if longest > OUTAGE:
        out.append(
            Warn(
                f"{longest:.1f} s without a position",
                "bridged by gyros and wheels, with growing doubt",
                main.name,
            )
        )
    if jumps:
        out.append(
            Warn(
                f"fixed positions jumped {jumps} times", "taken as new slow errors of the receiver", main.name
            )
        )
    if known.bias is None:
        out.append(Warn("no rest in the pass", "gyro biases rest on course over ground alone"))
    bad = [c.channel for c in consistency if not c.consistent]
    if bad:
        out.append(
            Warn(
                "innovations are not what the filter states: " + ", ".join(bad), "the verdict's guard widens"
            )
        )
    return tuple(out)
