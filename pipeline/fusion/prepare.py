"""From sensor streams to the inputs of the filter: mean rates and forces of both bodies on one regular grid."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, filtfilt, savgol_filter, welch

from ...sensors.manifest import GRAVITY, Imd
from ...sensors.mounting import to_body
from ...sensors.streams import FieldLog, ImuStream

Floats = NDArray[np.float64]

STEP = 0.02  # s: the grid of the results
HALF = 0.5 * STEP
FEWEST = 10  # samples of a unit that is used
STILL_RATE = 0.02  # rad/s: engine vibration stays below, travel over a field does not
STILL_WINDOW = 50  # nodes, 1 s
STILL_MARGIN = 20  # nodes left out at both ends of a rest: clocks and GNSS smoothing
TILT_CROSSOVER_HZ = 0.03  # accelerometers below, gyros above, for the seeder's tilt


@dataclass(frozen=True)
class UnitMeans:
    """One inertial unit on the grid, body axes: means over steps (N-1) and about nodes (N), (.., 3) each.

    gap : (N-1,) s, longest hole of the samples inside or across a step beyond 1.5 nominal periods
    gyro_noise, accel_noise : (3,) rad/s/sqrt(Hz), m/s²/sqrt(Hz) in motion; source : where they came from
    """

    step_rate: Floats
    node_rate: Floats
    step_force: Floats
    node_force: Floats
    gap: Floats
    gyro_noise: Floats
    accel_noise: Floats
    source: str


@dataclass(frozen=True)
class BodyInputs:
    """What a body's units say together at one point of it; the same shapes as `UnitMeans`, lever arms removed."""

    step_rate: Floats
    node_rate: Floats
    step_force: Floats
    node_force: Floats
    gap: Floats
    gyro_noise: float
    accel_noise: float
    noise: Mapping[str, Mapping[str, Any]]


def grid(log: FieldLog) -> Floats:
    """Regular 1/50 s grid (whole multiples, UTC) inside the span of the tractor's inertial units."""
    spans = [
        (s.t[0], s.t[-1])
        for name, s in log.of_type(ImuStream).items()
        if log.manifest.of_kind("imd")[name].body == "tractor"
    ]
    first = math.ceil(min(a for a, _ in spans) / STEP + 1.0)
    last = math.floor(max(b for _, b in spans) / STEP - 1.0)
    return np.arange(first, last + 1, dtype=np.float64) * STEP


def unit_means(
    stream: ImuStream, sensor: Imd, t: Floats, still: NDArray[np.bool_] | None = None
) -> UnitMeans:
    """Means of one unit on the grid `t` from the running integral of its samples (exact for lost samples)."""
    force, rate = to_body(stream, sensor)
    halves = _halves(t)
    edges = np.concatenate([halves[:1], np.column_stack([t, halves[1:]]).ravel()])
    sums = np.column_stack([_running_integral(stream.t, v, edges) for v in (*rate.T, *force.T)])
    at_nodes, at_halves = sums[1::2], sums[0::2]
    step = np.diff(at_nodes, axis=0) / STEP
    node = np.diff(at_halves, axis=0) / STEP
    gyro, accel, source = unit_noise(stream, sensor, force, rate, t, still)
    return UnitMeans(
        step[:, :3],
        node[:, :3],
        step[:, 3:],
        node[:, 3:],
        _holes(stream.t, sensor.rate, t),
        gyro,
        accel,
        source,
    )


def node_rates(log: FieldLog, body: str, t: Floats) -> Floats:
    """Angular velocity (N, 3), rad/s, about each node, the mean of a body's units; before their noise is known."""
    imd = log.manifest.of_kind("imd")
    units = [
        np.column_stack([
            np.diff(_running_integral(stream.t, v, _halves(t))) / STEP for v in to_body(stream, imd[name])[1].T
        ])
        for name, stream in log.of_type(ImuStream).items()
        if imd[name].body == body and stream.t.size >= FEWEST
    ]  # fmt: skip
    return np.asarray(np.mean(units, axis=0))


def _halves(t: Floats) -> Floats:
    """The ends (N + 1,) of the intervals about the nodes t (N,)."""
    return np.concatenate([[t[0] - HALF], t + HALF])


def _running_integral(t: Floats, v: Floats, at: Floats) -> Floats:
    """Trapezoidal integral of samples v(t) from t[0] to each of `at`; ends are held."""
    total = np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t))])
    i = np.clip(np.searchsorted(t, at, side="right") - 1, 0, t.size - 2)
    w = at - t[i]
    slope = (v[i + 1] - v[i]) / (t[i + 1] - t[i])
    inside = total[i] + v[i] * w + 0.5 * slope * w * w
    before, after = at < t[0], at > t[-1]
    inside[before] = v[0] * (at[before] - t[0])
    inside[after] = total[-1] + v[-1] * (at[after] - t[-1])
    return np.asarray(inside)


