"""The verdict: adequate, not adequate or inconclusive, with its reasons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from .bounds import (
    DEVIATION1,
    DEVIATION2,
    RESPONSES,
    YAW1,
    YAW2,
    PassStatistics,
    Summary,
    half_width,
    lower,
    percentage_possible,
    summarise,
    upper,
)  # fmt: skip

ADEQUATE, NOT_ADEQUATE, INCONCLUSIVE = "adequate", "not adequate", "inconclusive"
MOST_PASSES = 1000
BLOCKING = frozenset(
    {"tractor-not-testable", "small-swing", "alignment", "null"}
)  # more passes do not mend these


@dataclass(frozen=True)
class Rules:
    """What was fixed before data were seen (campaign.toml)."""

    threshold_percent: float = 15.0
    alpha: float = 0.05
    least_passes: int = 4
    least_directions: int = 2
    windows_within: float = 0.90
    of_null: float = 0.5
    single_pass_factor: float = 2.0

    @property
    def threshold(self) -> float:
        """The threshold as a fraction."""
        return self.threshold_percent / 100.0


@dataclass(frozen=True)
class Judged:
    """One response's discrepancy (fractions of R95) with its bounds.

    d, d_null : of the model and of the straight line; lo, hi : bounds for display (one-sided α each);
    lo_decides : the lower bound at α over the number of responses, which alone can make a model not adequate;
    hi_certain : hi if no pass-to-pass spread remained; rmse : absolute, m or rad; None where R95 is too
    small for a
    percentage.
    """

    rmse: float
    r95: float
    u: float
    u_range: float
    u_absolute: float
    u_input: float
    spread: float
    dof: int
    d: float | None
    d_null: float | None
    lo: float | None
    hi: float | None
    lo_decides: float | None
    lo_without_input: float | None
    hi_certain: float | None


@dataclass(frozen=True)
class Verdict:
    """The three-way verdict of one scope, its reasons in words and as codes, and what would decide it."""

    value: str
    scope: str
    reasons: tuple[str, ...]
    codes: tuple[str, ...]
    responses: Mapping[str, Judged]
    passes: int
    passes_needed: int | None
    rules: Rules


def judged(summary: Summary, response: str, rules: Rules, responses: int, spread_known: bool) -> Judged:
    """One response with its bounds; with a single pass no spread is known and the bounds hold u and u_in
    alone."""
    rmse = float(np.exp(summary.mean_log))
    width = half_width(summary, 1.0 - rules.alpha) if spread_known else 0.0
    decides = half_width(summary, 1.0 - rules.alpha / responses) if spread_known else 0.0
    possible = percentage_possible(summary, response)

    def fraction(value: float) -> float | None:
        return value if possible else None

    return Judged(
        rmse=rmse,
        r95=summary.r95,
        u=float(np.sqrt(summary.u2)),
        u_range=float(np.sqrt(summary.u2_range)),
        u_absolute=float(np.sqrt(summary.u2_absolute)),
        u_input=float(np.sqrt(summary.u2_input)),
        spread=float(np.sqrt(summary.spread2)),
        dof=summary.dof,
        d=fraction(rmse / summary.r95),
        d_null=fraction(float(np.exp(summary.mean_log_null)) / summary.r95),
        lo=fraction(lower(summary, width)),
        hi=fraction(upper(summary, width)),
        lo_decides=fraction(lower(summary, decides)),
        lo_without_input=fraction(lower(summary, decides, with_input=False)),
        hi_certain=fraction(upper(summary, 0.0)),
    )


def judge_pass(one: PassStatistics | None, rules: Rules = Rules(), left_out: Sequence[str] = ()) -> Verdict:
    """The verdict of scope `pass`: from its own D, u and u_in; it speaks of this pass and not of the model.

    None: the log held no row to compare; left_out : why its stretches were left out, told in the reason.
    """
    if one is None or not one.responses:
        text = "; ".join(("no row was compared, so there is nothing to judge", *left_out))
        return Verdict(INCONCLUSIVE, "pass", (text,), ("no-row",), {}, 0, None, rules)
    return _judge((one,), rules, "pass")


def judge_campaign(passes: Sequence[PassStatistics], rules: Rules = Rules(), foresee: bool = True) -> Verdict:
    """The verdict of scope `campaign` over the passes of one version of the machine.

    foresee : whether to find how many passes would decide (left out inside Monte Carlo)
    """
    compared = tuple(p for p in passes if p.responses)
    if not compared:
        text = "no pass has a row that was compared"
        return Verdict(INCONCLUSIVE, "campaign", (text,), ("no-row",), {}, 0, None, rules)
    return _judge(compared, rules, "campaign", foresee)


@dataclass(frozen=True)
class Facts:
    """What the rules ask of the passes beside each response's summary.

    directions, cells : distinct ones; within : mean share of windows inside their alignment bound
    single : by response, each pass's √M over R95, with its run
    """

    count: int
    directions: tuple[str, ...]
    cells: int
    within: float
    testable: bool
    single: Mapping[str, Sequence[tuple[float, str]]]


def facts_of(passes: Sequence[PassStatistics], summaries: Mapping[str, Summary]) -> Facts:
    """The facts of some passes."""
    single = {
        n: [(float(np.sqrt(p.responses[n].mse)) / s.r95, p.run) for p in passes] for n, s in summaries.items()
    }
    return Facts(
        count=len(passes),
        directions=tuple(dict.fromkeys(p.direction for p in passes)),
        cells=len({p.cell for p in passes}),
        within=float(np.mean([p.windows_within for p in passes])),
        testable=all(p.tractor_testable for p in passes),
        single=single,
    )


def _judge(passes: tuple[PassStatistics, ...], rules: Rules, scope: str, foresee: bool = False) -> Verdict:
    names = [r for r in RESPONSES if all(r in p.responses for p in passes)]
    summaries = {name: summarise(passes, name) for name in names}
    return decide(summaries, facts_of(passes, summaries), rules, scope, foresee)


def decide(
    summaries: Mapping[str, Summary], facts: Facts, rules: Rules, scope: str, foresee: bool = False
) -> Verdict:
    """The verdict from the responses' summaries and the passes' facts, by the rules."""
    spread_known = scope == "campaign"
    found = {n: judged(s, n, rules, len(summaries), spread_known) for n, s in summaries.items()}
    against = [n for n, j in found.items() if j.lo_decides is not None and j.lo_decides > rules.threshold]
    if against and facts.testable:
        reasons, codes = _condemned(found, against, rules, scope), ("discrepancy",)
        return Verdict(NOT_ADEQUATE, scope, reasons, codes, found, facts.count, None, rules)
    doubts = _doubts(facts, found, rules, scope)
    if not doubts:
        return Verdict(ADEQUATE, scope, _praised(found, rules, scope), (), found, facts.count, None, rules)
    needed = passes_needed(facts, summaries, rules, bool(BLOCKING & doubts.keys())) if foresee else None
    reasons = tuple(doubts.values()) + (_needed_words(needed) if foresee else ()) + _of_this_pass(scope)
    return Verdict(INCONCLUSIVE, scope, reasons, tuple(doubts), found, facts.count, needed, rules)


WORDS = {
    DEVIATION1: "the tractor's deviation",
    DEVIATION2: "the seeder's deviation",
    YAW1: "the tractor's yaw",
    YAW2: "the seeder's yaw",
}


def _percent(value: float | None) -> str:
    return "none" if value is None else f"{100.0 * value:.1f} %"


TAKEN_OUT = " with known measuring error taken out"


def _above_its_bound(one: Judged) -> bool:
    """Whether D is printed above its own upper bound: that has known measuring error removed, D has not."""
    return one.d is not None and one.hi is not None and round(100.0 * one.d, 1) > round(100.0 * one.hi, 1)


def _bounds_words(one: Judged) -> str:
    if one.hi is None or not np.isfinite(one.hi):
        return "no bounds: a single pass of a campaign knows no spread"
    return f"bounds {_percent(one.lo)} to {_percent(one.hi)}{TAKEN_OUT if _above_its_bound(one) else ''}"


def _before_noise(one: Judged) -> str:
    return f"{TAKEN_OUT}; it reads {_percent(one.d)} before" if _above_its_bound(one) else ""


def _of_this_pass(scope: str) -> tuple[str, ...]:
    return ("this speaks of this pass and not of the model",) if scope == "pass" else ()


def _condemned(
    found: Mapping[str, Judged], against: Sequence[str], rules: Rules, scope: str
) -> tuple[str, ...]:
    texts = [
        f"{WORDS[n]} is at least {_percent(found[n].lo_decides)} off with known uncertainty removed, "
        f"over the threshold of {rules.threshold_percent:g} %"
        for n in against
    ]
    return (*texts, *_of_this_pass(scope))


def _praised(found: Mapping[str, Judged], rules: Rules, scope: str) -> tuple[str, ...]:
    worst = max(found, key=lambda n: found[n].hi or 0.0)
    text = (
        f"every response stays under the threshold of {rules.threshold_percent:g} %: the largest upper "
        f"bound is {_percent(found[worst].hi)} ({WORDS[worst]}){_before_noise(found[worst])}"
    )
    return (text, *_of_this_pass(scope))


def _doubts(facts: Facts, found: Mapping[str, Judged], rules: Rules, scope: str) -> dict[str, str]:
    """Every condition for `adequate` that is not met, by code, in words."""
    doubts: dict[str, str] = {}
    if not facts.testable:
        doubts["tractor-not-testable"] = (
            "tractor not testable: no steering series that is independent of the body's motion"
        )
    doubts |= _doubts_of_design(facts, rules) if scope == "campaign" else {}
    doubts |= _doubts_of_bounds(found, rules)
    if not facts.within >= rules.windows_within:
        doubts["alignment"] = (
            f"absorbed by alignment: only {100.0 * facts.within:.0f} % of windows are aligned within their "
            f"prior, {100.0 * rules.windows_within:.0f} % are needed"
        )
    near = [
        n
        for n, j in found.items()
        if j.d is not None and j.d_null is not None and not j.d < rules.of_null * j.d_null
    ]
    if near:
        ratio = max((found[n].d or 0.0) / max(found[n].d_null or 0.0, 1e-12) for n in near)
        doubts["null"] = (
            f"near the null: {', '.join(WORDS[n] for n in near)} reads up to {ratio:.2f} of what a straight "
            f"line reads, under {rules.of_null:g} is needed"
        )
    if scope == "campaign":
        doubts |= _doubts_of_single_passes(facts, found, rules)
    return doubts


def _doubts_of_design(facts: Facts, rules: Rules) -> dict[str, str]:
    doubts = {}
    if facts.count < rules.least_passes:
        doubts["few-passes"] = f"too few passes: {facts.count} of at least {rules.least_passes}"
    if len(facts.directions) < rules.least_directions:
        doubts["one-direction"] = f"one direction: all passes go {facts.directions[0] or 'the same way'}"
    return doubts


def _doubts_of_bounds(found: Mapping[str, Judged], rules: Rules) -> dict[str, str]:
    """Why an upper bound is over the threshold: no percentage, known inputs, measuring noise, spread, or
    the model."""
    doubts: dict[str, list[str]] = {}
    for name, one in found.items():
        if one.hi is None or one.d is None:
            swing = f"{np.rad2deg(one.r95):.2f}°" if name in (YAW1, YAW2) else f"{100.0 * one.r95:.1f} cm"
            reason = f"{WORDS[name]} swings {swing} only, too little beside its uncertainty for a percentage"
            doubts.setdefault("small-swing", []).append(reason)
        elif not one.hi < rules.threshold:
            code = _cause(one, rules)
            text = f"{WORDS[name]} {_percent(one.d)}, {_bounds_words(one)}"
            doubts.setdefault(code, []).append(text)
    return {code: CAUSES[code] + "; ".join(texts) for code, texts in doubts.items()}


CAUSES = {
    "small-swing": "noise: ",
    "inputs": "inputs: the uncertainty of steering, start and parameters is what stands between: ",
    "noise": "noise: measuring uncertainty is what stands between: ",
    "spread": "spread: the scatter of the passes is what stands between: ",
    "borderline": "too near the threshold to say: ",
}


def _cause(one: Judged, rules: Rules) -> str:
    if one.lo_without_input is not None and one.lo_without_input > rules.threshold:
        return "inputs"
    if one.hi_certain is not None and one.hi_certain < rules.threshold:
        return "spread"
    noise_only = float(np.sqrt(max(one.rmse**2 - one.u**2, 0.0))) / one.r95
    if noise_only < rules.threshold and one.u > 0.5 * rules.threshold * one.r95:
        return "noise"
    return "borderline"


def _doubts_of_single_passes(facts: Facts, found: Mapping[str, Judged], rules: Rules) -> dict[str, str]:
    limit = rules.single_pass_factor * rules.threshold
    over = [run for n, j in found.items() if j.d is not None for d, run in facts.single[n] if d > limit]
    names = ", ".join(dict.fromkeys(over))
    return {"single-pass": f"spread: over twice the threshold in {names}"} if over else {}


def passes_needed(
    facts: Facts, summaries: Mapping[str, Summary], rules: Rules, blocked: bool = False
) -> int | None:
    """The least number of passes like these whose intervals would decide, None when no number would.

    blocked : something that more passes do not mend stands against `adequate`; only `not adequate` can
    be decided.

    The means, spread and uncertainties stay as they are; only n, the degrees of freedom and the normaliser's
    variance follow the number of passes.
    """
    cells = max(facts.cells, rules.least_directions)
    usable = {n: s for n, s in summaries.items() if percentage_possible(s, n)}
    if not usable:
        return None
    level = 1.0 - rules.alpha / len(usable)
    for count in _counts(max(facts.count, rules.least_passes)):
        dof = max(count - cells, 1)
        high = [upper(s, half_width(s, 1.0 - rules.alpha, count, dof)) for s in usable.values()]
        low = [lower(s, half_width(s, level, count, dof)) for s in usable.values()]
        all_under = not blocked and len(usable) == len(summaries) and max(high) < rules.threshold
        if all_under or max(low) > rules.threshold:
            return count
    return None


def _counts(first: int) -> Iterator[int]:
    """Numbers of passes to try: each up to 30, then in steps of a tenth."""
    count = first
    while count <= MOST_PASSES:
        yield count
        count += max(1, count // 10 if count >= 30 else 1)


def _needed_words(needed: int | None) -> tuple[str, ...]:
    if needed is not None:
        return (f"about {needed} passes like these would decide",)
    return ("no number of passes like these would decide: better inputs or measurements would",)
