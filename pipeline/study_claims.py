"""What the paper's numbers cannot be at once, by computation (docs/paper.md quotes `claim_values`).

Each function answers one question; `search_parameters` looks for parameters that meet as many of the
paper's numbers as can be met at once.
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.stats import qmc

from ..model.dynamics import kinetic_energy, mass_matrix, quadratic_terms
from ..model.inputs import Controls
from ..model.linear import linearise
from ..model.machine import GRAVITY, Machine, MachineError
from ..model.settings import SimulationSettings
from ..model.simulate import SimulatedRun, initial_state, simulate
from .study import PAPER, Study, VersionStudy
from .study_indices import INDICES
from .study_plan import VERSIONS, Soil, StudyPlan, Version, machine_of
from .study_response import CONFIDENCE, Effect
from .study_sweep import SWEEP_SETTINGS, SweepPlan, simulate_designs

Floats = NDArray[np.float64]
PRINTED = SimulationSettings(equations="as_printed")
EXACT = SimulationSettings()


def swing_acceleration(swing: float, frequency: float) -> float:
    """Peak acceleration, in g, of a sinusoidal swing of total width `swing` (m) at a frequency (Hz):
    (swing/2)·(2πf)²/g."""
    return 0.5 * swing * (2.0 * np.pi * frequency) ** 2 / GRAVITY


def peak_displacement(density: float, low: float, high: float) -> float:
    """Rms displacement, m, behind a flat density of acceleration ((m/s²)²/Hz) from low to high Hz:
    x² = ∫ S/(2πf)⁴ df = S/(2π)⁴·(low⁻³ − high⁻³)/3."""
    return float(np.sqrt(density / (2.0 * np.pi) ** 4 * (low**-3 - high**-3) / 3.0))


def runs_to_tell(one: float, other: float, spread: float, power: float = 0.8, alpha: float = 0.05) -> int:
    """Runs of each version to tell two geometric means apart: n = 2·((z_α/2 +
    z_power)·spread/ln(one/other))², spread the standard deviation of the logarithm."""
    quantiles = stats.norm.ppf(1.0 - alpha / 2.0) + stats.norm.ppf(power)
    return int(np.ceil(2.0 * (quantiles * spread / np.log(one / other)) ** 2))


def pressure_exponent_for(frequency_ratio: float, pressure_ratio: float) -> float:
    """Exponent of stiffness over pressure that moves a natural frequency (∝ √stiffness) by a ratio."""
    return float(2.0 * np.log(frequency_ratio) / np.log(pressure_ratio))


def stiffness_frequencies(version: Version, factors: Floats) -> Floats:
    """Highest natural frequency of an oscillating mode, Hz, with all cornering stiffness times each
    factor."""
    machine = machine_of(version)
    names = [f"tyres.{axle}.cornering_stiffness" for axle in ("front", "rear", "seeder")]
    found = []
    for factor in factors:
        scaled = machine.replace_parameters({name: factor * machine.parameter(name) for name in names})
        modes = linearise(scaled, version.speed).modes()
        found.append(max((mode.frequency for mode in modes if mode.oscillates), default=np.nan))
    return np.array(found)


def free_energy_drift(
    machine: Machine, settings: SimulationSettings, yaw2: float, seconds: float = 3.0
) -> float:
    """Relative change of the kinetic energy of both bodies gliding free of all forces, from a start with
    hitch angle −yaw2 (rad), 3 m/s and opposite yaw rates of 0.7 rad/s; zero for right equations (RK4 at 1
    ms)."""
    state = initial_state(yaw2=yaw2, v=3.0, yaw_rate1=0.7, yaw_rate2=-0.7)
    start, step = kinetic_energy(machine, state), 1e-3

    def rate(s: Floats) -> Floats:
        pull = np.linalg.solve(mass_matrix(machine, s, settings), -quadratic_terms(machine, s, settings))
        return np.concatenate((s[4:], pull))

    for _ in range(round(seconds / step)):
        k1 = rate(state)
        k2 = rate(state + 0.5 * step * k1)
        k3 = rate(state + 0.5 * step * k2)
        k4 = rate(state + step * k3)
        state = state + step / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return kinetic_energy(machine, state) / start - 1.0


def headland_gap(version: Version, steer: float = 0.5, seconds: float = 8.0) -> float:
    """Distance, m, between the seeder's CoM by the exact and by the printed equations at the end of a
    headland turn: wheels swung to `steer` (rad) in 1.5 s and held."""
    t = np.arange(0.0, seconds, 0.01)
    controls = Controls(t=t, speed=np.full(t.size, version.speed), steer=np.clip(t / 1.5, 0.0, 1.0) * steer)
    runs = [
        simulate(machine_of(version), controls, initial_state(v=version.speed), t, settings)
        for settings in (EXACT, PRINTED)
    ]
    (x, y), (printed_x, printed_y) = (_last_place(run) for run in runs)
    return float(np.hypot(x - printed_x, y - printed_y))


def _last_place(run: SimulatedRun) -> tuple[float, float]:
    """Where the seeder's CoM ends."""
    assert run.x2 is not None  # machine_of always has a seeder
    assert run.y2 is not None
    return float(run.x2[-1]), float(run.y2[-1])