def _holes(samples: Floats, rate: float, t: Floats) -> Floats:
    """For each step the length (s) of the longest hole that overlaps it, beyond 1.5 nominal periods."""
    nominal = max(1.0 / rate, float(np.median(np.diff(samples))))
    holes = np.zeros(t.size - 1)
    gaps = np.diff(samples)
    for i in np.flatnonzero(gaps > 1.5 * nominal):
        a, b = np.searchsorted(t, samples[i], side="right") - 1, np.searchsorted(t, samples[i + 1])
        view = holes[max(a, 0) : max(b, 0)]
        np.maximum(view, gaps[i] - nominal, out=view)
    holes[: np.searchsorted(t, samples[0])] = max(samples[0] - t[0], 0.0)
    holes[np.searchsorted(t, samples[-1]) :] = max(t[-1] - samples[-1], 0.0)
    return holes


def unit_noise(
    stream: ImuStream, sensor: Imd, force: Floats, rate: Floats, t: Floats, still: NDArray[np.bool_] | None
) -> tuple[Floats, Floats, str]:
    """White noise densities (3,), (3,) of a unit in motion, and their source.

    The floor of the spectrum above 8 Hz, where a field machine's rigid-body rotation has died away: the lowest
    of three bands, so that one band with an engine order does not count; never below what the manifest states.
    """
    fs = 1.0 / float(np.median(np.diff(stream.t)))
    moving = np.ones(stream.t.size, dtype=bool)
    if still is not None and not still.all():
        moving = np.interp(stream.t, t, still.astype(float)) < 0.5
    floors = []
    for v in (rate, force):
        use = v[moving] if moving.sum() >= 64 else v
        f, power = welch(use, fs, nperseg=min(256, use.shape[0]), axis=0)
        bands = [(f >= lo * fs) & (f < hi * fs) for lo, hi in ((0.08, 0.16), (0.16, 0.30), (0.30, 0.45))]
        floors.append(np.sqrt(0.5 * np.min([np.median(power[b], axis=0) for b in bands if b.any()], axis=0)))
    stated_gyro, stated_accel = sensor.gyro_noise or 0.0, sensor.accel_noise or 0.0
    gyro = np.maximum(floors[0], max(stated_gyro, 1e-5))
    accel = np.maximum(floors[1], max(stated_accel, 1e-3))
    manifest = stated_gyro > 0.0 and (gyro <= stated_gyro).all()
    return gyro, accel, "manifest" if manifest else "spectral floor in motion"


def body_inputs(log: FieldLog, body: str, point: Floats, t: Floats, still: NDArray[np.bool_]) -> BodyInputs:
    """All units of one body as one, at `point` (body frame, from its CoM), weighted by their noise.

    Units differ by constant biases: each is first brought to the first unit's mean, so that a hole in one does
    not step the mean. Angular acceleration for the lever arms is the slope of the mean rate over 0.1 s.
    """
    units, levers, noise = [], [], {}
    for name, stream in log.of_type(ImuStream).items():
        sensor = log.manifest.of_kind("imd")[name]
        if sensor.body != body or stream.t.size < FEWEST:
            continue
        unit = unit_means(stream, sensor, t, still)
        units.append(unit)
        levers.append(point - np.asarray(sensor.position))
        noise[name] = {
            "gyro": {"value": float(unit.gyro_noise[2]), "unit": "rad/s/sqrt(Hz)", "source": unit.source},
            "accel": {"value": float(unit.accel_noise[1]), "unit": "m/s2/sqrt(Hz)", "source": unit.source},
        }
    weights = np.array([1.0 / u.gyro_noise[2] ** 2 for u in units])
    force_weights = np.array([1.0 / u.accel_noise[1] ** 2 for u in units])
    rate_step, gap = _mean([u.step_rate for u in units], weights, [u.gap for u in units])
    rate_node, _ = _mean([u.node_rate for u in units], weights, [_node_gap(u.gap) for u in units])
    alpha = savgol_filter(rate_node, 5, 2, deriv=1, delta=STEP, axis=0)
    alpha_step = 0.5 * (alpha[1:] + alpha[:-1])
    moved_step = [u.step_force + _lever(rate_step, alpha_step, r) for u, r in zip(units, levers, strict=True)]
    moved_node = [u.node_force + _lever(rate_node, alpha, r) for u, r in zip(units, levers, strict=True)]
    force_step, _ = _mean(moved_step, force_weights, [u.gap for u in units])
    force_node, _ = _mean(moved_node, force_weights, [_node_gap(u.gap) for u in units])
    gyro = 1.0 / math.sqrt(weights.sum())
    accel = 1.0 / math.sqrt(force_weights.sum())
    return BodyInputs(rate_step, rate_node, force_step, force_node, gap, gyro, accel, noise)


