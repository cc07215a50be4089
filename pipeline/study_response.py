"""What a sweep answers: response surfaces, Sobol sensitivities, and the straightest design within its
bounds."""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import Bounds, minimize

from .study_indices import INDICES
from .study_plan import StudyError, machine_of
from .study_sweep import Sweep, SweepPlan, simulate_designs

Floats = NDArray[np.float64]
CONFIDENCE = 0.95
STARTS = 16  # of the search for the best design


@dataclass(frozen=True)
class Surface:
    """A full quadratic of ln(index) in the parameters scaled to −1..1: ln y = c·[1, u_i, u_i·u_j].

    coefficients (terms,); r2: share of the variance of ln(index) that it explains; bounds (parameters, 2)
    """

    index: str
    names: tuple[str, ...]
    bounds: Floats
    coefficients: Floats
    r2: float

    def __call__(self, designs: Floats) -> Floats:
        """The index at designs (..., parameters)."""
        return np.asarray(np.exp(_terms(_scaled(np.asarray(designs), self.bounds)) @ self.coefficients))


@dataclass(frozen=True)
class Sensitivity:
    """Sobol indices of ln(index), one a parameter: first order and total, each with a bootstrap interval
    (2,)."""

    names: tuple[str, ...]
    first: Floats
    first_interval: Floats
    total: Floats
    total_interval: Floats


@dataclass(frozen=True)
class Effect:
    """Change of an index between two designs on the same soils: ratio (geometric mean) and its 95 %
    interval."""

    index: str
    ratio: float
    low: float
    high: float


@dataclass(frozen=True)
class BestDesign:
    """The straightest design within bounds, against the base: values by name, on_bound: which lie on one, and
    effects on straightness by ratio best/base over fresh soils."""

    index: str
    values: dict[str, float]
    on_bound: tuple[str, ...]
    effects: tuple[Effect, ...]
    soils: int


def _scaled(designs: Floats, bounds: Floats) -> Floats:
    return np.asarray(2.0 * (designs - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0]) - 1.0)


def _terms(unit: Floats) -> Floats:
    size = unit.shape[-1]
    columns = [np.ones(unit.shape[:-1]), *(unit[..., i] for i in range(size))]
    columns += [unit[..., i] * unit[..., j] for i in range(size) for j in range(i, size)]
    return np.stack(columns, axis=-1)


def fit_surface(sweep: Sweep, index: str = "r95_1") -> Surface:
    """Least squares of ln(index) over a sweep's designs. Raises StudyError with fewer designs than terms."""
    terms = _terms(_scaled(sweep.designs, sweep.plan.bounds))
    values = np.log(sweep.over_soils(index))
    good = np.isfinite(values)
    if good.sum() < terms.shape[1]:
        raise StudyError(
            f"{int(good.sum())} designs are too few for a response surface in "
            f"{len(sweep.plan.names)} parameters; use a count of {2 * terms.shape[1]} or more"
        )
    coefficients = np.asarray(np.linalg.lstsq(terms[good], values[good], rcond=None)[0], dtype=np.float64)
    residual = values[good] - terms[good] @ coefficients
    spread = float(np.var(values[good]))
    r2 = 1.0 - float(np.var(residual)) / spread if spread > 0.0 else 1.0
    return Surface(index, sweep.plan.names, sweep.plan.bounds, coefficients, r2)


def sensitivities(plan: SweepPlan, index: str = "r95_1", samples: int = 128) -> Sensitivity:
    """Sobol indices of ln(index) by direct simulation: samples·(parameters + 2) designs, each over all soils.

    samples must be a power of 2, else StudyError; their intervals are wide below some hundreds.
    """
    column = INDICES.index(index)

    def response(unit: Floats) -> Floats:
        values = simulate_designs(plan, unit.T)[:, :, column]
        return np.asarray(np.log(values).mean(axis=1))

    return _sobol(plan, response, samples)


def surface_sensitivities(plan: SweepPlan, surface: Surface, samples: int = 4096) -> Sensitivity:
    """Sobol indices of a response surface, as good as the surface is (`surface.r2`), with narrow
    intervals."""
    return _sobol(plan, lambda unit: np.log(surface(unit.T)), samples)


def _sobol(plan: SweepPlan, response: Callable[[Floats], Floats], samples: int) -> Sensitivity:
    """Saltelli's estimator with bootstrap intervals over the plan's ranges.

    Source: A. Saltelli et al., Comput. Phys. Commun. 181 (2010); scipy.stats.sobol_indices.
    """
    if len(plan.parameters) < 2:
        raise StudyError("sensitivities share the variance between two parameters or more")
    if samples < 2 or samples & (samples - 1):
        raise StudyError(f"samples is {samples}; Sobol sensitivities need a power of 2")
    ranges = [stats.uniform(low, high - low) for low, high in plan.bounds]
    found = stats.sobol_indices(func=response, n=samples, dists=ranges, rng=plan.study.seed)
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        # a parameter without any effect has no interval: NaN, and that says it
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        spread = found.bootstrap(confidence_level=CONFIDENCE, n_resamples=999)
    return Sensitivity(
        plan.names,
        np.asarray(found.first_order),
        np.stack(spread.first_order.confidence_interval, axis=-1),
        np.asarray(found.total_order),
        np.stack(spread.total_order.confidence_interval, axis=-1),
    )