def printed_effect(plan: StudyPlan, version: Version, soils: int = 16) -> Effect:
    """Change of O1's range on the straight when the equations are used as printed."""
    base = np.array([[version.speed]])
    exact = SweepPlan(seeds=soils, base=version, study=dataclasses.replace(plan, settings=SWEEP_SETTINGS))
    narrow = dataclasses.replace(exact, parameters=exact.parameters[:1])
    printed_settings = dataclasses.replace(SWEEP_SETTINGS, equations="as_printed")
    printed = dataclasses.replace(narrow, study=dataclasses.replace(plan, settings=printed_settings))
    column = INDICES.index("range1")
    logs = np.log(
        simulate_designs(printed, base)[0, :, column] / simulate_designs(narrow, base)[0, :, column]
    )
    return _effect("range1", logs)


def _effect(index: str, logs: Floats) -> Effect:
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs)))
    mean = float(logs.mean())
    return Effect(index, float(np.exp(mean)), float(np.exp(mean - half)), float(np.exp(mean + half)))


def step_effects(plan: StudyPlan, soils: int = 64) -> dict[str, tuple[Effect, ...]]:
    """What each of the paper's three changes does alone, from version a: v 2.5 → 2.8, l5 2 → 3, Pw 0.10 →
    0.12, and the driver's delay + 0.2 s for scale; effects on every index over the same soils."""
    names = ("speed", "seeder.hitch_to_com", "tyre_pressure_mpa", "driver.delay")
    start = np.array([2.5, 2.0, 0.10, plan.driver.delay])
    steps = np.array([0.3, 1.0, 0.02, 0.2])
    sweep = SweepPlan(
        seeds=soils, base=VERSIONS["a"], study=dataclasses.replace(plan, settings=SWEEP_SETTINGS)
    )
    ranges = tuple(
        dataclasses.replace(sweep.parameters[0], name=name, low=float(low), high=float(low + step))
        for name, low, step in zip(names, start, steps, strict=True)
    )
    sweep = dataclasses.replace(sweep, parameters=ranges)
    found = np.log(simulate_designs(sweep, np.vstack([start, start + np.diag(steps)])))
    return {
        name: tuple(_effect(index, found[i + 1, :, k] - found[0, :, k]) for k, index in enumerate(INDICES))
        for i, name in enumerate(names)
    }


def range_spread(item: VersionStudy) -> float:
    """Run-to-run standard deviation of ln(range of O1) over soils."""
    return float(np.log(item.index("range1")).std(ddof=1))


