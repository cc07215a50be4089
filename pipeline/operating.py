"""Operating curve: how often this campaign's own design would give each verdict, by true discrepancy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .adequacy import ADEQUATE, INCONCLUSIVE, NOT_ADEQUATE, Facts, Rules, decide, facts_of
from .bounds import PassStatistics, Summary, pooled_spread, summarise

Floats = NDArray[np.float64]

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

    Every response has the same true D; l of a pass is ½·ln(D²·R95² + u²) plus the campaign's own scatter, R95
    varies as its effective samples let it. Alignment is taken to hold in all windows.
    """
    compared = [p for p in passes if p.responses]
    if len(compared) < 2:
        return ()
    names = [n for n in compared[0].responses if all(n in p.responses for p in compared)]
    summaries = {n: summarise(compared, n) for n in names}
    facts = replace(facts_of(compared, summaries), within=1.0)
    cells = [p.cell for p in compared]
    generator = np.random.default_rng(seed)
    return tuple(_point(r, summaries, facts, cells, rules, generator, repeats) for r in ratios)


def _point(
    ratio: float,
    summaries: Mapping[str, Summary],
    facts: Facts,
    cells: Sequence[tuple[str, str]],
    rules: Rules,
    generator: np.random.Generator,
    repeats: int,
) -> OperatingPoint:
    counts = dict.fromkeys((ADEQUATE, NOT_ADEQUATE, INCONCLUSIVE), 0)
    drawn = {
        name: _drawn(summary, ratio * rules.threshold, cells, generator, repeats)
        for name, summary in summaries.items()
    }
    for k in range(repeats):
        single = {name: [(float(one.worst[k]), "")] for name, one in drawn.items()}
        now = {name: one.summary(summaries[name], k) for name, one in drawn.items()}
        counts[decide(now, replace(facts, single=single), rules, "campaign").value] += 1
    return OperatingPoint(
        ratio, counts[ADEQUATE] / repeats, counts[NOT_ADEQUATE] / repeats, counts[INCONCLUSIVE] / repeats
    )


@dataclass(frozen=True)
class _Drawn:
    """One response of simulated campaigns, each (repeats,): mean of ln √M, R95, spread, and the worst pass's own D."""

    mean_log: Floats
    r95: Floats
    spread2: Floats
    worst: Floats

    def summary(self, of: Summary, k: int) -> Summary:
        """Of campaign k, in all else that of the real one."""
        return replace(
            of, mean_log=float(self.mean_log[k]), r95=float(self.r95[k]), spread2=float(self.spread2[k])
        )


def _drawn(
    summary: Summary,
    true: float,
    cells: Sequence[tuple[str, str]],
    generator: np.random.Generator,
    repeats: int,
) -> _Drawn:
    expected = 0.5 * np.log((true * summary.r95) ** 2 + summary.u2)
    logs = expected + np.sqrt(summary.spread2) * generator.standard_normal((repeats, len(cells)))
    r95 = summary.r95 * np.exp(np.sqrt(summary.log_r95_variance) * generator.standard_normal(repeats))
    spread2 = np.maximum(pooled_spread(logs, cells)[0], summary.spread_floor)
    return _Drawn(logs.mean(axis=1), r95, spread2, np.exp(logs.max(axis=1)) / r95)
