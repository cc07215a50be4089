"""What these sensors can know at best: the posterior Cramér-Rao bound of the fusion, doubt by doubt.

    python benchmarks/observability.py [--passes 2] [--kinds benign,outage]

For seeded twins of each kind it prints the bound of the tractor's lateral place, of both yaws and of the steering
angle (root mean square over the pass), with all doubts, and again with one of them taken away: the receiver's slow
error, the accelerometers' bias and mounting (tilt), constant crab, the tyres' slip. Beside them the fusion's own
error, and for every figure that was asked for whether any estimate could reach it, and what it would take.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "pipeline"))

from fusion_samples import Sample, changed, errors, make, receiver_slow_error, rms
from smts_validate.pipeline.fusion import kernels, output
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.assemble import assemble
from smts_validate.pipeline.fusion.fuse import solved
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion
from smts_validate.pipeline.fusion.prepare import STEP
from smts_validate.pipeline.fusion.problem import Measurements, Problem
from smts_validate.pipeline.fusion.settings import LEVER_SD, FusionSettings, Levels
from smts_validate.pipeline.fusion.steering import best_steering
from smts_validate.pipeline.fusion.unseen import Doubt, constant_crab, ground_variance, modes_of, place_doubt
from smts_validate.pipeline.twin_plan import preset

KINDS = ("benign", "bad_sensors", "outage", "headland")
QUANTITIES = {
    "lateral1": (100.0, "cm"),
    "yaw1": (57.2958, "deg"),
    "yaw2": (57.2958, "deg"),
    "steer": (57.2958, "deg"),
}
# Issue figures: kind, quantity, what was asked (cm, deg)
ASKED = (
    ("benign", "lateral1", 0.5), ("benign", "yaw1", 0.03), ("benign", "yaw2", 0.06), ("benign", "steer", 0.1),
    ("bad_sensors", "yaw1", 0.08), ("bad_sensors", "yaw2", 0.12), ("outage", "lateral1", 6.0),
    ("headland", "yaw1", 0.15), ("headland", "yaw2", 0.15),
)  # fmt: skip
KNOWN = 1.0e-6  # of a standard deviation: a doubt taken away
Bound = dict[str, float]


@dataclass(frozen=True)
class Case:
    """One pass: its estimation problem, the path it is linearised about, the fused motion, levels, crab (rad)."""

    task: Problem
    path: np.ndarray
    motion: Motion
    levels: Levels
    crab: tuple[float, float]
    front_axle: float
    mounting: bool = True  # whether the unit's mounting against the vertical is in doubt


def case_of(of: Sample) -> Case:
    """A pass fused, its problem kept."""
    found = solved(of.log, FusionSettings(draws=2))
    known, _, levels, _, settled, _ = found
    machine = known.log.manifest.machine
    path = settled.smooth.x
    task = taken(settled.task, settled.filtered.used)
    return Case(
        task, path, assemble(*found), levels, constant_crab(machine, levels), machine.tractor.front_axle
    )


def taken(task: Problem, used: np.ndarray) -> Problem:
    """The problem with the measurements alone that the fusion did not refuse."""
    q = task.measurements
    kept = Measurements(q.kind[used], q.node[used], q.z[used], q.var[used], q.ahead[used])
    return replace(task, measurements=kept)


def posterior(task: Problem, path: np.ndarray) -> np.ndarray:
    """Covariance (N, k, k) of the KEPT components given all measurements, linearised about a path (N, SIZE).

    No data enter, so no gate either. Filter forward, then Bierman's adjoint covariance backward, in plain NumPy: also
    a check of the compiled engine.
    """
    starts, q, p = task.measurements.starts(task.t.size), task.measurements, task.parameters
    P, drive = task.P0.copy(), np.empty(s.SIZE)
    kept = np.empty((task.t.size, s.SIZE, s.SIZE))
    rows: list[tuple[np.ndarray, np.ndarray, float]] = []
    for k in range(task.t.size):
        if k > 0:
            F = stepped(task, path, k - 1)
            kernels.process_noise(path[k - 1], task.step_inputs[k - 1], STEP, p, drive)
            drive[[s.EX, s.EY]] += task.inject[k, 0]
            drive[[s.FX, s.FY]] += task.inject[k, 1]
            P = F @ P @ F.T + np.diag(drive)
        for m in range(starts[k], starts[k + 1]):
            H = np.zeros(s.SIZE)
            kernels.predict(q.kind[m], path[k], task.node_inputs[k], q.ahead[m], p, H)
            shared = P @ H
            S = float(H @ shared) + q.var[m]
            rows.append((H, shared / S, S))
            P = P - np.outer(shared, shared) / S
        kept[k] = P
    return smoothed(task, path, kept, rows, starts)


def stepped(task: Problem, path: np.ndarray, k: int) -> np.ndarray:
    """Transition matrix from node k to the next."""
    F = np.eye(s.SIZE)
    kernels.transition(path[k], task.step_inputs[k], STEP, task.parameters, F)
    return F


def smoothed(
    task: Problem,
    path: np.ndarray,
    kept: np.ndarray,
    rows: list[tuple[np.ndarray, np.ndarray, float]],
    starts: np.ndarray,
) -> np.ndarray:
    """Filter covariances (N, SIZE, SIZE) to the smoother's of the KEPT components, by rows H, gains K, variances S."""
    L = np.zeros((s.SIZE, s.SIZE))
    keep = np.array(s.KEPT)
    out = np.empty((task.t.size, keep.size, keep.size))
    for k in range(task.t.size - 1, -1, -1):
        if k < task.t.size - 1:
            F = stepped(task, path, k)
            L = F.T @ L @ F
        P = kept[k]
        out[k] = (P - P @ L @ P)[np.ix_(keep, keep)]
        for m in range(starts[k + 1] - 1, starts[k] - 1, -1):
            H, K, S = rows[m]
            back = L @ K
            L = L - np.outer(H, back) - np.outer(back, H) + np.outer(H, H) * (float(K @ back) + 1.0 / S)
    return out