# What the search may change: name, low, high. "stiffness" scales all tyres; "moments" scales both soil
# moments.
SEARCH = (
    ("soil.level", 0.3, 4.0), ("moments", 0.2, 5.0), ("seeder_soil", 0.1, 3.0), ("correlation", 0.05, 5.0),
    ("driver.preview", 4.0, 14.0), ("driver.delay", 0.05, 0.9), ("driver.lag", 0.05, 0.4),
    ("stiffness", 0.4, 3.0), ("exponent", -0.2, 0.8), ("relaxation", 0.05, 1.2),
    ("seeder.mass", 1200.0, 3500.0),
)  # fmt: skip


@dataclass(frozen=True)
class Match:
    """One candidate: parameters by name, ratio ours/paper for each of PAPER, and which are within
    tolerance."""

    parameters: dict[str, float]
    ratios: dict[str, float]
    met: tuple[str, ...]


@dataclass(frozen=True)
class Search:
    """Result of a search: how many candidates, the one that meets most, how often each number was met, and
    the most numbers that a candidate met along with each one."""

    candidates: int
    tolerance: float
    best: Match
    met_share: dict[str, float]
    most_with: dict[str, int]


def search_parameters(
    count: int = 1024,
    rounds: int = 8,
    soils: int = 8,
    seed: int = 1,
    tolerance: float = 0.1,
    workers: int = 2,
) -> Search:
    """Latin hypercube of `count` over SEARCH, then `rounds` of 128 descendants of the best 16.

    Each candidate is one set of parameters for a, b and c; its medians over soils are held against the
    paper's numbers. A search shows what can be met, and only makes likely what cannot.
    """
    generator = np.random.default_rng(seed)
    units = list(qmc.LatinHypercube(len(SEARCH), rng=seed).random(count))
    found: list[tuple[Floats, Match]] = []
    with ThreadPoolExecutor(workers) as pool:
        for _ in range(rounds + 1):
            results = pool.map(lambda unit: _candidate(unit, soils, seed, tolerance), units)
            found += [(u, match) for u, match in zip(units, results, strict=True) if match is not None]
            found.sort(key=lambda pair: -_closeness(pair[1]))
            parents = [pair[0] for pair in found[:16]]
            units = [_descendant(parents[k % len(parents)], generator) for k in range(128)]
    return _summary([match for _, match in found], tolerance)


def _closeness(match: Match) -> float:
    """Soft count of the numbers met: 1 for each within tolerance, falling to 0 at a ratio of e^±0.7."""
    missed = [abs(np.log(ratio)) for name, ratio in match.ratios.items() if name not in match.met]
    return len(match.met) + float(sum(max(0.0, 0.5 * (1.0 - gap / 0.7)) for gap in missed))


def _descendant(parent: Floats, generator: np.random.Generator) -> Floats:
    """A parent moved in a third of its coordinates."""
    moved = generator.random(parent.size) < 0.35
    return np.clip(parent + moved * generator.normal(0.0, 0.12, parent.size), 0.0, 1.0)


def _summary(matches: list[Match], tolerance: float) -> Search:
    names = [paper_name(i) for i in range(len(PAPER))]
    return Search(
        candidates=len(matches),
        tolerance=tolerance,
        best=max(matches, key=lambda match: len(match.met)),
        met_share={name: sum(name in match.met for match in matches) / len(matches) for name in names},
        most_with={name: max((len(m.met) for m in matches if name in m.met), default=0) for name in names},
    )


def paper_name(i: int) -> str:
    """A number of the paper as "index of version"."""
    return f"{PAPER[i].index} of {PAPER[i].version}"


def _searched(unit: Floats) -> dict[str, float]:
    """A place of the unit cube as parameters, spread evenly in the logarithm where both bounds are above
    0."""
    values = {}
    for place, (name, low, high) in zip(unit, SEARCH, strict=True):
        values[name] = float(low * (high / low) ** place if low > 0.0 else low + place * (high - low))
    return values


