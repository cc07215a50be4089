"""Operating curve: how often this campaign's own design would give each verdict, by true discrepancy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .adequacy import ADEQUATE, INCONCLUSIVE, NOT_ADEQUATE, Rules, judge_campaign
from .bounds import R95_LOG_VARIANCE, PassStatistics, ResponseStatistics, Summary, summarise

RATIOS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)  # true discrepancy over threshold
REPEATS = 200


@dataclass(frozen=True)
class OperatingPoint:
    """Shares of verdicts at one true discrepancy, in units of the threshold."""

    ratio: float
    adequate: float
    not_adequate: float
    inconclusive: float


def operating_curve(
    passes: Sequence[PassStatistics],
    rules: Rules,
    seed: int = 1,
    ratios: Sequence[float] = RATIOS,
    repeats: int = REPEATS,
) -> tuple[OperatingPoint, ...]:
    """Verdicts of simulated campaigns with this campaign's passes, cells, spread and noise.

    Every response has the same true D; l of a pass is ½·ln(D²·R95² + u²) plus the campaign's own
    scatter, R95 varies
    as its effective samples let it. Alignment is taken to hold in all windows.
    """
    compared = [p for p in passes if p.responses]
    if len(compared) < 2:
        return ()
    names = [n for n in compared[0].responses if all(n in p.responses for p in compared)]
    summaries = {n: summarise(compared, n) for n in names}
    generator = np.random.default_rng(seed)
    return tuple(_point(ratio, compared, summaries, rules, generator, repeats) for ratio in ratios)


def _point(
    ratio: float,
    passes: Sequence[PassStatistics],
    summaries: Mapping[str, Summary],
    rules: Rules,
    generator: np.random.Generator,
    repeats: int,
) -> OperatingPoint:
    counts = dict.fromkeys((ADEQUATE, NOT_ADEQUATE, INCONCLUSIVE), 0)
    for _ in range(repeats):
        drawn = [_drawn(p, ratio * rules.threshold, summaries, generator) for p in passes]
        counts[judge_campaign(drawn, rules, foresee=False).value] += 1
    return OperatingPoint(
        ratio, counts[ADEQUATE] / repeats, counts[NOT_ADEQUATE] / repeats, counts[INCONCLUSIVE] / repeats
    )


def _drawn(
    one: PassStatistics, true: float, summaries: Mapping[str, Summary], generator: np.random.Generator
) -> PassStatistics:
    responses = {n: _response(one.responses[n], true, s, generator) for n, s in summaries.items()}
    return replace(one, responses=responses, windows_within=1.0)


def _response(
    own: ResponseStatistics, true: float, summary: Summary, generator: np.random.Generator
) -> ResponseStatistics:
    mse = (true * summary.r95) ** 2 + own.u2
    scatter = float(np.sqrt(summary.spread2)) * generator.standard_normal()
    wobble = float(np.sqrt(R95_LOG_VARIANCE / max(own.n_eff_range, 1.0))) * generator.standard_normal()
    return replace(
        own,
        mse=float(mse * np.exp(2.0 * scatter)),
        r95=float(summary.r95 * np.exp(wobble)),
        deviation=np.empty(0),
    )