def best_design(sweep: Sweep, index: str = "r95_1", soils: int = 64) -> BestDesign:
    """The design within bounds that the response surface holds straightest, judged anew on fresh soils.

    The surface is minimised from 16 starts (L-BFGS-B); best and base then run over `soils` soils that the
    sweep has not seen, the same for both, and effects are geometric means with Student's t intervals over
    soils.
    """
    surface = fit_surface(sweep, index)
    bounds = sweep.plan.bounds
    generator = np.random.default_rng(sweep.plan.study.seed)
    starts = bounds[:, 0] + generator.random((STARTS, len(bounds))) * (bounds[:, 1] - bounds[:, 0])
    found = [_descend(surface, start) for start in starts]
    best = min(found, key=lambda place: float(surface(place)))
    edge = 1e-3 * (bounds[:, 1] - bounds[:, 0])
    on_edge = (best - bounds[:, 0] < edge) | (bounds[:, 1] - best < edge)
    names = sweep.plan.names
    return BestDesign(
        index=index,
        values={name: float(value) for name, value in zip(names, best, strict=True)},
        on_bound=tuple(name for name, edged in zip(names, on_edge, strict=True) if edged),
        effects=paired_effects(sweep.plan, best, base_values(sweep.plan), soils),
        soils=soils,
    )


def _descend(surface: Surface, start: Floats) -> Floats:
    """Local minimum of the surface within its bounds; the search runs in the scaled parameters."""
    low, width = surface.bounds[:, 0], surface.bounds[:, 1] - surface.bounds[:, 0]

    def height(unit: Floats) -> float:
        return float(np.log(surface(low + unit * width)))

    unit = np.asarray((start - low) / width, dtype=np.float64)
    found = minimize(height, unit, method="L-BFGS-B", bounds=Bounds(np.zeros(len(low)), np.ones(len(low))))
    return np.asarray(low + np.clip(found.x, 0.0, 1.0) * width)


def base_values(plan: SweepPlan) -> Floats:
    """The base version's values of a plan's parameters."""
    special = {"speed": plan.base.speed, "soil.level": plan.study.soil.level}
    special |= {f"driver.{name}": value for name, value in vars(plan.study.driver).items()}
    machine = machine_of(plan.base)
    return np.array([special[n] if n in special else machine.parameter(n) for n in plan.names])


def paired_effects(plan: SweepPlan, changed: Floats, base: Floats, soils: int) -> tuple[Effect, ...]:
    """Effects of one design against another on all indices, over the same fresh soils."""
    fresh = dataclasses.replace(plan.study, seed=plan.study.seed + 1_000_000)
    indices = simulate_designs(dataclasses.replace(plan, study=fresh, seeds=soils), np.stack([changed, base]))
    effects = []
    for column, index in enumerate(INDICES):
        logs = np.log(indices[0, :, column]) - np.log(indices[1, :, column])
        half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, soils - 1) * logs.std(ddof=1) / np.sqrt(soils))
        mean = float(logs.mean())
        effects.append(
            Effect(index, float(np.exp(mean)), float(np.exp(mean - half)), float(np.exp(mean + half)))
        )
    return tuple(effects)


def single_effects(plan: SweepPlan, soils: int = 64, index: str = "r95_1") -> dict[str, Effect]:
    """Effect on one index of moving each parameter alone from its low to its high bound, the rest at the
    base."""
    result = {}
    for i, name in enumerate(plan.names):
        low, high = base_values(plan), base_values(plan)
        low[i], high[i] = plan.bounds[i]
        result[name] = paired_effects(plan, high, low, soils)[INDICES.index(index)]
    return result


def answer_values(
    best: BestDesign, sensitivity: Sensitivity | None, singles: dict[str, Effect]
) -> dict[str, Any]:
    """The answer in plain JSON values."""
    values: dict[str, Any] = {
        "best": asdict(best),
        "single": {name: asdict(e) for name, e in singles.items()},
    }
    if sensitivity is not None:
        values["sobol"] = {
            name: {
                "first": float(sensitivity.first[i]),
                "first_interval": sensitivity.first_interval[i].tolist(),
                "total": float(sensitivity.total[i]),
                "total_interval": sensitivity.total_interval[i].tolist(),
            }
            for i, name in enumerate(sensitivity.names)
        }
    return values