def _candidate(unit: Floats, soils: int, seed: int, tolerance: float) -> Match | None:
    """The match of one set of parameters; None for a machine that cannot be or a run that diverges."""
    values = _searched(unit)
    plan = _search_plan(values, soils, seed)
    try:
        medians = {label: _medians(values, plan, version) for label, version in VERSIONS.items()}
    except MachineError:
        return None
    ratios, met = {}, []
    for i, figure in enumerate(PAPER):
        ours = medians[figure.version][INDICES.index(figure.index)]
        if not np.isfinite(ours):
            return None
        ratios[paper_name(i)] = float(ours / figure.middle)
        if figure.low * (1.0 - tolerance) <= ours <= figure.high * (1.0 + tolerance):
            met.append(paper_name(i))
    return Match(values, ratios, tuple(met))


def _search_plan(values: dict[str, float], soils: int, seed: int) -> StudyPlan:
    base = StudyPlan(settings=SWEEP_SETTINGS)
    soil = Soil(
        level=values["soil.level"],
        moment1=base.soil.moment1 * values["moments"],
        moment2=base.soil.moment2 * values["moments"] * values["seeder_soil"],
        force2=base.soil.force2 * values["seeder_soil"],
        correlation=values["correlation"],
    )
    driver = dataclasses.replace(
        base.driver,
        preview=values["driver.preview"], delay=values["driver.delay"], lag=values["driver.lag"],
    )  # fmt: skip
    return dataclasses.replace(base, soil=soil, driver=driver, seeds=soils, seed=seed)


def _medians(values: dict[str, float], plan: StudyPlan, version: Version) -> Floats:
    """Medians over soils of all INDICES for one version with a candidate's parameters."""
    machine = machine_of(version)
    replaced = {"seeder.mass": values["seeder.mass"]}
    for axle in ("front", "rear", "seeder"):
        name = f"tyres.{axle}.cornering_stiffness"
        replaced[name] = values["stiffness"] * machine.parameter(name)
        replaced[f"tyres.{axle}.relaxation_length"] = values["relaxation"]
    replaced |= {f"tyres.{axle}.pressure_exponent": values["exponent"] for axle in ("front", "rear")}
    changed = dataclasses.replace(version, replaced=replaced)
    sweep = SweepPlan(seeds=plan.seeds, base=changed, study=plan, workers=1)
    sweep = dataclasses.replace(sweep, parameters=sweep.parameters[:1])
    return np.asarray(np.median(simulate_designs(sweep, np.array([[version.speed]]))[0], axis=0))


def claim_values(study: Study, search: Search | None = None) -> dict[str, Any]:
    """All claims in plain values, for a study of a, b and c."""
    a = next(item for item in study.versions if item.version.label == "a")
    machine, spread = machine_of(VERSIONS["a"]), range_spread(a)
    frequencies = stiffness_frequencies(VERSIONS["c"], np.array([1.0, 2.6, 5.1]))
    return {
        "swing of 0.12 m at 3.1 Hz, g": swing_acceleration(0.12, 3.1),
        "rms displacement behind 0.045 (m/s²)²/Hz at 2.5 to 4 Hz, m": peak_displacement(0.045, 2.5, 4.0),
        "spread of ln(range)": {item.version.label: range_spread(item) for item in study.versions},
        "runs a version to tell 0.12 from 0.11 m": runs_to_tell(0.12, 0.11, spread),
        "pressure exponent for 3.1 to 5 and 7 Hz": [pressure_exponent_for(f / 3.1, 1.2) for f in (5.0, 7.0)],
        "highest natural frequency at stiffness x 1, 2.6, 5.1": frequencies.tolist(),
        "free energy drift, exact and printed": {
            f"{angle:g} rad": [free_energy_drift(machine, s, angle) for s in (EXACT, PRINTED)]
            for angle in (-0.8, 0.4, 0.8)
        },
        "headland gap, m": headland_gap(VERSIONS["b"]),
        "range as printed over exact": asdict(printed_effect(study.plan, VERSIONS["a"])),
        "single changes": {
            name: {e.index: [e.ratio, e.low, e.high] for e in effects}
            for name, effects in step_effects(study.plan).items()
        },
        "search": None if search is None else asdict(search),
    }
