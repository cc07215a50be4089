"""Accuracy and honesty of the fusion over seeded twins: errors, and coverage of the stated deviations.

    python benchmarks/accuracy.py [--passes 40] [--workers 2] [--slope 0.03] [--level] [--steering]

Kinds take turns: benign RTK, bad sensors, an outage with float, a headland turn. What the fusion only doubts is drawn
anew for each pass from the doubt that it states (simulation-based calibration, Talts et al. 2018): how steep the field
is, which way it falls, the stiffness of the tyres on it, the crab that stays, how large accelerometers' offsets are,
and by how much antenna and units sit elsewhere than the manifest says. Mounting, the other biases, latency and the
receiver's slow error vary in every twin.
Prints for each kind and for all: median and 95th percentile of the passes' RMSE (cm, degrees), the share of errors
within 1.96 stated deviations, and the mean of (error/deviation) squared. For benign passes also by how much the
tractor's lateral error exceeds the receiver's own error slower than 5 s (root of the difference of squares).
With --steering instead: the best steering angle, and the series that drives the replay about its mean, of the same
passes with a steering sensor and wheel-mounted units, with one of them and with neither. With --slope steeper ground,
with --level ground whose slope tilts both bodies but does not pull them aside.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "pipeline"))

from fusion_samples import KINDS, Sample, changed, errors, make, plan_of, receiver_slow_error, rms
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.twin_machine import STEER_SENSOR
from smts_validate.sensors.streams import FieldLog

STEERED = {
    "steering sensor and wheels": (), "wheels alone": ("steer",), "steering sensor alone": ("wds",),
    "neither": ("steer", "wds"),
}  # fmt: skip


def of_errors(log: FieldLog, of: Sample) -> dict[str, tuple[float, float, float]]:
    """For each quantity the figures of a log's fusion."""
    return {name: figures(e, sd) for name, (e, sd) in errors(fuse(log), of).items()}


def figures(e: np.ndarray, sd: np.ndarray) -> tuple[float, float, float]:
    """RMSE, coverage of 1.96 deviations, mean of (error/deviation) squared."""
    return float(np.sqrt(np.mean(e**2))), float(np.mean(np.abs(e / sd) < 1.96)), float(np.mean((e / sd) ** 2))


def without(log: FieldLog, *kinds: str) -> FieldLog:
    """A log without its sensors of some kinds."""
    sensors = {name: sensor for name, sensor in log.manifest.sensors.items() if sensor.kind not in kinds}
    streams = {name: log.streams[name] for name in sensors if name in log.streams}
    return replace(log, manifest=log.manifest.model_copy(update={"sensors": sensors}), streams=streams)


def steered(log: FieldLog, of: Sample) -> dict[str, tuple[float, float, float]]:
    """The best steering angle, and the series that drives the replay about its mean (its zero is a parameter there)."""
    motion = fuse(log)
    found = {"steer": figures(*errors(motion, of)["steer"])}
    given = motion.steer_input
    if given is not None:
        use = (motion.t > of.truth[0, 0] + 2.0) & (motion.t < of.truth[-1, 0] - 2.0)
        e = (given.angle - np.interp(motion.t, of.truth[:, 0], of.truth[:, 8]))[use]
        found["input"] = figures(e - e.mean(), np.hypot(given.sd, given.scale_sd * given.angle)[use])
    return found


def steering(seed: int) -> dict[str, dict[str, tuple[float, float, float]]]:
    """The steering of a pass with a steering sensor, by the sensors that are left to the fusion."""
    of = make(changed(plan_of(seed)[1], sensors={"steer": dict(STEER_SENSOR)}), 1000 + seed)
    return {title: steered(without(of.log, *kinds), of) for title, kinds in STEERED.items()}


def one(
    seed: int, slope: float | None = None, pulls: bool = True
) -> tuple[str, dict[str, tuple[float, float, float]], float]:
    """A pass's kind; for each quantity its RMSE, coverage and mean squared normalised error; the lateral excess."""
    kind, plan = plan_of(seed, slope, pulls)
    of = make(plan, 1000 + seed)
    found = of_errors(of.log, of)
    excess = found["lateral1"][0] ** 2 - rms(receiver_slow_error(of)) ** 2
    return kind, found, float(np.sqrt(max(excess, 0.0)))


def table(title: str, rows: list[dict[str, tuple[float, float, float]]]) -> None:
    """One block of the print."""
    print(f"{title} ({len(rows)} passes)")
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        scale, unit = (100.0, "cm ") if name.startswith(("lateral", "along")) else (np.degrees(1.0), "deg")
        median, worst = np.median(values[:, 0]) * scale, np.percentile(values[:, 0], 95) * scale
        print(
            f"  {name:9s} RMSE {median:6.3f} {unit} p95 {worst:6.3f} {unit}"
            f"  coverage {values[:, 1].mean():5.3f}  NEES {values[:, 2].mean():4.2f}"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--passes", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--steering", action="store_true")
    parser.add_argument(
        "--slope", type=float, help="standard deviation of the grade, east and north (without: drawn)"
    )
    parser.add_argument(
        "--level", action="store_true", help="the slope tilts both bodies but does not pull them aside"
    )
    chosen = parser.parse_args()
    if chosen.steering:
        with ProcessPoolExecutor(chosen.workers) as pool:
            found = list(pool.map(steering, range(chosen.passes)))
        for title in STEERED:
            table(title, [row[title] for row in found])
        sys.exit()
    with ProcessPoolExecutor(chosen.workers) as pool:
        results = list(
            pool.map(partial(one, slope=chosen.slope, pulls=not chosen.level), range(chosen.passes))
        )
    for kind in KINDS:
        table(kind, [row for name, row, _ in results if name == kind])
    table("all", [row for _, row, _ in results])
    beyond = np.array([excess for name, _, excess in results if name == "benign"]) * 1000.0
    print(
        f"benign, lateral beyond the receiver's own: median {np.median(beyond):.1f} mm, largest {beyond.max():.1f} mm"
    )
