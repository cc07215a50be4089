"""Sweeps of the theoretical study: any parameters over ranges, straightness out, on every core, memory flat.

For the command line: build a `SweepPlan` (see `parameter` for "name=low:high"), call `run_sweep(plan)`, then
`study_response.best_design(sweep)` and `study_response.sensitivities(plan, index)`; `write_sweep` leaves
`sweep.parquet` (a row a design: parameters, then each index's geometric mean over soils) and `sweep.json`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import qmc

from ..model.inputs import Driver, ForceSeries
from ..model.linear import critical_speed, linearise
from ..model.machine import Machine, MachineError
from ..model.settings import SimulationSettings
from ..model.simulate import halved_step_error, initial_state, simulate_batch
from .study_indices import INDICES, batch_indices
from .study_plan import VERSIONS, StudyError, StudyPlan, Version, machine_of, soil_series, straight_controls

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
LINEAR_INDICES = ("damping", "critical_speed")
SWEEP_SETTINGS = SimulationSettings(step=0.02)
CHUNK = 32  # runs in one compiled call: 32 runs of 60 s at 50 Hz are 10 MB
DRIVER_NAMES = ("driver.preview", "driver.delay", "driver.lag", "driver.gain")


@dataclass(frozen=True)
class Parameter:
    """A parameter and its range: "speed", "soil.level", "driver.preview|delay|lag|gain" or a machine's
    dotted name."""

    name: str
    low: float
    high: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.low) and np.isfinite(self.high) and self.low < self.high):
            raise StudyError(
                f"{self.name}: range {self.low:g} to {self.high:g} is empty; give low below high"
            )


PAPER_QUESTION = (
    Parameter("speed", 2.0, 3.4),
    Parameter("seeder.hitch_to_com", 1.5, 3.5),
    Parameter("tyre_pressure_mpa", 0.08, 0.16),
)


def parameter(text: str) -> Parameter:
    """A parameter from "name=low:high". Raises StudyError for other text."""
    name, _, limits = text.partition("=")
    low, _, high = limits.partition(":")
    try:
        return Parameter(name.strip(), float(low), float(high))
    except ValueError as error:
        if isinstance(error, StudyError):
            raise
        raise StudyError(f"{text!r}: a parameter's range is written name=low:high") from None


@dataclass(frozen=True)
class SweepPlan:
    """What to sweep.

    sampler : "grid" (count ** (1/parameters) levels each), "latin" hypercube or "sobol" sequence of `count`
    designs
    seeds : soils for every design (the same ones); study : driver, soil, length, seed
    linear : whether damping and critical speed are computed too; workers : threads
    """

    parameters: tuple[Parameter, ...] = PAPER_QUESTION
    sampler: Literal["grid", "latin", "sobol"] = "sobol"
    count: int = 256
    seeds: int = 16
    base: Version = VERSIONS["b"]
    study: StudyPlan = field(default_factory=lambda: StudyPlan(settings=SWEEP_SETTINGS))
    linear: bool = True
    workers: int = 2

    def __post_init__(self) -> None:
        if not self.parameters:
            raise StudyError("a sweep needs one parameter or more, written name=low:high")
        names = [p.name for p in self.parameters]
        if len(set(names)) < len(names):
            raise StudyError(f"a parameter is given twice among {', '.join(names)}")
        for name in ("count", "seeds", "workers"):
            if getattr(self, name) < 1:
                raise StudyError(f"{name} is {getattr(self, name)}; it must be 1 or more")
        if self.sampler not in ("grid", "latin", "sobol"):
            raise StudyError(f"sampler is {self.sampler!r}; it must be grid, latin or sobol")

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters' names, in order."""
        return tuple(p.name for p in self.parameters)

    @property
    def bounds(self) -> Floats:
        """(parameters, 2): low and high."""
        return np.array([[p.low, p.high] for p in self.parameters])


@dataclass(frozen=True)
class Design:
    """One point of a sweep made concrete."""

    machine: Machine
    speed: float
    driver: Driver
    level: float


