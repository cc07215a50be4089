"""The study's two commands as functions: options in, values and the files written out.

`simulate [--variant a|b|c|FILE]...` → `make_study`; `sweep [--range NAME=LOW:HIGH]...` → `make_sweep`. Both
write their Parquet and JSON and, under `figures/`, each chart as SVG, PDF and PNG.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from .figures import write_files
from .report_blocks import Table
from .study import Study, simulate_study, write_study
from .study_charts import (
    best_block,
    comparison_block,
    linear_chart,
    response_chart,
    sensitivity_block,
    spectra_chart,
    surface_chart,
    trajectories_chart,
    yaw_chart,
)
from .study_indices import INDICES
from .study_linear import linear_maps, linear_table, steering_response
from .study_plan import VERSIONS, StudyError, StudyPlan, Version, read_version
from .study_response import (
    BestDesign,
    Effect,
    Sensitivity,
    Surface,
    answer_values,
    best_design,
    fit_surface,
    sensitivities,
    single_effects,
    surface_sensitivities,
)
from .study_sweep import PAPER_QUESTION, Sweep, SweepPlan, parameter, run_sweep, write_sweep


@dataclass(frozen=True)
class StudyOutput:
    """What `simulate` leaves: the study, its table to print, and the files written."""

    study: Study
    table: Table
    files: tuple[Path, ...]


@dataclass(frozen=True)
class SweepOutput:
    """What `sweep` leaves: the sweep, its answer (best design; tables to print) and the files written."""

    sweep: Sweep
    surface: Surface
    best: BestDesign
    single: dict[str, Effect]
    sensitivity: Sensitivity | None
    tables: tuple[Table, ...]
    files: tuple[Path, ...]


def find_version(name: str) -> Version:
    """A version by the paper's letter or from a TOML file. Raises StudyError naming what there is."""
    if name in VERSIONS:
        return VERSIONS[name]
    if not Path(name).suffix:
        raise StudyError(f"variant {name!r}: is neither {', '.join(VERSIONS)} nor a TOML file")
    return read_version(Path(name))


def make_study(
    out: Path,
    variants: Sequence[str] = (),
    plan: StudyPlan | None = None,
    progress: Callable[[str], None] | None = None,
) -> StudyOutput:
    """Simulate variants (none: a, b and c) and leave tables and Figs 3 to 5, modes and frequency responses
    in out.

    Raises StudyError or MachineError, one line.
    """
    versions = [find_version(name) for name in (variants or tuple(VERSIONS))]
    study = simulate_study(versions, plan, progress)
    maps = [found for version in versions for found in linear_maps(version)]
    files = list(write_study(out, study))
    files.append(out / "linear.parquet")
    linear_table(tuple(maps)).to_parquet(files[-1], index=False)
    charts = [trajectories_chart(study), yaw_chart(study), spectra_chart(study)]
    charts += [linear_chart(found) for found in maps if found.version is versions[-1]]
    charts.append(response_chart([steering_response(version) for version in versions]))
    files += write_files(charts, out / "figures")
    return StudyOutput(study, comparison_block(study), tuple(files))


def make_sweep(
    out: Path,
    ranges: Sequence[str] = (),
    *,
    sampler: Literal["grid", "latin", "sobol"] = "sobol",
    count: int = 256,
    soils: int = 16,
    base: str = "b",
    index: str = "r95_1",
    workers: int = 2,
    sobol_samples: int = 0,
    plan: StudyPlan | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SweepOutput:
    """Sweep parameters ("name=low:high"; none: the paper's v, l5, Pw) and answer which design runs
    straightest.

    index : of study_indices.INDICES, by which straightness is judged; sobol_samples : a power of two for
    Sobol sensitivities by direct simulation, 0: those of the response surface. Raises StudyError, one line.
    """
    if index not in INDICES:
        raise StudyError(f"index {index!r}: unknown; known are {', '.join(INDICES)}")
    parameters = tuple(parameter(text) for text in ranges) or PAPER_QUESTION
    chosen = SweepPlan(
        parameters=parameters,
        sampler=sampler,
        count=count,
        seeds=soils,
        base=find_version(base),
        workers=workers,
    )
    chosen = chosen if plan is None else dataclasses.replace(chosen, study=plan)
    sweep = run_sweep(chosen, progress)
    surface, best, single = (
        fit_surface(sweep, index),
        best_design(sweep, index),
        single_effects(chosen, index=index),
    )
    found = _shares(chosen, surface, sobol_samples)
    files = [*write_sweep(out, sweep, answer_values(best, found, single))]
    files += write_files([surface_chart(surface)], out / "figures")
    tables = (best_block(best, chosen.base), *(() if found is None else (sensitivity_block(found),)))
    return SweepOutput(sweep, surface, best, single, found, tables, tuple(files))


def _shares(plan: SweepPlan, surface: Surface, samples: int) -> Sensitivity | None:
    """Sobol sensitivities, of the surface or (samples > 0) simulated; a single parameter has none."""
    if len(plan.parameters) < 2:
        return None
    return sensitivities(plan, surface.index, samples) if samples else surface_sensitivities(plan, surface)
