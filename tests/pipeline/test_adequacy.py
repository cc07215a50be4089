"""The verdict's rules one by one, and its error rates by Monte Carlo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from scipy.stats import t as student
from smts_validate.pipeline.adequacy import Rules, facts_of, judge_campaign, judge_pass, passes_needed
from smts_validate.pipeline.bounds import (
    DEVIATION1,
    DEVIATION2,
    R95_LOG_VARIANCE,
    RESPONSES,
    YAW1,
    YAW2,
    PassStatistics,
    ResponseStatistics,
    half_width,
    lower,
    pooled_spread,
    summarise,
    upper,
)
from smts_validate.pipeline.findings import shown_interval

SWING = 0.12  # m
THRESHOLD = 0.15
SCALE = {DEVIATION1: 1.0, DEVIATION2: 1.0, YAW1: 0.3, YAW2: 0.3}  # rad of yaw a metre of deviation
CELLS = [("field1", d) for d in ("east", "west")]


def response(d: float, u: float = 0.005, scale: float = 1.0, **changes: float) -> ResponseStatistics:
    """A response that reads exactly its expectation: M = D²·R95² + u², R95² = swing² + (3.92·u)²."""
    swing, u = SWING * scale, u * scale
    values = {
        "mse": (d * swing) ** 2 + u**2,
        "null_mse": (0.6 * swing) ** 2,
        "r95": float(np.hypot(swing, 3.92 * u)),
        "u2": u**2,
        "u2_range": u**2,
        "u2_absolute": u**2,
        "u2_input": 0.0,
        "n_eff": 20.0,
        "n_eff_range": 15.0,
    }
    return ResponseStatistics(**(values | changes))


def one_pass(index: int, d: float | dict[str, float], u: float = 0.005, **changes: object) -> PassStatistics:
    by_response = d if isinstance(d, dict) else dict.fromkeys(RESPONSES, d)
    field, direction = CELLS[index % 2]
    base = PassStatistics(
        run=f"p{index}",
        field=field,
        direction=direction,
        repeat=1 + index // 2,
        variant="b",
        responses={n: response(by_response[n], u, SCALE[n]) for n in RESPONSES},
        windows_within=1.0,
        consistent=True,
        tractor_testable=True,
    )
    return replace(base, **changes)


def campaign(d: float | dict[str, float], passes: int = 6, **changes: object) -> list[PassStatistics]:
    return [one_pass(i, d, **changes) for i in range(passes)]  # type: ignore[arg-type]


def drawn_campaign(
    generator: np.random.Generator,
    d: dict[str, float],
    u: float,
    passes: int,
    misstated: float,
    consistent: bool,
) -> list[PassStatistics]:
    """Passes as nature would give them: χ²-distributed M, scattering R95, and u² stated wrongly by a
    factor."""
    spread, n_eff, n_range = 0.15, 15.0, 12.0

    def draw(name: str) -> ResponseStatistics:
        scale = SCALE[name]
        exact = response(d[name], u, scale)
        chi2 = generator.chisquare(n_eff) / n_eff
        return replace(
            exact,
            mse=exact.mse * chi2 * np.exp(2.0 * spread * generator.standard_normal()),
            r95=exact.r95 * np.exp(np.sqrt(R95_LOG_VARIANCE / n_range) * generator.standard_normal()),
            u2=exact.u2 * misstated,
            u2_range=exact.u2_range * misstated,
            u2_absolute=exact.u2_absolute * misstated,
            n_eff=n_eff,
            n_eff_range=n_range,
        )

    return [
        replace(one_pass(i, d, u), responses={n: draw(n) for n in RESPONSES}, consistent=consistent)
        for i in range(passes)
    ]


def share(
    value: str, d: dict[str, float], u: float, misstated: float, consistent: bool, repeats: int, passes: int
) -> float:
    generator = np.random.default_rng(int(1000 * u) + passes)
    return float(
        np.mean(
            [
                judge_campaign(
                    drawn_campaign(generator, d, u, passes, misstated, consistent), foresee=False
                ).value
                == value
                for _ in range(repeats)
            ]
        )
    )


ONE_BAD = {
    DEVIATION1: 1.5 * THRESHOLD,
    DEVIATION2: 0.2 * THRESHOLD,
    YAW1: 0.2 * THRESHOLD,
    YAW2: 0.2 * THRESHOLD,
}
ALL_FAIR = dict.fromkeys(RESPONSES, 0.5 * THRESHOLD)
NOISE = pytest.mark.parametrize("u", [0.005, 0.01, 0.02])
STATED = pytest.mark.parametrize(
    ("misstated", "consistent"), [(1.0, True), (0.5, True), (2.0, True), (0.5, False), (2.0, False)]
)


@NOISE
@STATED
def test_a_model_at_one_and_a_half_thresholds_is_accepted_less_often_than_5_percent(
    u: float, misstated: float, consistent: bool
) -> None:
    # One bad response among good ones is the hardest case to see.
    assert share("adequate", ONE_BAD, u, misstated, consistent, 300, 4) < 0.05


@NOISE
@STATED
def test_a_model_at_half_the_threshold_is_rejected_less_often_than_5_percent(
    u: float, misstated: float, consistent: bool
) -> None:
    # Four fair responses give four chances to reject.
    assert share("not adequate", ALL_FAIR, u, misstated, consistent, 300, 4) < 0.05


@pytest.mark.full
@NOISE
@STATED
@pytest.mark.parametrize("passes", [4, 6, 12])
def test_error_rates_hold_in_long_runs_and_for_more_passes(
    u: float, misstated: float, consistent: bool, passes: int
) -> None:
    assert share("adequate", ONE_BAD, u, misstated, consistent, 3000, passes) < 0.05
    assert share("not adequate", ALL_FAIR, u, misstated, consistent, 3000, passes) < 0.05


def test_the_verdict_has_power_a_good_model_passes_and_a_gross_one_fails() -> None:
    good, gross = dict.fromkeys(RESPONSES, 0.03), dict.fromkeys(RESPONSES, 0.45)
    assert share("adequate", good, 0.005, 1.0, True, 200, 6) > 0.9
    assert share("not adequate", gross, 0.005, 1.0, True, 200, 6) > 0.9


def test_bounds_follow_their_published_formulas() -> None:
    passes = campaign(0.1, u=0.01)
    summary = summarise(passes, DEVIATION1)
    mse, u2, r95 = (0.1 * SWING) ** 2 + 0.01**2, 0.01**2, np.hypot(SWING, 3.92 * 0.01)
    assert summary.mean_log == pytest.approx(0.5 * np.log(mse))
    spread2 = 1.0 / (2.0 * 20.0)  # six equal passes: the floor
    variance = spread2 / 6.0 + R95_LOG_VARIANCE / (6 * 15.0)
    width = half_width(summary, 0.95)
    normaliser = R95_LOG_VARIANCE / (6 * 15.0)
    dof = variance**2 / ((spread2 / 6.0) ** 2 / 4 + normaliser**2 / (6 * 15.0))
    assert width == pytest.approx(student.ppf(0.95, dof) * np.sqrt(variance))
    hi, lo = mse * np.exp(2.0 * width), mse * np.exp(-2.0 * width)
    top = hi - min(0.8 * u2, hi / 2.0)
    bottom = max(r95**2 - 3.92**2 * 1.25 * u2, r95**2 / 4.0)
    assert upper(summary, width) == pytest.approx(np.sqrt(top / bottom))
    assert lower(summary, width) == pytest.approx(np.sqrt(max(lo - 1.25 * u2, 0.0)) / r95)


def test_the_asymptotic_variance_of_ln_r95_is_that_of_normal_samples() -> None:
    # var(Q_p) = p(1 − p)/(n f²); the two tails' covariance is (1 − p)²/(n f²) with p = 0.975.
    p, f = 0.975, norm.pdf(norm.ppf(0.975))
    variance = (2.0 * p * (1.0 - p) - 2.0 * (1.0 - p) ** 2) / f**2
    assert variance / (2.0 * norm.ppf(p)) ** 2 == pytest.approx(R95_LOG_VARIANCE, rel=2e-3)
    generator = np.random.default_rng(5)
    low, high = np.quantile(generator.standard_normal((4000, 2000)), [0.025, 0.975], axis=1)
    assert np.var(np.log(high - low)) * 2000 == pytest.approx(R95_LOG_VARIANCE, rel=0.1)


def test_spread_is_pooled_inside_cells_with_its_degrees_of_freedom() -> None:
    cells = [("f", "e"), ("f", "e"), ("f", "w"), ("f", "w"), ("f", "w")]
    values = np.array([1.0, 3.0, 10.0, 11.0, 12.0])
    spread, dof = pooled_spread(values, cells)
    assert dof == 3
    assert spread == pytest.approx((2.0 + 2.0) / 3.0)


def test_without_a_repeated_cell_the_spread_over_all_passes_is_taken() -> None:
    spread, dof = pooled_spread(np.array([1.0, 2.0, 3.0]), [("f", "e"), ("f", "w"), ("g", "e")])
    assert (spread, dof) == (1.0, 2)


def test_known_input_uncertainty_never_helps_a_model_to_be_adequate() -> None:
    def with_input(u2_input: float) -> list[PassStatistics]:
        return [
            replace(
                p, responses={n: replace(r, u2_input=u2_input * r.r95**2) for n, r in p.responses.items()}
            )
            for p in campaign(0.2)
        ]

    sharp, blurred = judge_campaign(with_input(0.0)), judge_campaign(with_input(0.2**2))
    for name in RESPONSES:
        assert blurred.responses[name].hi == sharp.responses[name].hi
        assert (blurred.responses[name].lo or 0.0) <= (sharp.responses[name].lo or 0.0)


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        (lambda ps: ps[:3], "few-passes", "too few passes: 3 of at least 4"),
        (lambda ps: [replace(p, direction="east") for p in ps], "one-direction", "all passes go east"),
        (lambda ps: [replace(p, windows_within=0.85) for p in ps], "alignment", "absorbed by alignment"),
        (lambda ps: [replace(p, tractor_testable=False) for p in ps], "tractor-not-testable", "not testable"),
    ],
)
def test_each_condition_that_is_not_met_makes_it_inconclusive_and_is_named(
    change: Callable[[list[PassStatistics]], list[PassStatistics]], code: str, words: str
) -> None:
    assert judge_campaign(campaign(0.03)).value == "adequate"
    verdict = judge_campaign(change(campaign(0.03)))
    assert verdict.value == "inconclusive"
    assert verdict.codes == (code,)
    assert words in " ".join(verdict.reasons)


def altered(
    passes: list[PassStatistics], change: Callable[[str, ResponseStatistics], ResponseStatistics]
) -> list[PassStatistics]:
    """The passes with every response changed."""
    return [replace(p, responses={n: change(n, r) for n, r in p.responses.items()}) for p in passes]


def test_a_model_that_a_straight_line_nearly_equals_is_not_adequate_however_small_its_error() -> None:
    near = altered(campaign(0.03), lambda _, r: replace(r, null_mse=3.0 * r.mse))
    verdict = judge_campaign(near)
    assert (verdict.value, verdict.codes) == ("inconclusive", ("null",))


def test_one_pass_above_twice_the_threshold_forbids_adequate_and_is_named() -> None:
    passes = [*campaign(0.01, passes=20), one_pass(20, 0.33)]
    verdict = judge_campaign(passes)
    assert verdict.value == "inconclusive"
    assert "single-pass" in verdict.codes
    assert "p20" in " ".join(verdict.reasons)


def test_a_swing_of_under_four_uncertainties_or_two_centimetres_gets_no_percentage() -> None:
    noisy = judge_campaign(campaign(0.05, u=0.5))
    assert noisy.value == "inconclusive"
    assert "small-swing" in noisy.codes
    assert all(j.d is None and j.hi is None for j in noisy.responses.values())
    assert all(j.rmse > 0.0 for j in noisy.responses.values())
    still = altered(
        campaign(0.01, u=0.0001),
        lambda n, r: replace(r, r95=0.019 if n in (DEVIATION1, DEVIATION2) else 0.005),
    )
    assert all(j.d is None for j in judge_campaign(still).responses.values())


def test_a_swing_is_not_seen_through_an_absolute_uncertainty_of_a_metre_however_smooth_it_is() -> None:
    passes = altered(campaign(0.03), lambda n, r: replace(r, u2_absolute=(0.5 * SCALE[n]) ** 2))
    verdict = judge_campaign(passes)
    assert (verdict.value, verdict.codes) == ("inconclusive", ("small-swing",))


def test_noise_of_a_metre_is_never_adequate_nor_not_adequate() -> None:
    assert judge_campaign(campaign(0.05, u=1.0)).value == "inconclusive"
    assert judge_campaign(campaign(3.0, u=1.0)).value == "inconclusive"


def test_gross_error_in_a_single_response_is_enough_to_reject() -> None:
    d = dict.fromkeys(RESPONSES, 0.03) | {YAW2: 0.5}
    verdict = judge_campaign(campaign(d))
    assert verdict.value == "not adequate"
    assert "the seeder's yaw" in verdict.reasons[0]


def test_without_an_independent_steering_series_nothing_is_rejected_either() -> None:
    passes = [replace(p, tractor_testable=False) for p in campaign(0.5)]
    verdict = judge_campaign(passes)
    assert verdict.value == "inconclusive"
    assert "tractor-not-testable" in verdict.codes


def test_inputs_are_named_when_their_uncertainty_alone_stands_against_a_rejection() -> None:
    verdict = judge_campaign(altered(campaign(0.25), lambda _, r: replace(r, u2_input=0.7 * r.mse)))
    assert verdict.value == "inconclusive"
    assert "inputs" in verdict.codes


def test_the_number_of_passes_that_would_decide_does_decide() -> None:
    few = campaign(0.115, passes=4)
    verdict = judge_campaign(few)
    assert verdict.value == "inconclusive"
    assert verdict.passes_needed is not None
    assert verdict.passes_needed > 4
    assert judge_campaign(campaign(0.115, passes=verdict.passes_needed)).value == "adequate"
    assert judge_campaign(campaign(0.115, passes=verdict.passes_needed - 1)).value == "inconclusive"


def test_no_number_of_passes_mends_what_alignment_absorbs() -> None:
    verdict = judge_campaign([replace(p, windows_within=0.5) for p in campaign(0.03)])
    assert verdict.passes_needed is None
    assert "no number of passes" in " ".join(verdict.reasons)


def test_a_model_exactly_at_the_threshold_needs_more_passes_than_anyone_drives() -> None:
    passes = campaign(THRESHOLD)
    summaries = {n: summarise(passes, n) for n in RESPONSES}
    assert passes_needed(facts_of(passes, summaries), summaries, Rules()) is None


def test_one_pass_speaks_of_itself_and_not_of_the_model() -> None:
    for d, value in ((0.05, "adequate"), (0.5, "not adequate")):
        verdict = judge_pass(one_pass(0, d))
        assert (verdict.value, verdict.scope) == (value, "pass")
        assert "not of the model" in verdict.reasons[-1]
    assert judge_pass(one_pass(0, 0.155)).value in ("inconclusive", "not adequate")


def test_a_log_without_a_row_is_inconclusive_with_nothing_judged() -> None:
    for verdict in (judge_pass(None), judge_campaign([])):
        assert verdict.value == "inconclusive"
        assert verdict.codes == ("no-row",)
        assert verdict.responses == {}


def test_a_tractor_alone_is_judged_by_its_own_two_responses() -> None:
    passes = [replace(p, responses={n: p.responses[n] for n in (DEVIATION1, YAW1)}) for p in campaign(0.03)]
    verdict = judge_campaign(passes)
    assert verdict.value == "adequate"
    assert set(verdict.responses) == {DEVIATION1, YAW1}


def test_the_threshold_of_the_campaign_file_decides() -> None:
    assert judge_campaign(campaign(0.08, passes=12)).value == "adequate"
    strict = judge_campaign(campaign(0.08, passes=12), Rules(threshold_percent=5.0))
    assert strict.value == "not adequate"


def test_an_inconsistent_filter_widens_both_bounds() -> None:
    held = judge_campaign(campaign(0.1, u=0.01)).responses[DEVIATION1]
    doubted = judge_campaign(campaign(0.1, u=0.01, consistent=False)).responses[DEVIATION1]
    assert doubted.hi is not None
    assert held.hi is not None
    assert doubted.hi > held.hi
    assert (doubted.lo or 0.0) <= (held.lo or 0.0)


def test_a_pass_without_a_row_says_why_its_stretches_were_left_out() -> None:
    verdict = judge_pass(None, left_out=["83.6 % of it lies outside GNSS gaps, 95 % are needed"])
    assert verdict.value == "inconclusive"
    assert "no row was compared" in verdict.reasons[0]
    assert "83.6 %" in verdict.reasons[0]


def test_a_bound_below_the_figure_that_it_bounds_says_what_was_taken_out_of_it() -> None:
    noisy = judge_pass(one_pass(0, 0.05, u=0.005))
    one = noisy.responses[DEVIATION1]
    assert one.d is not None
    assert one.hi is not None
    assert one.d > one.hi
    assert f"reads {100.0 * one.d:.1f} % before" in noisy.reasons[0]
    near = judge_pass(one_pass(0, 0.149, u=0.015))
    assert "with known measuring error taken out" in near.reasons[0]
    exact = judge_pass(one_pass(0, 0.05, u=1e-6))
    assert "taken out" not in exact.reasons[0]


def test_a_campaign_of_one_pass_has_no_upper_bound_and_says_so() -> None:
    alone = judge_campaign([one_pass(0, 0.05)])
    assert alone.value == "inconclusive"
    assert alone.responses[DEVIATION1].hi == float("inf")
    assert shown_interval(alone.responses[DEVIATION1]) is None
    assert any("no bounds" in reason for reason in alone.reasons)
    assert max(len(reason) for reason in alone.reasons) < 500