def _node_gap(gap: Floats) -> Floats:
    return np.asarray(np.maximum(np.concatenate([[gap[0]], gap]), np.concatenate([gap, [gap[-1]]])))


def _mean(values: list[Floats], weights: Floats, gaps: list[Floats]) -> tuple[Floats, Floats]:
    """Weighted mean of units, leaving out those in a hole while another is whole; and the gap that remains."""
    common = np.median(np.stack(values), axis=0) if len(values) > 2 else values[0]
    level = [v + np.mean(common - v, axis=0) for v in values]
    mean_level = np.average([v.mean(axis=0) for v in values], axis=0, weights=weights)
    w = np.stack([weights[i] * np.where(gaps[i] > 0.0, 1e-6, 1.0) for i in range(len(values))])
    total = sum(w[i][:, None] * level[i] for i in range(len(values))) / w.sum(axis=0)[:, None]
    return np.asarray(total + (mean_level - level[0].mean(axis=0))), np.min(np.stack(gaps), axis=0)


def _lever(rate: Floats, alpha: Floats, r: Floats) -> Floats:
    """Acceleration of a point at r from the unit, relative to it: alpha × r + omega × (omega × r)."""
    return np.cross(alpha, r) + np.cross(rate, np.cross(rate, r))


def standing(rate: Floats, speed: Floats, spin: Floats | None) -> NDArray[np.bool_]:
    """Nodes where the machine stands: gyros quiet over 1 s, and GNSS or wheels agree.

    rate : (N, 3) rad/s; speed : (N,) m/s from GNSS, NaN where unknown; spin : (N,) rad/s of a wheel, or None
    """
    quiet = np.ones(rate.shape[0], dtype=bool)
    window = np.ones(STILL_WINDOW) / STILL_WINDOW
    for w in rate.T:
        mean = np.convolve(w, window, mode="same")
        spread = np.sqrt(np.maximum(np.convolve(w * w, window, mode="same") - mean * mean, 0.0))
        quiet &= spread < STILL_RATE
    slow = np.where(np.isnan(speed), spin is not None, speed < 0.10)
    if spin is not None:
        slow &= np.abs(spin) < 0.05
    return _eroded(quiet & slow)


def _eroded(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Runs of True shortened by STILL_MARGIN at both ends (not at the ends of the record)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    out = np.zeros_like(mask)
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        a = a + STILL_MARGIN if a > 0 else a
        b = b - STILL_MARGIN if b < mask.size else b
        if b - a > STILL_WINDOW // 2:
            out[a:b] = True
    return out


def tilt(rate: Floats, force: Floats, speed: Floats, still: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Roll and pitch (N,), rad, of a body from its own unit at its axle: gyros fast, accelerometers slow.

    Zero-phase complementary filter; the turn couples roll and pitch (roll' = p + yaw'·pitch), which a second
    sweep takes in. The motion's own accelerations V' and V·yaw' are removed before levelling.
    """
    bias = (
        rate[still].mean(axis=0) if still.sum() > STILL_WINDOW else np.array([*rate[:, :2].mean(axis=0), 0.0])
    )
    w = rate - bias
    b, a = butter(1, TILT_CROSSOVER_HZ, fs=1.0 / STEP)
    pad = min(int(2.0 / TILT_CROSSOVER_HZ / STEP), rate.shape[0] - 2)
    smooth = savgol_filter(speed, min(51, speed.size - 1 + speed.size % 2), 2)
    level_roll = np.arcsin(np.clip((force[:, 1] - speed * w[:, 2]) / GRAVITY, -0.5, 0.5))
    level_pitch = np.arcsin(np.clip((np.gradient(smooth, STEP) - force[:, 0]) / GRAVITY, -0.5, 0.5))
    roll, pitch = np.zeros(speed.size), np.zeros(speed.size)
    for _ in range(3):
        fast_roll = np.cumsum(w[:, 0] + w[:, 2] * pitch) * STEP
        fast_pitch = np.cumsum(w[:, 1] - w[:, 2] * roll) * STEP
        roll = fast_roll + filtfilt(b, a, level_roll - fast_roll, padlen=pad)
        pitch = fast_pitch + filtfilt(b, a, level_pitch - fast_pitch, padlen=pad)
    return roll, pitch


def resolved_yaw_rate(rate: Floats, roll: Floats, pitch: Floats) -> Floats:
    """Yaw rate (N,) about the vertical of a tilted body: (q sin roll + r cos roll)/cos pitch."""
    return np.asarray((rate[:, 1] * np.sin(roll) + rate[:, 2] * np.cos(roll)) / np.cos(pitch))