def without(states: tuple[int, ...], parameters: tuple[int, ...]) -> Callable[[Case], Case]:
    """The case with these states known from the start and these parameters (their drives) at zero."""

    def change(case: Case) -> Case:
        P0, p = case.task.P0.copy(), case.task.parameters.copy()
        for i in states:
            P0[i, i] *= KNOWN**2
        p[list(parameters)] *= KNOWN
        return replace(case, task=replace(case.task, P0=P0, parameters=p))

    return change


SLOW = without((s.EX, s.EY, s.FX, s.FY), (s.P_SD_E, s.P_SD_F))
ACCELEROMETERS = without((s.BAX, s.BAY), ())
SLIP = without(
    (s.SLIP1, s.SLIP2, s.TURN1, s.TURN2),
    (s.P_BETA1, s.P_BETA2, s.P_COMPLIANCE, s.P_TURN, s.P_TURN2, s.P_DRAG2),
)


def tiltless(case: Case) -> Case:
    """The case with the accelerometers' bias and the unit's mounting known."""
    return replace(ACCELEROMETERS(case), mounting=False)


def crabless(case: Case) -> Case:
    """The case without constant crab."""
    return replace(case, crab=(0.0, 0.0))


VARIANTS: Mapping[str, Callable[[Case], Case]] = {
    "as it is": lambda case: case,
    "no slow GNSS error": SLOW,
    "no tilt doubt": tiltless,
    "no crab": crabless,
    "no slip": SLIP,
    "no slow error, no tilt doubt": lambda case: SLOW(tiltless(case)),
    "none of the four": lambda case: SLOW(tiltless(SLIP(crabless(case)))),
}


