"""The theoretical study: the paper's versions a, b, c (or any other), its Figs 3 to 5 and its table beside
ours.

For the command line: `simulate_study([version, ...], plan)` gives a `Study`; `write_study(out, study)` leaves
`<label>.parquet` (the run whose range of O1 is the median one, a row each 20 ms), `indices.parquet` (a row a
version and soil), `spectra.parquet`, `table.parquet` (paper, ours, ratio) and `study.json`. Versions come
from `study_plan.VERSIONS` or `study_plan.read_version(path)`; figures are drawn from the same `Study`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from ..model.linear import Mode, critical_speed, linearise, require_stable
from ..model.machine import Machine
from ..model.simulate import BatchRun, SimulatedRun, halved_step_error, initial_state, simulate_batch
from .study_indices import INDICES, acceleration_spectrum, batch_indices
from .study_plan import (
    ASSUMPTIONS,
    StudyError,
    StudyPlan,
    Version,
    machine_of,
    soil_series,
    straight_controls,
)

Floats = NDArray[np.float64]
QUANTILES = (0.05, 0.95)  # of the runs over soils, in the table and in the figures' bands


@dataclass(frozen=True)
class PaperFigure:
    """A number of the paper: index (see study_indices.INDICES), version, value (low and high where it is a
    range)."""

    index: str
    version: str
    low: float
    high: float

    @property
    def middle(self) -> float:
        """The value, or the middle of the range."""
        return 0.5 * (self.low + self.high)


_PRINTED: dict[str, dict[str, float | tuple[float, float]]] = {
    "max_deviation1": {"a": 0.125, "b": 0.12, "c": 0.12},
    "range1": {"a": 0.12, "c": 0.11},
    "range2": {"a": 0.11, "c": 0.08},
    "yaw_range1_deg": {"a": 5.8, "c": 2.8},
    "yaw_range2_deg": {"a": 2.2, "c": 1.8},
    "peak1": {"a": 0.045, "b": 0.032, "c": 0.028},
    "peak2": {"a": 0.032, "b": 0.032, "c": 0.028},
    "peak_frequency1": {"a": 3.1, "b": (2.5, 5.0), "c": (5.0, 7.0)},
    "peak_frequency2": {"a": (2.5, 4.0), "b": (2.5, 5.0), "c": (5.0, 7.0)},
}
PAPER: tuple[PaperFigure, ...] = tuple(
    PaperFigure(index, version, *(value if isinstance(value, tuple) else (value, value)))
    for index, values in _PRINTED.items()
    for version, value in values.items()
)


@dataclass(frozen=True)
class Band:
    """A density over frequency: mean over soils, and the 5 % and 95 % quantiles of single runs."""

    frequency: Floats
    mean: Floats
    low: Floats
    high: Floats


@dataclass(frozen=True)
class VersionStudy:
    """One version: its machine, the run that is typical, indices of all soils (soils, INDICES), spectra of
    lateral acceleration of both CoMs, linear modes, critical speed (m/s, None: none found) and step error
    (m).

    Distances of `run` count from where the judged length begins; so does its t.
    """

    version: Version
    machine: Machine
    run: SimulatedRun
    indices: Floats
    spectra: tuple[Band, Band]
    modes: tuple[Mode, ...]
    critical_speed: float | None
    step_error: float

    def index(self, name: str) -> Floats:
        """One index over all soils."""
        return self.indices[:, INDICES.index(name)]


@dataclass(frozen=True)
class TableRow:
    """Paper beside ours: the median over soils with its 5 % and 95 % quantiles, and ours over the paper's
    middle."""

    index: str
    version: str
    paper_low: float
    paper_high: float
    ours: float
    ours_low: float
    ours_high: float
    ratio: float


@dataclass(frozen=True)
class Study:
    """All versions of a study and the table paper, ours, ratio (rows for the paper's own versions only)."""

    plan: StudyPlan
    versions: tuple[VersionStudy, ...]
    table: tuple[TableRow, ...]


def simulate_study(
    versions: Sequence[Version], plan: StudyPlan | None = None, progress: Callable[[str], None] | None = None
) -> Study:
    """Simulate versions over the plan's soils, the same soils for each.

    progress is called with a line about each version before it is computed. Raises StudyError or
    MachineError, one line, for a version that cannot be or whose speed is above the critical one.
    """
    plan = StudyPlan() if plan is None else plan
    done = []
    for version in versions:
        if progress is not None:
            progress(f"version {version.label}: {plan.seeds} soils")
        done.append(study_version(version, plan))
    return Study(plan, tuple(done), comparison_table(done))


def study_version(version: Version, plan: StudyPlan) -> VersionStudy:
    """One version over all soils."""
    machine = machine_of(version)
    require_stable(machine, version.speed, plan.settings)
    batch, first = _runs(machine, version, plan)
    whole = np.full(plan.seeds, batch.t.shape[1])
    indices = batch_indices(batch, np.full(plan.seeds, first), whole, plan.spacing)
    if np.isnan(indices).any():
        when = np.nanmin(batch.diverged_at)
        raise StudyError(
            f"version {version.label}: a run diverges at {when:.2f} s; use a smaller settings.step"
        )
    return VersionStudy(
        version=version,
        machine=machine,
        run=_judged(batch.run(typical_run(indices)), first),
        indices=indices,
        spectra=(_band(batch.ay1[:, first:], plan), _band(_second(batch)[:, first:], plan)),
        modes=linearise(machine, version.speed, plan.settings).modes(),
        critical_speed=critical_speed(machine, plan.settings),
        step_error=_step_error(machine, version, plan),
    )


def _runs(machine: Machine, version: Version, plan: StudyPlan) -> tuple[BatchRun, int]:
    """Runs over all soils, and the sample where the judged length begins."""
    seconds = (plan.run_in + plan.length) / version.speed
    samples = int(np.ceil(seconds / plan.spacing)) + 1
    ground = soil_series(plan.soil, plan.seeds, plan.seed, plan.run_in + plan.length)
    controls = straight_controls(plan, version.speed, seconds, ground)
    start = np.tile(initial_state(v=version.speed), (plan.seeds, 1))
    rows = np.arange(plan.seeds)
    batch = simulate_batch(
        machine, controls, start, samples, plan.spacing, force_row=rows, settings=plan.settings
    )
    return batch, int(np.ceil(plan.run_in / version.speed / plan.spacing))


def _second(batch: BatchRun) -> Floats:
    assert batch.ay2 is not None  # machine_of always has a seeder
    return batch.ay2


def typical_run(indices: Floats) -> int:
    """Which run has the median range of O1 (the lower of two)."""
    ranges = indices[:, INDICES.index("range1")]
    return int(np.argsort(ranges, kind="stable")[(len(ranges) - 1) // 2])


def _judged(run: SimulatedRun, first: int) -> SimulatedRun:
    """The run from the sample where the judged length begins; times and places along the line count from
    there."""
    arrays: dict[str, Any] = {
        name: value[first:] for name, value in vars(run).items() if isinstance(value, np.ndarray)
    }
    origin = arrays["x1"][0]
    for name, zero in (("t", arrays["t"][0]), ("x1", origin), ("x2", origin)):
        arrays[name] = arrays[name] - zero
    return SimulatedRun(**arrays, diverged_at=run.diverged_at)


def _band(series: Floats, plan: StudyPlan) -> Band:
    spectrum = acceleration_spectrum(series, plan.spacing)
    low, high = np.quantile(spectrum.density, QUANTILES, axis=0)
    return Band(spectrum.frequency, spectrum.density.mean(axis=0), low, high)


def _step_error(machine: Machine, version: Version, plan: StudyPlan) -> float:
    """Error of positions of the first soil's run, by halving the step, m."""
    seconds = (plan.run_in + plan.length) / version.speed
    ground = soil_series(plan.soil, 1, plan.seed, plan.run_in + plan.length)
    controls = straight_controls(plan, version.speed, seconds, ground)
    t = np.arange(int(seconds / plan.spacing), dtype=np.float64) * plan.spacing
    return halved_step_error(machine, controls, initial_state(v=version.speed), t, plan.settings)


def comparison_table(done: Sequence[VersionStudy]) -> tuple[TableRow, ...]:
    """Paper, ours and ratio for every number that the paper gives of the versions at hand."""
    rows = []
    by_label = {item.version.label: item for item in done}
    for figure in PAPER:
        if figure.version in by_label:
            values = by_label[figure.version].index(figure.index)
            ours, (low, high) = float(np.median(values)), np.quantile(values, QUANTILES)
            rows.append(
                TableRow(
                    figure.index,
                    figure.version,
                    figure.low,
                    figure.high,
                    ours,
                    float(low),
                    float(high),
                    ours / figure.middle,
                )
            )
    return tuple(rows)


def run_table(run: SimulatedRun) -> pd.DataFrame:
    """A run as a table, its fields as columns."""
    return pd.DataFrame({name: value for name, value in vars(run).items() if isinstance(value, np.ndarray)})


def indices_table(study: Study) -> pd.DataFrame:
    """A row a version and soil."""
    parts = []
    for item in study.versions:
        table = pd.DataFrame(item.indices, columns=list(INDICES))
        table.insert(0, "seed", study.plan.seed + np.arange(len(table)))
        table.insert(0, "version", item.version.label)
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def spectra_table(study: Study) -> pd.DataFrame:
    """A row a version, body and frequency."""
    parts = [
        pd.DataFrame({"version": item.version.label, "body": body, **vars(band)})
        for item in study.versions
        for body, band in enumerate(item.spectra, start=1)
    ]
    return pd.concat(parts, ignore_index=True)


def study_values(study: Study) -> dict[str, Any]:
    """The study in plain JSON values: plan, assumptions with sources, versions, modes, table."""
    return {
        "schema": 1,
        "plan": asdict(study.plan),
        "assumptions": [asdict(item) for item in ASSUMPTIONS],
        "versions": [
            {
                **{key: value for key, value in vars(item.version).items() if key != "replaced"},
                "replaced": dict(item.version.replaced),
                "modes": [
                    {"frequency": mode.frequency, "damping": mode.damping, "oscillates": mode.oscillates}
                    for mode in item.modes
                ],
                "critical_speed": item.critical_speed,
                "step_error": item.step_error,
            }
            for item in study.versions
        ],
        "table": [asdict(row) for row in study.table],
    }


def write_study(out: Path, study: Study) -> tuple[Path, ...]:
    """Write the study's tables into a folder (made if absent); gives the files written."""
    out.mkdir(parents=True, exist_ok=True)
    tables = {f"{item.version.label}.parquet": run_table(item.run) for item in study.versions}
    tables["indices.parquet"] = indices_table(study)
    tables["spectra.parquet"] = spectra_table(study)
    tables["table.parquet"] = pd.DataFrame([asdict(row) for row in study.table])
    for name, table in tables.items():
        table.to_parquet(out / name, index=False)
    (out / "study.json").write_text(json.dumps(study_values(study), indent=1) + "\n", encoding="utf-8")
    return (*(out / name for name in tables), out / "study.json")
