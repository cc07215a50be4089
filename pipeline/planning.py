"""Forecast of a planned campaign: will these repeats be enough, and are the sensors good enough?

A few twins of the planned passes go through the whole chain (`planning_pilots`); from what they show,
campaigns of any number of repeats are simulated at several true discrepancies (`planning_chances`), and
the standard deviation with which the parameters could be identified follows from the pilots' information.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.machine import Machine
from .adequacy import Rules
from .batch_executors import SerialExecutor, WorkerSlots
from .bounds import PassStatistics
from .planning_chances import Chance, chances
from .planning_pilots import PARAMETERS, Pilot, fly, known_parameters
from .replay_settings import ReplaySettings
from .twin import true_machine
from .twin_campaign import CampaignPlan
from .twin_plan import TwinPlan
from .twin_tables import PlanError

Floats = NDArray[np.float64]
Say = Callable[[str], None]

REPEATS = (1, 2, 3, 5, 8)
LEAST_PILOTS = 6  # of a variant: their scatter is the campaign's
PILOT_SEEDS = 100_000  # pilots are not the passes that the same plan would write
OFTEN = 0.8  # of campaigns: what counts as a good chance
OF_SENSORS = ("noise", "small-swing")  # reasons that better sensors mend
IN_THE_WAY = {
    "alignment": "windows whose alignment goes beyond the stated doubt of steering and start (a rough soil, or "
    "sensors worse than stated)",
    "borderline": "a discrepancy too near the threshold",
    "few-passes": "too few passes",
    "inputs": "the uncertainty of steering, start and parameters",
    "noise": "measuring uncertainty",
    "null": "a model hardly better than a straight line",
    "one-direction": "passes of one direction only",
    "single-pass": "single passes over twice the threshold",
    "small-swing": "a swing too small beside its uncertainty",
    "spread": "the scatter of the passes",
    "tractor-not-testable": "no steering series to drive the model with",
}
SURE = 0.25  # relative sd under which a parameter counts as identifiable
COLLINEAR = 0.98  # |correlation| over which two parameters cannot be told apart


@dataclass(frozen=True)
class Reading:
    """What a right model reads in one response, in percent of its R95: in all, and what measuring error,
    inputs (steering, start, stated parameters) and the rest (soil) make of it; r95 in m or rad."""

    response: str
    r95: float
    total: float
    measuring: float
    inputs: float
    soil: float


@dataclass(frozen=True)
class Precision:
    """One parameter: its stated value, and its relative standard deviation (percent) by number of
    repeats, all others free; alone: all others known, at the planned repeats. partner: the most
    correlated one; None: no information."""

    parameter: str
    value: float
    sd_percent: Mapping[int, float | None]
    alone_percent: float | None
    partner: str
    correlation: float
    identifiable: bool


@dataclass(frozen=True)
class VariantForecast:
    """Forecast of one version of the machine."""

    variant: str
    pilots: int
    failed: tuple[str, ...]
    readings: tuple[Reading, ...]
    chances: tuple[Chance, ...]
    parameters: tuple[Precision, ...]
    advice: tuple[str, ...]


@dataclass(frozen=True)
class Forecast:
    """Forecast of a campaign: one part a version; cells are fields × directions."""

    repeats: int
    cells: tuple[tuple[str, str], ...]
    threshold_percent: float
    alpha: float
    variants: tuple[VariantForecast, ...]

    def document(self) -> dict[str, Any]:
        """Plain JSON values."""
        return asdict(self)


def forecast(
    campaign: CampaignPlan,
    repeats: Sequence[int] = REPEATS,
    pilots: int = LEAST_PILOTS,
    workers: int = 2,
    parameters: Sequence[str] = PARAMETERS,
    say: Say = lambda message: None,
) -> Forecast:
    """Fly the pilots (at least one a cell, on `workers` processes; 0: in this one) and forecast each variant.

    Raises PlanError when no pilot of a variant has a row that can be compared.
    """
    tries = sorted({*repeats, campaign.repeats})
    if not (tries[0] >= 1 and pilots >= 2):
        raise PlanError("repeats must be 1 or more, pilots 2 or more")
    cells = tuple((field, direction) for field in campaign.fields for direction in campaign.directions)
    rules = Rules(threshold_percent=campaign.threshold_percent, alpha=campaign.alpha)
    found = []
    with SerialExecutor() if workers == 0 else WorkerSlots(workers) as executor:
        for variant in campaign.variants:
            say(f"flying pilots of version {variant}")
            plans = _pilot_plans(campaign, variant, max(pilots, len(cells)))
            found.append(_variant(campaign, variant, plans, tries, cells, rules, parameters, executor))
    return Forecast(campaign.repeats, cells, rules.threshold_percent, rules.alpha, tuple(found))


def _pilot_plans(campaign: CampaignPlan, variant: str, count: int) -> list[TwinPlan]:
    """`count` plans of a variant, its cells in turn."""
    one = replace(campaign, variants={variant: campaign.variants[variant]}, repeats=1)
    plans = [plan for plan, _ in one.passes()]
    return [plans[k % len(plans)] for k in range(count)]


def _variant(
    campaign: CampaignPlan,
    variant: str,
    plans: Sequence[TwinPlan],
    repeats: Sequence[int],
    cells: Sequence[tuple[str, str]],
    rules: Rules,
    wanted: Sequence[str],
    executor: Executor,
) -> VariantForecast:
    machine = Machine.from_mapping(true_machine(replace(plans[0], truth={})), plans[0].run.tyre_pressure_mpa)
    names = known_parameters(machine, wanted)
    settings = replace(ReplaySettings(), horizon=campaign.horizon)
    first = campaign.seed + PILOT_SEEDS
    futures = [executor.submit(fly, p, first + k, names, settings) for k, p in enumerate(plans)]
    flown, failed = _collected(futures)
    if len(flown) < 2:
        reason = failed[0] if failed else "no row of 60 m at 90 % of the nominal speed"
        raise PlanError(f"version {variant}: fewer than two pilots could be compared: {reason}")
    statistics = [pilot.statistics for pilot in flown]
    chance = chances(statistics, cells, repeats, rules, campaign.seed)
    per_pass = np.mean([p.information for p in flown], axis=0)
    scale = np.mean([p.scale for p in flown], axis=0)
    precision = precisions(per_pass, names, machine, len(cells), repeats, campaign.repeats, scale)
    reading = readings(statistics)
    words = advice(statistics, reading, chance, campaign.repeats, rules)
    return VariantForecast(variant, len(flown), failed, reading, chance, precision, words)


def _collected(futures: Sequence[Future[Pilot | None]]) -> tuple[list[Pilot], tuple[str, ...]]:
    """Pilots that could be compared, and why others could not."""
    flown, failed = [], []
    for k, future in enumerate(futures):
        try:
            pilot = future.result()
        except (ValueError, RuntimeError) as error:
            failed.append(f"pilot {k}: {error}")
            continue
        if pilot is None:
            failed.append(f"pilot {k}: no row that can be compared")
        else:
            flown.append(pilot)
    return flown, tuple(failed)


def readings(pilots: Sequence[PassStatistics]) -> tuple[Reading, ...]:
    """What a right model reads, and why: root mean squares over the pilots, percent of R95."""
    found = []
    for name in pilots[0].responses:
        members = [p.responses[name] for p in pilots]
        r95 = float(np.exp(np.mean([np.log(m.r95) for m in members])))
        total, measuring, inputs = (
            float(np.mean([getattr(m, key) for m in members])) for key in ("mse", "u2", "u2_input")
        )
        parts = (total, measuring, inputs, max(total - measuring - inputs, 0.0))
        found.append(Reading(name, r95, *(100.0 * float(np.sqrt(part)) / r95 for part in parts)))
    return tuple(found)


def precisions(
    per_pass: Floats,
    names: Sequence[str],
    machine: Machine,
    cells: int,
    repeats: Sequence[int],
    planned: int,
    scale: Floats | None = None,
) -> tuple[Precision, ...]:
    """Standard deviations from `cells`·n passes of information F: √diag(F⁻¹/(cells·n) + F⁻¹ggᵀF⁻¹).

    per_pass : (P, P) information F of one pass on relative changes; scale : (P,) score g of one pass for one
    standard deviation of the steering's scale, the same in all passes: what it costs does not fall with n.
    alone: all others known, √(1/F_ii/(cells·n) + (g_i/F_ii)²)
    """
    covariance = _inverse(per_pass * cells)
    scale = np.zeros(len(names)) if scale is None else scale
    shift = np.nan_to_num(covariance, posinf=0.0) @ scale * cells
    found = []
    for i, name in enumerate(names):
        variance = covariance[i, i]
        sure = bool(np.isfinite(variance))
        sds = {n: 100.0 * float(np.sqrt(variance / n + shift[i] ** 2)) if sure else None for n in repeats}
        partner, correlation = _partner(covariance, i, names)
        sd = sds[planned]
        found.append(
            Precision(
                parameter=name,
                value=machine.parameter(name),
                sd_percent=sds,
                alone_percent=_alone(per_pass[i, i], cells * planned, float(scale[i])),
                partner=partner,
                correlation=correlation,
                identifiable=sd is not None and sd < 100.0 * SURE and abs(correlation) < COLLINEAR,
            )
        )
    return tuple(found)


def _alone(information: float, passes: int, scale: float) -> float | None:
    if not information > 0.0:
        return None
    return 100.0 * float(np.sqrt(1.0 / (information * passes) + (scale / information) ** 2))


def _inverse(information: Floats) -> Floats:
    """Inverse on the scale of its diagonal; infinite variance for parameters in directions without
    information."""
    size = np.sqrt(np.diag(information))
    seen = size > 0.0
    scaled = information[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
    values, vectors = np.linalg.eigh(scaled)
    poor = values < 1e-12 * max(float(values.max(initial=0.0)), 1e-300)
    inverse = (vectors[:, ~poor] / values[~poor]) @ vectors[:, ~poor].T / np.outer(size[seen], size[seen])
    lost = (vectors[:, poor] ** 2).sum(axis=1) > 1e-6
    inverse[lost, lost] = np.inf
    out = np.full(information.shape, 0.0)
    np.fill_diagonal(out, np.inf)
    out[np.ix_(seen, seen)] = inverse
    return out


def _partner(covariance: Floats, i: int, names: Sequence[str]) -> tuple[str, float]:
    """The parameter most correlated with parameter i, and the correlation; ("", 0) where there is none."""
    sd = np.sqrt(np.diag(covariance))
    if not np.isfinite(sd[i]) or sd.size < 2:
        return "", 0.0
    row = np.where(np.isfinite(sd), covariance[i] / (sd[i] * np.where(np.isfinite(sd), sd, 1.0)), 0.0)
    row[i] = 0.0
    best = int(np.argmax(np.abs(row)))
    return names[best], float(row[best])


def advice(
    pilots: Sequence[PassStatistics],
    reading: Sequence[Reading],
    chance: Sequence[Chance],
    planned: int,
    rules: Rules,
) -> tuple[str, ...]:
    """The two questions answered in words: are the repeats enough, are the sensors good enough."""
    return (*_on_repeats(chance, planned), *_on_sensors(pilots, reading, chance, rules))


def _on_repeats(chance: Sequence[Chance], planned: int) -> Iterator[str]:
    here = {c.ratio: c for c in chance if c.repeats == planned}
    right, wrong = here[min(here)], here[max(here)]
    yield (
        f"with {planned} repeats in a cell a right model is found adequate in {_share(right.adequate)} of "
        f"campaigns, and one {wrong.percent:g} % off is found not adequate in {_share(wrong.not_adequate)}"
    )
    if right.adequate >= OFTEN:
        return
    more = [c.repeats for c in chance if c.ratio == right.ratio and c.adequate >= OFTEN]
    yield (
        f"{min(more)} repeats would find a right model adequate in {_share(OFTEN)} of campaigns or more"
        if more
        else f"no number of repeats tried finds a right model adequate in {_share(OFTEN)} of campaigns"
    )
    if right.doubts:
        yield "what stands in the way: " + "; ".join(IN_THE_WAY.get(code, code) for code in right.doubts)


def _on_sensors(
    pilots: Sequence[PassStatistics], reading: Sequence[Reading], chance: Sequence[Chance], rules: Rules
) -> Iterator[str]:
    worst = max(reading, key=lambda r: r.measuring)
    right = max((c for c in chance if c.ratio == min(c.ratio for c in chance)), key=lambda c: c.repeats)
    hindered = any(right.inconclusive * right.doubts.get(code, 0.0) > 1.0 - OFTEN for code in OF_SENSORS)
    spoilt = [
        p for p in pilots if max(np.sqrt(r.mse) / r.r95 for r in p.responses.values()) > 2.0 * rules.threshold
    ]
    if spoilt:
        yield (
            f"in {len(spoilt)} of {len(pilots)} pilots a right model reads more than twice the threshold: "
            "with these sensors the measured motion itself is not to be trusted"
        )
    enough = worst.measuring < 0.5 * rules.threshold_percent and not hindered and not spoilt
    yield (
        f"measuring error alone reads up to {worst.measuring:.1f} % ({worst.response}): the sensors are "
        f"{'good enough' if enough else 'not good enough'} for a threshold of {rules.threshold_percent:g} %"
    )


def _share(share: float) -> str:
    return f"{100.0 * share:.0f} %"