def bound(case: Case) -> Bound:
    """Root mean square over the pass of the posterior standard deviations, m and rad."""
    task, m = case.task, case.motion
    lag = float(case.path[-1, s.LAG])
    level = (task.node_inputs[:, s.N_ROLL2], task.node_inputs[:, s.N_PITCH2])
    P = posterior(task, case.path)
    at = output.at_utc(task.t, m.t, lag, case.path, P, level)
    place = LEVER_SD
    if case.mounting:
        roll = float(np.median(P[:, output.K_ROLL, output.K_ROLL]))
        place = place_doubt(task.parameters, ground_variance(task), roll)
    modes = modes_of(at, task.parameters, Doubt(place, crab=case.crab), np.zeros(m.t.size))
    tractor = output.tractor_motion(at, task.parameters, modes, None)
    seeder = output.seeder_motion(at, task.parameters, modes, None)
    steer = best_steering(
        m.t,
        tractor,
        m.steer_input,
        case.front_axle,
        float(task.parameters[s.P_BETA1]),
        tractor.yaw - seeder.yaw,
    )
    return {
        "lateral1": rms(lateral_sd(tractor)), "yaw1": rms(tractor.sd(2)), "yaw2": rms(seeder.sd(2)),
        "steer": rms(steer.sd[np.isfinite(steer.sd)]),
    }  # fmt: skip


def lateral_sd(b: BodyMotion) -> np.ndarray:
    """Standard deviation across the body's heading, m (N,)."""
    c, sn, C = np.cos(b.yaw), np.sin(b.yaw), b.covariance
    return np.sqrt(sn**2 * C[:, 0, 0] - 2.0 * sn * c * C[:, 0, 1] + c**2 * C[:, 1, 1])


def sample_of(kind: str, seed: int) -> Sample:
    """A seeded twin of a kind, fields as in benchmarks/accuracy.py."""
    rng = np.random.default_rng(seed)
    return make(
        changed(
            preset(kind), place__heading_deg=float(rng.uniform(-180.0, 180.0)),
            soil__slope_east=float(rng.normal() * 0.005), soil__slope_north=float(rng.normal() * 0.005),
        ),
        2000 + seed,
    )  # fmt: skip


def mean(rows: list[Bound]) -> Bound:
    """Root mean square over passes."""
    return {name: rms(np.array([row[name] for row in rows])) for name in rows[0]}


def line(title: str, row: Bound) -> str:
    """One line of a table."""
    return f"  {title:30s}" + "".join(f"{row[q] * k:10.3f} {unit:3s}" for q, (k, unit) in QUANTITIES.items())


def study(kind: str, passes: int) -> dict[str, Bound]:
    """Bounds of one kind by variant, the fusion's own error, and the receiver's slow error (all rms)."""
    rows: dict[str, list[Bound]] = {}
    for seed in range(passes):
        of = sample_of(kind, seed)
        case = case_of(of)
        for title, change in VARIANTS.items():
            rows.setdefault(title, []).append(bound(change(case)))
        e = errors(case.motion, of)
        rows.setdefault("error of the fusion", []).append({q: rms(e[q][0]) for q in QUANTITIES})
        slow = rms(receiver_slow_error(of)) if kind != "outage" else float("nan")
        rows.setdefault("receiver's own slow error", []).append(
            dict.fromkeys(QUANTITIES, np.nan) | {"lateral1": slow}
        )
    return {title: mean(found) for title, found in rows.items()}


def verdict(tables: Mapping[str, Mapping[str, Bound]]) -> None:
    """Each asked figure against its bound."""
    print("asked for                      figure  bound       reachable")
    for kind, quantity, asked in ASKED:
        if kind not in tables:
            continue
        scale, unit = QUANTITIES[quantity]
        beyond = kind == "benign" and quantity == "lateral1"
        plain = "no slow GNSS error" if beyond else "as it is"
        value = tables[kind][plain][quantity] * scale
        name = f"{kind} {quantity}" + (" beyond the receiver" if beyond else "")
        enough = [v for v in VARIANTS if tables[kind][v][quantity] * scale <= asked]
        answer = (
            "yes" if value <= asked else "no; with " + (" or ".join(v for v in enough) or "none of these")
        )
        print(f"{name:30s} {asked:5.2f} {value:6.3f} {unit:3s}  {answer}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--passes", type=int, default=2, help="twins of each kind")
    parser.add_argument("--kinds", default=",".join(KINDS))
    chosen = parser.parse_args()
    found = {}
    for kind in chosen.kinds.split(","):
        found[kind] = study(kind, chosen.passes)
        print(f"{kind} ({chosen.passes} passes)" + " " * 20 + "".join(f"{q:>13s}" for q in QUANTITIES))
        for title, row in found[kind].items():
            print(line(title, row))
    verdict(found)
