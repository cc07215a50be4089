"""Ensemble mode: the model under a driver and random soil; only statistics may be compared with it.

Its soil and driver are assumptions, not the field's, so no point of it belongs to a point of a measured track: a
point-wise discrepancy of an ensemble does not exist, and asking for one is an error. Replay is the other mode.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..model.machine import Machine
from ..model.settings import SimulationSettings
from ..model.simulate import BatchRun, initial_state, simulate_batch
from .bounds import DEVIATION1, DEVIATION2, YAW1, YAW2
from .study_plan import StudyPlan, soil_series, straight_controls

Floats = NDArray[np.float64]

RUNS = 64
SPACING = 0.05  # s
PLAN = StudyPlan(seeds=RUNS, spacing=SPACING, settings=SimulationSettings(step=0.01))
LEVEL = 0.95
SHARE = 8  # runs, at least, of a thread


class EnsembleError(ValueError):
    """Something was asked of an ensemble that only a replay can answer."""


@dataclass(frozen=True)
class Ensemble:
    """Straightness indices of many runs over random soils: (runs,) by "response.index", m or rad; and the plan."""

    indices: Mapping[str, Floats]
    plan: StudyPlan
    diverged: int


@dataclass(frozen=True)
class StatisticComparison:
    """One index: the passes' mean, the ensemble's band, the share of runs below the mean, and their ratio."""

    index: str
    measured: float
    passes: int
    low: float
    median: float
    high: float
    share_below: float
    ratio: float


def make_ensemble(
    machine: Machine, speed: float, length: float, plan: StudyPlan = PLAN, threads: int = 1
) -> Ensemble:
    """The machine driven along a straight line over `plan.seeds` soils, judged over `length` m at `speed` m/s.

    threads : that share the runs; how many makes no difference to the result
    """
    plan = replace(plan, length=length)
    seconds = (plan.run_in + plan.length) / speed
    samples = int(np.ceil(seconds / plan.spacing)) + 1
    ground = soil_series(plan.soil, plan.seeds, plan.seed, plan.run_in + plan.length)
    controls = straight_controls(plan, speed, seconds, ground)
    first = int(np.ceil(plan.run_in / speed / plan.spacing))

    def judged(soils: NDArray[np.intp]) -> tuple[dict[str, Floats], int]:
        start = np.tile(initial_state(v=speed), (soils.size, 1))
        batch = simulate_batch(
            machine, controls, start, samples, plan.spacing, force_row=soils, settings=plan.settings
        )
        good = np.isnan(batch.diverged_at)
        return _indices(batch, first, good), int((~good).sum())

    shares = np.array_split(np.arange(plan.seeds), max(min(threads, plan.seeds // SHARE), 1))
    with ThreadPoolExecutor(len(shares)) as pool:
        parts = list(pool.map(judged, shares))
    indices = {name: np.concatenate([found[name] for found, _ in parts]) for name in parts[0][0]}
    return Ensemble(indices, plan, sum(diverged for _, diverged in parts))


def _indices(batch: BatchRun, first: int, good: NDArray[np.bool_]) -> dict[str, Floats]:
    responses = {DEVIATION1: batch.y1, YAW1: batch.yaw1, DEVIATION2: batch.y2, YAW2: batch.yaw2}
    found = {}
    for name, series in responses.items():
        if series is not None:
            for index, values in straightness_of(series[good, first:]).items():
                found[f"{name}.{index}"] = values
    return found


def straightness_of(series: Floats) -> dict[str, Floats]:
    """Greatest, range, R95 and rms (about the mean) of each row of (runs, n), as for measured rows."""
    low, high = np.quantile(series, [0.025, 0.975], axis=1)
    return {
        "max_abs": np.abs(series).max(axis=1),
        "range": np.ptp(series, axis=1),
        "r95": high - low,
        "rms": series.std(axis=1),
    }


def compare_statistics(
    ensemble: Ensemble, measured: Mapping[str, Sequence[float]]
) -> tuple[StatisticComparison, ...]:
    """Each measured index's mean over passes against the ensemble's distribution."""
    found = []
    for index, values in measured.items():
        if index not in ensemble.indices or not len(values):
            continue
        runs, mean = ensemble.indices[index], float(np.mean(values))
        low, median, high = np.quantile(runs, [(1.0 - LEVEL) / 2.0, 0.5, (1.0 + LEVEL) / 2.0])
        found.append(
            StatisticComparison(
                index=index,
                measured=mean,
                passes=len(values),
                low=float(low),
                median=float(median),
                high=float(high),
                share_below=float(np.mean(runs < mean)),
                ratio=float(median) / mean if mean > 0.0 else float("nan"),
            )
        )
    return tuple(found)


def pointwise_discrepancy(ensemble: Ensemble) -> NoReturn:
    """Always an error: see the module."""
    raise EnsembleError(
        f"an ensemble of {ensemble.plan.seeds} runs over random soil has no point-wise discrepancy; compare its "
        "ranges, R95 and spectra, or replay the pass's measured steering and speed"
    )


def ensemble_values(ensemble: Ensemble, measured: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """What campaign.json says of an ensemble: the assumptions, and each index beside the measured one."""
    plan = ensemble.plan
    return {
        "runs": plan.seeds,
        "diverged": ensemble.diverged,
        "length": plan.length,
        "driver": asdict(plan.driver),
        "soil": asdict(plan.soil),
        "indices": [asdict(c) for c in compare_statistics(ensemble, measured)],
    }