@dataclass(frozen=True)
class Sweep:
    """Result: designs (n, parameters); indices (n, soils, INDICES), NaN where a run diverged; damping and
    critical speed (n,), critical NaN where none was found; step_error m of the middle design by halving the
    step."""

    plan: SweepPlan
    designs: Floats
    indices: Floats
    damping: Floats
    critical_speed: Floats
    step_error: float

    def over_soils(self, index: str) -> Floats:
        """An index of every design: its geometric mean over soils, (n,)."""
        values = self.indices[:, :, INDICES.index(index)]
        return np.asarray(np.exp(np.mean(np.log(values), axis=1)))


def sample_designs(plan: SweepPlan) -> Floats:
    """Designs (n, parameters) in their units; seeded by the study's seed."""
    size, bounds = len(plan.parameters), plan.bounds
    if plan.sampler == "grid":
        levels = max(round(plan.count ** (1.0 / size)), 2)
        axes = np.meshgrid(*[np.linspace(0.0, 1.0, levels)] * size, indexing="ij")
        unit = np.stack([axis.ravel() for axis in axes], axis=1)
    elif plan.sampler == "latin":
        unit = qmc.LatinHypercube(size, rng=plan.study.seed).random(plan.count)
    else:
        unit = qmc.Sobol(size, rng=plan.study.seed).random_base2(int(np.ceil(np.log2(plan.count))))[
            : plan.count
        ]
    return np.asarray(bounds[:, 0] + unit * (bounds[:, 1] - bounds[:, 0]))


def make_designs(plan: SweepPlan, designs: Floats) -> list[Design]:
    """Every row of designs (n, parameters) made concrete, see `make_design`."""
    base = machine_of(plan.base)
    return [make_design(plan, dict(zip(plan.names, row, strict=True)), base) for row in designs]


def make_design(plan: SweepPlan, values: Mapping[str, float], base: Machine | None = None) -> Design:
    """The design with parameters of these values, the rest as in the plan's base (made once by
    `make_designs`).

    Raises StudyError that names the parameter for an unknown name or a value that no machine can have.
    """
    machine_values = {}
    driver_values = {}
    speed, level = plan.base.speed, 1.0
    for name, number in values.items():
        value = float(number)
        if name == "speed":
            speed = value
        elif name == "soil.level":
            level = value / plan.study.soil.level
        elif name.startswith("driver."):
            driver_values[name.removeprefix("driver.")] = value
        else:
            machine_values[name] = value
    try:
        machine = (base or machine_of(plan.base)).replace_parameters(machine_values)
        return Design(machine, speed, _driver(plan.study.driver, driver_values), level)
    except (MachineError, ValueError) as error:
        raise StudyError(str(error)) from None


def _driver(driver: Driver, values: Mapping[str, float]) -> Driver:
    for name in values:
        if f"driver.{name}" not in DRIVER_NAMES:
            raise StudyError(f"driver.{name}: unknown parameter; known are {', '.join(DRIVER_NAMES)}")
    return Driver(**{**vars(driver), **values})


def run_sweep(plan: SweepPlan, progress: Callable[[int, int], None] | None = None) -> Sweep:
    """Simulate every design of a plan over its soils.

    progress is called with runs done and runs in all. Raises StudyError for a range that holds impossible
    machines.
    """
    designs = sample_designs(plan)
    damping, critical = linear_indices(plan, designs) if plan.linear else np.full((2, len(designs)), np.nan)
    indices = simulate_designs(plan, designs, progress)
    return Sweep(plan, designs, indices, damping, critical, sweep_step_error(plan))


def linear_indices(plan: SweepPlan, designs: Floats) -> Floats:
    """Least damping and critical speed (NaN: none found) of every design, (2, n).

    Raises StudyError for a design whose speed is not below its critical one.
    """
    found = np.full((2, len(designs)), np.nan)
    for i, design in enumerate(make_designs(plan, designs)):
        model = linearise(design.machine, design.speed, plan.study.settings)
        found[0, i] = model.least_damping()
        bound = critical_speed(design.machine, plan.study.settings)
        if bound is not None:
            found[1, i] = bound
            if not design.speed < bound:
                raise StudyError(
                    f"speed is {design.speed:.2f} m/s in one of the designs; there the critical speed is "
                    f"{bound:.2f} m/s: lower the range of speed"
                )
    return found


