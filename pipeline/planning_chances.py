"""Chances of each verdict for a planned campaign, from its pilots' numbers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .adequacy import ADEQUATE, INCONCLUSIVE, NOT_ADEQUATE, Rules, judge_campaign
from .bounds import PassStatistics, ResponseStatistics

Floats = NDArray[np.float64]

RATIOS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0)  # of the model's own discrepancy over the threshold
SIMULATED = 200  # campaigns a point


@dataclass(frozen=True)
class Chance:
    """Shares of verdicts of campaigns with `repeats` in each cell, at the model's own discrepancy
    `percent`; `doubts`: how often each reason stood in the way of a decision (shares of the inconclusive
    ones)."""

    repeats: int
    ratio: float
    percent: float
    adequate: float
    not_adequate: float
    inconclusive: float
    doubts: Mapping[str, float]


def chances(
    pilots: Sequence[PassStatistics],
    cells: Sequence[tuple[str, str]],
    repeats: Sequence[int],
    rules: Rules,
    seed: int,
    ratios: Sequence[float] = RATIOS,
    simulated: int = SIMULATED,
) -> tuple[Chance, ...]:
    """Chances for each number of repeats and each true discrepancy.

    A planned pass is a pilot drawn at random, whose mean square is M = (M̄ + D²·R̄²)·e^{2z}: M̄ and R̄
    are the pilots' geometric means, D the model's own discrepancy, z the drawn pilot's scatter about M̄
    on the scale of l = ½·ln M, widened by the degree of freedom that M̄ takes. Every response has the same D.
    """
    generator = np.random.default_rng(seed)
    return tuple(
        _chance(pilots, cells, count, ratio, rules, generator, simulated)
        for count in repeats
        for ratio in ratios
    )


def _chance(
    pilots: Sequence[PassStatistics],
    cells: Sequence[tuple[str, str]],
    repeats: int,
    ratio: float,
    rules: Rules,
    generator: np.random.Generator,
    simulated: int,
) -> Chance:
    values: Counter[str] = Counter()
    doubts: Counter[str] = Counter()
    for _ in range(simulated):
        drawn = campaign(pilots, cells, repeats, ratio * rules.threshold, generator)
        verdict = judge_campaign(drawn, rules, foresee=False)
        values[verdict.value] += 1
        doubts.update(verdict.codes if verdict.value == INCONCLUSIVE else ())
    undecided = max(values[INCONCLUSIVE], 1)
    return Chance(
        repeats=repeats,
        ratio=ratio,
        percent=ratio * rules.threshold_percent,
        adequate=values[ADEQUATE] / simulated,
        not_adequate=values[NOT_ADEQUATE] / simulated,
        inconclusive=values[INCONCLUSIVE] / simulated,
        doubts={code: count / undecided for code, count in doubts.most_common()},
    )


def campaign(
    pilots: Sequence[PassStatistics],
    cells: Sequence[tuple[str, str]],
    repeats: int,
    true: float,
    generator: np.random.Generator,
) -> list[PassStatistics]:
    """One simulated campaign: `repeats` passes in every cell; true : the model's own discrepancy, a
    fraction of R95."""
    drawn = generator.integers(len(pilots), size=len(cells) * repeats)
    found = []
    for k, pilot in enumerate(drawn):
        field, direction = cells[k % len(cells)]
        responses = {name: _response(pilots, int(pilot), name, true) for name in pilots[0].responses}
        found.append(
            replace(
                pilots[int(pilot)], run=f"planned-{k}", field=field, direction=direction,
                repeat=k // len(cells) + 1, responses=responses,
            )
        )  # fmt: skip
    return found


def _response(pilots: Sequence[PassStatistics], pilot: int, name: str, true: float) -> ResponseStatistics:
    members = [p.responses[name] for p in pilots]
    logs = np.array([0.5 * np.log(max(m.mse, 1e-300)) for m in members])
    widened = np.sqrt(logs.size / max(logs.size - 1, 1))
    scatter = float(widened * (logs[pilot] - logs.mean()))
    r95 = float(np.exp(np.mean([np.log(m.r95) for m in members])))
    own = float(np.exp(2.0 * logs.mean())) + (true * r95) ** 2
    return replace(members[pilot], mse=own * float(np.exp(2.0 * scatter)))
