"""Time of the fusion, side by side in one run: both engines and a plain NumPy loop, on 60, 600 and 3600 s.

    python benchmarks/fusion.py [--lengths 60,600,3600] [--hour]

Prints microseconds a step (one step: 1/50 s with all its measurements) forward and smoothed, ratios to filterpy,
what the wheels' own series take (all four units), and with --hour the whole `fuse` of an hour of nine units at 100 Hz
with its peak memory. The reference engines run on the first minute of each length: they take the same time a step
whatever the length.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable

import numpy as np
from smts_validate.pipeline.fusion import engine_compiled, engine_filterpy, kernels
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.fuse import cut, fuse
from smts_validate.pipeline.fusion.known import build, prepare
from smts_validate.pipeline.fusion.prepare import STEP
from smts_validate.pipeline.fusion.problem import Problem
from smts_validate.pipeline.fusion.settings import FusionSettings, Levels
from smts_validate.pipeline.wheels import WheelMotion, wheel_motions
from smts_validate.sensors.draft_text import MACHINE, SEEDER
from smts_validate.sensors.manifest import parse
from smts_validate.sensors.streams import FieldLog, GnssStream, ImuStream, WheelStream

REFERENCE_STEPS = 400
RUN = """schema = 1
[run]
id = "bench"
date = 2025-05-14
[operating]
speed = 2.5
tyre_pressure_mpa = 0.12
"""


def manifest_text() -> str:
    """Nine units: three IMDs, four WDSs, the receiver, and one more IMD on the tractor."""
    text = RUN + MACHINE + SEEDER
    for i, body in enumerate(("tractor", "tractor", "seeder", "seeder")):
        text += f'[sensors.imd{i}]\nkind = "imd"\nbody = "{body}"\nfile = "{i}"\n'
        text += "position = [0.1, 0.0, 0.0]\nrate = 100.0\n"
    for i, wheel in enumerate(("front_right", "front_left", "rear_right", "rear_left")):
        text += f'[sensors.wds{i}]\nkind = "wds"\nwheel = "{wheel}"\nfile = "w{i}"\nrate = 100.0\n'
    return text + '[sensors.gps]\nkind = "gps"\nfile = "g"\nposition = [0.0, 0.0, 2.1]\nrate = 10.0\n'


def weave(duration: float) -> FieldLog:
    """A log of pure kinematics, weaving about the north at 2.5 m/s after a rest; cheap to make at any length."""
    rng = np.random.default_rng(0)
    t = 1.7e9 + np.arange(0.0, duration, 0.01)
    speed = 2.5 * np.clip((t - t[0] - 5.0) / 3.0, 0.0, 1.0)
    yaw = 1.57 + 0.02 * np.sin(0.8 * (t - t[0])) * (speed > 0.1)
    rate = np.gradient(yaw, 0.01)
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.01, np.cumsum(speed * np.sin(yaw)) * 0.01
    streams: dict[str, ImuStream | WheelStream | GnssStream] = {}
    manifest = parse(manifest_text())
    for name in manifest.of_kind("imd"):
        gyro = np.column_stack([0.0 * t, 0.0 * t, rate]) + rng.normal(size=(t.size, 3)) * 0.004
        force = np.column_stack([np.gradient(speed, 0.01), speed * rate, 0.0 * t + 9.80665])
        streams[name] = ImuStream(name, t, t, force + rng.normal(size=force.shape) * 0.3, gyro)
    for name, wheel in manifest.of_kind("wds").items():
        radius = 0.62 if wheel.wheel.startswith("front") else 0.8
        phase = np.cumsum(speed / radius) * 0.01
        gyro = np.column_stack([-rate * np.sin(phase), speed / radius, rate * np.cos(phase)])
        force = 9.80665 * np.column_stack([-np.sin(phase), 0.0 * t, np.cos(phase)])
        noise = rng.normal(size=(t.size, 6)) * [0.5, 0.5, 0.5, 0.004, 0.004, 0.004]
        streams[name] = WheelStream(name, t, t, force + noise[:, :3], gyro + noise[:, 3:])
    k = np.arange(0, t.size, 10)
    noise = rng.normal(size=(k.size, 2)) * 0.01
    blank = np.full(k.size, np.nan)
    lat = 50.0 + np.degrees((y[k] + noise[:, 1]) / 6.3656e6)
    lon = 36.0 + np.degrees((x[k] + noise[:, 0]) / 6.3907e6 / np.cos(np.radians(50.0)))
    sd = np.full(k.size, 0.014)
    streams["gps"] = GnssStream(
        "gps", t[k], t[k] + 0.1, lat, lon, np.full(k.size, 150.0), np.full(k.size, 4.0), sd, sd, 2 * sd,
        speed[k], yaw[k], blank, blank, blank,
    )  # fmt: skip
    return FieldLog(manifest, manifest_text(), streams)


def problem_of(log: FieldLog, wheels: dict[str, WheelMotion]) -> Problem:
    """The estimation problem of a log at the starting levels."""
    return build(prepare(log, wheels), FusionSettings(), Levels(), 0.0)


def numpy_loop(task: Problem) -> None:
    """The same filter and Rauch-Tung-Striebel smoother as a plain NumPy loop of scalar updates."""
    starts, q = task.measurements.starts(task.t.size), task.measurements
    x, P = task.x0.copy(), task.P0.copy()
    kept = []
    noise = np.empty(s.SIZE)
    for k in range(task.t.size):
        F = np.eye(s.SIZE)
        if k > 0:
            kernels.process_noise(x, task.step_inputs[k - 1], STEP, task.parameters, noise)
            x = kernels.transition(x, task.step_inputs[k - 1], STEP, task.parameters, F)
            P = F @ P @ F.T + np.diag(noise)
        before = (F, x, P)
        for m in range(starts[k], starts[k + 1]):
            H = np.zeros(s.SIZE)
            left = q.z[m] - kernels.predict(q.kind[m], x, task.node_inputs[k], q.ahead[m], task.parameters, H)
            S = float(H @ P @ H) + q.var[m]
            K = P @ H / S
            x, P = x + K * left, P - np.outer(K, K) * S
        kept.append((*before, x, P))
    for (_, _, _, xf, Pf), (F, xp, Pp, _, _) in zip(kept[-2::-1], kept[:0:-1], strict=True):
        G = np.linalg.lstsq(Pp, F @ Pf, rcond=None)[0].T
        x = xf + G @ (x - xp)
        P = Pf + G @ (P - Pp) @ G.T


def compiled(task: Problem) -> None:
    """The default engine, forward and backward."""
    engine_compiled.run_smoother(task, engine_compiled.run_filter(task, None), None)


def reference(task: Problem) -> None:
    """The filterpy engine, forward and backward."""
    engine_filterpy.run_smoother(task, engine_filterpy.run_filter(task, None), None)


def per_step(run: Callable[[Problem], None], task: Problem) -> float:
    """Microseconds a step of the quickest of at least five runs in at least two seconds.

    What else the machine does, and the first touch of memory, only add to them.
    """
    times: list[float] = []
    while len(times) < 5 or sum(times) < 2.0:
        begin = time.perf_counter()
        run(task)
        times.append(time.perf_counter() - begin)
    return min(times) / task.t.size * 1e6


def lengths(seconds: list[float]) -> None:
    """A row a length."""
    print(
        "us a step      compiled   NumPy loop     filterpy   filterpy/compiled   measurements a step   wheels"
    )
    wheel_motions(weave(20.0))  # loads what is compiled
    for duration in seconds:
        log = weave(duration)
        begin = time.perf_counter()
        wheels = wheel_motions(log)
        taken = time.perf_counter() - begin
        task = problem_of(log, wheels)
        start = np.tile(task.x0, (task.t.size, 1))
        start[:, s.V], start[:, s.Y] = 2.5, 0.0
        part = cut(task, 0, REFERENCE_STEPS, start)
        compiled(part)
        rows = per_step(compiled, task), per_step(numpy_loop, part), per_step(reference, part)
        ratio, density = rows[2] / rows[0], task.measurements.kind.size / task.t.size
        print(
            f"{duration:6.0f} s {rows[0]:12.2f} {rows[1]:12.0f} {rows[2]:12.0f} {ratio:16.0f} x {density:14.1f}"
            f" {1e6 * taken / task.t.size:16.1f}"
        )


def hour() -> None:
    """Wall time and peak memory of fusing an hour, tuning and draws included."""
    fuse(weave(60.0))
    log = weave(3600.0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    begin = time.perf_counter()
    fuse(log)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    taken = time.perf_counter() - begin
    print(
        f"an hour of {len(log.streams)} units: {taken:.1f} s, peak {peak:.2f} GiB (of it the log: {before:.2f})"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--lengths", default="60,600")
    parser.add_argument("--hour", action="store_true")
    chosen = parser.parse_args()
    lengths([float(v) for v in chosen.lengths.split(",")])
    if chosen.hour:
        hour()