def simulate_designs(
    plan: SweepPlan, designs: Floats, progress: Callable[[int, int], None] | None = None
) -> Floats:
    """INDICES of every design over the plan's soils, (n, soils, INDICES).

    Runs are ordered by speed and cut into chunks of one duration, so that a chunk is one compiled call;
    chunks are shared over threads, and each gives back its indices only.
    """
    made = make_designs(plan, designs)
    speeds = np.repeat([design.speed for design in made], plan.seeds)
    ground = soil_series(plan.study.soil, plan.seeds, plan.study.seed, plan.study.run_in + plan.study.length)
    result = np.full((len(made) * plan.seeds, len(INDICES)), np.nan)
    chunks = list(_chunks(np.argsort(speeds, kind="stable").astype(np.int64)))
    done = 0
    with ThreadPoolExecutor(plan.workers) as pool:
        work = pool.map(lambda chunk: _simulate_chunk(plan, made, ground, chunk), chunks)
        for chunk, rows in zip(chunks, work, strict=True):
            result[chunk] = rows
            done += len(chunk)
            if progress is not None:
                progress(done, len(result))
    return result.reshape(len(made), plan.seeds, len(INDICES))


def _chunks(order: Indices) -> Iterator[Indices]:
    for start in range(0, len(order), CHUNK):
        yield order[start : start + CHUNK]


def _simulate_chunk(plan: SweepPlan, made: Sequence[Design], ground: ForceSeries, chunk: Indices) -> Floats:
    """INDICES of some runs; run r is design r // soils on soil r % soils."""
    study, chosen = plan.study, [made[r // plan.seeds] for r in chunk]
    speeds = np.array([design.speed for design in chosen])
    seconds = (study.run_in + study.length) / speeds
    samples = int(np.ceil(seconds.max() / study.spacing)) + 1
    controls = straight_controls(study, 1.0, float(seconds.max()), ground)
    batch = simulate_batch(
        [design.machine for design in chosen],
        controls,
        initial_state(v=speeds),
        samples,
        study.spacing,
        speed_scale=speeds,
        force_row=chunk % plan.seeds,
        force_scale=[design.level for design in chosen],
        drivers=[design.driver for design in chosen],
        settings=study.settings,
    )
    first = np.ceil(study.run_in / speeds / study.spacing).astype(np.int64)
    last = np.minimum(np.ceil(seconds / study.spacing).astype(np.int64) + 1, samples)
    return batch_indices(batch, first, last, study.spacing)


def sweep_step_error(plan: SweepPlan) -> float:
    """Error of the middle design's positions on the first soil, by halving the step, m."""
    middle = dict(zip(plan.names, plan.bounds.mean(axis=1), strict=True))
    design, study = make_design(plan, middle), plan.study
    seconds = (study.run_in + study.length) / design.speed
    ground = soil_series(study.soil, 1, study.seed, study.run_in + study.length)
    controls = straight_controls(study, design.speed, seconds, ground)
    t = np.arange(int(seconds / study.spacing), dtype=np.float64) * study.spacing
    return halved_step_error(design.machine, controls, initial_state(v=design.speed), t, study.settings)


def sweep_table(sweep: Sweep) -> pd.DataFrame:
    """A row a design: parameters, every index's geometric mean over soils, damping, critical speed."""
    table = pd.DataFrame(sweep.designs, columns=list(sweep.plan.names))
    for index in INDICES:
        table[index] = sweep.over_soils(index)
    table["damping"], table["critical_speed"] = sweep.damping, sweep.critical_speed
    return table


def write_sweep(out: Path, sweep: Sweep, answer: Mapping[str, Any] | None = None) -> tuple[Path, ...]:
    """Write `sweep.parquet` and `sweep.json` (plan, step error, `answer`: plain values) into a folder."""
    out.mkdir(parents=True, exist_ok=True)
    paths = (out / "sweep.parquet", out / "sweep.json")
    sweep_table(sweep).to_parquet(paths[0], index=False)
    plan = asdict(sweep.plan)
    plan["base"]["replaced"] = dict(sweep.plan.base.replaced)
    values = {"schema": 1, "plan": plan, "step_error": sweep.step_error, "answer": dict(answer or {})}
    paths[1].write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
    return paths
