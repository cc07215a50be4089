"""The companion metrics against others' implementations, closed forms and published ratings."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import hydroeval
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from objective_rating_metrics import rating as other_iso
from smts_validate.pipeline.metrics import METRICS, Metric, Pair, companions
from smts_validate.pipeline.metrics._warping import trace_back, warp_costs, warped
from smts_validate.pipeline.metrics.correlation import correlation
from smts_validate.pipeline.metrics.cross_track import cross_track
from smts_validate.pipeline.metrics.iso18571 import iso18571
from smts_validate.pipeline.metrics.kge import kge
from smts_validate.pipeline.metrics.nrmse import nrmse
from smts_validate.pipeline.metrics.nse import nse
from smts_validate.pipeline.metrics.range_error import range_error
from smts_validate.pipeline.metrics.rmse import rmse
from smts_validate.pipeline.metrics.russell import russell
from smts_validate.pipeline.metrics.sprague_geers import sprague_geers
from smts_validate.pipeline.metrics.theil import theil

Floats = NDArray[np.float64]
ORACLES = Path(__file__).parent.parent / "oracles"


def pair(measured: Floats, simulated: Floats) -> Pair:
    return Pair(np.asarray(measured, float), np.asarray(simulated, float), 0.2, 2.8)


def walk(seed: int, size: int = 400) -> tuple[Floats, Floats]:
    """A rough signal and another that follows it badly."""
    generator = np.random.default_rng(seed)
    a = np.cumsum(generator.normal(size=size))
    return a, 1.1 * a + 0.2 * np.roll(a, 7) + generator.normal(size=size)


@pytest.mark.parametrize("case", json.loads((ORACLES / "published" / "sinusoids.json").read_text()))
def test_sinusoids_over_whole_periods_give_their_algebra(case: dict[str, float]) -> None:
    scale, shift = (
        float(x) for x in str(case["model"]).replace(" sin(t - ", " ").replace(" pi)", "").split()
    )
    t = np.linspace(0.0, 10.0 * np.pi, 20000, endpoint=False)
    both = pair(np.sin(t), scale * np.sin(t - shift * np.pi))
    found = {
        "SG_M": sprague_geers(both)["magnitude"],
        "SG_P": sprague_geers(both)["phase"],
        "SG_C": sprague_geers(both)["comprehensive"],
        "Russell_M": russell(both)["magnitude"],
        "Russell_P": russell(both)["phase"],
        "D_rms": nrmse(both)["by_rms"] / 100.0,
        "D_range": nrmse(both)["by_range"] / 100.0,
        "D_max": nrmse(both)["by_max"] / 100.0,
        "NSE": nse(both)["nse"],
        "TheilU1": theil(both)["u1"],
    }
    # The file's figures are algebra for continuous signals; arccos near 1 keeps seven digits of the phase.
    assert found == pytest.approx({key: case[key] for key in found}, abs=2e-7)


def test_a_model_a_fifth_too_large_has_a_magnitude_error_of_a_fifth_not_of_44_percent() -> None:
    t = np.linspace(0.0, 2.0 * np.pi, 1000, endpoint=False)
    assert sprague_geers(pair(np.sin(t), 1.2 * np.sin(t)))["magnitude"] == pytest.approx(0.2, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "scale", "arrival"),
    [
        ("mag+20", 1.2, 0.14),
        ("mag-20", 0.8, 0.14),
        ("late tau=0.24", 1.0, 0.24),
        ("early tau=0.04", 1.0, 0.04),
    ],
)
def test_geers_damped_sines_give_the_published_errors(name: str, scale: float, arrival: float) -> None:
    expected = json.loads((ORACLES / "published" / "damped_sine_sprague_geers.json").read_text())
    t = np.arange(0.0, 2.0 + 1e-9, 0.02)

    def wave(size: float, tau: float) -> Floats:
        return np.where(t < tau, 0.0, size * np.exp(-(t - tau)) * np.sin(2.0 * np.pi * (t - tau)))

    found = sprague_geers(pair(wave(1.0, 0.14), wave(scale, arrival)))
    values = [found["magnitude"], found["phase"], found["comprehensive"]]
    assert values == pytest.approx(expected["expected_M_P_C"][name], abs=1e-7)


@pytest.mark.parametrize("seed", range(5))
def test_nse_and_kge_agree_with_hydroeval(seed: int) -> None:
    measured, simulated = walk(seed)
    both = pair(measured, simulated)
    assert nse(both)["nse"] == pytest.approx(float(hydroeval.nse(simulated, measured)), rel=1e-12)
    total, r, alpha, beta = (float(v[0]) for v in hydroeval.kge(simulated, measured))
    assert kge(both)["kge"] == pytest.approx(total, rel=1e-10)
    assert kge(both)["alpha"] == pytest.approx(alpha, rel=1e-10)
    assert kge(both)["beta"] == pytest.approx(beta, rel=1e-10)
    assert correlation(both)["pearson"] == pytest.approx(r, rel=1e-10)


def test_iso_18571_example_has_the_rating_on_which_three_implementations_agree() -> None:
    signals = [
        np.loadtxt(ORACLES / "iso18571" / f"example_{name}.csv", delimiter=",")[:, 1]
        for name in ("reference", "comparison")
    ]
    found = iso18571(pair(*signals))
    expected = {
        "corridor": 0.6528907169,
        "phase": 0.9416666667,
        "magnitude": 0.9506540193,
        "slope": 0.9566865092,
        "r": 0.8309577258,
    }
    assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("seed", "size"), [(0, 100), (1, 333), (2, 500), (3, 601), (4, 812)])
def test_iso_18571_agrees_with_another_implementation_on_rough_signals(seed: int, size: int) -> None:
    measured, simulated = walk(seed, size)
    t = 1e-4 * np.arange(size)
    other = other_iso.ISO18571(np.column_stack((t, measured)), np.column_stack((t, simulated)))
    found = iso18571(pair(measured, simulated))
    assert found["corridor"] == pytest.approx(other.corridor_rating(12), abs=1e-9)
    assert found["phase"] == pytest.approx(other.phase_rating(12), abs=1e-9)
    assert found["magnitude"] == pytest.approx(other.magnitude_rating(12), abs=1e-9)
    assert found["slope"] == pytest.approx(other.slope_rating(12), abs=1e-9)


def test_iso_18571_annex_ratings_are_the_weighted_sum_that_we_form() -> None:
    with (ORACLES / "iso18571" / "annex_c_expected_ratings.csv").open() as file:
        cases = [{k: float(v) for k, v in row.items() if k != "case"} for row in csv.DictReader(file)]
    assert len(cases) == 42
    for case in cases:
        total = 0.4 * case["Z"] + 0.2 * (case["EP"] + case["EM"] + case["ES"])
        assert total == pytest.approx(case["R"], abs=2e-4)


def test_a_late_model_loses_phase_by_its_share_of_the_largest_shift() -> None:
    t = np.arange(500)
    pulse = np.exp(-(((t - 200) / 40.0) ** 2))
    late = np.exp(-(((t - 225) / 40.0) ** 2))
    assert iso18571(pair(pulse, late))["phase"] == pytest.approx((100 - 25) / 100)


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.key)
def test_a_perfect_model_reads_perfect_in_every_metric(metric: Metric) -> None:
    measured, _ = walk(7)
    for name, value in metric.compute(pair(measured, measured)).items():
        if name in ("alpha", "beta"):
            assert value == pytest.approx(1.0)
        elif not np.isnan(metric.perfect):
            assert value == pytest.approx(metric.perfect, abs=1e-7), name


@pytest.mark.parametrize("metric", METRICS, ids=lambda m: m.key)
def test_every_metric_names_its_source_and_gives_finite_numbers(metric: Metric) -> None:
    assert len(metric.title) > 3
    assert len(metric.source) > 3
    assert metric.unit in ("same", "%", "1")
    values = list(metric.compute(pair(*walk(3))).values())
    assert values
    assert np.isfinite(values).all()


@given(st.floats(0.1, 10.0), st.integers(0, 1000))
def test_scaling_both_signals_changes_no_relative_metric(scale: float, seed: int) -> None:
    measured, simulated = walk(seed, 120)
    before, after = (
        companions(pair(measured, simulated)),
        companions(pair(scale * measured, scale * simulated)),
    )
    for metric in METRICS:
        factor = scale if metric.unit == "same" else 1.0
        for name, value in before[metric.key].items():
            assert after[metric.key][name] == pytest.approx(factor * value, rel=1e-6, abs=1e-6)


@given(st.integers(0, 1000))
def test_mirroring_left_and_right_changes_no_metric_but_the_signed_means(seed: int) -> None:
    both = walk(seed, 120)
    before, after = companions(pair(*both)), companions(pair(-both[0], -both[1]))
    for metric in METRICS:
        for name, value in before[metric.key].items():
            sign = -1.0 if name in ("bias", "measured_mean", "simulated_mean") else 1.0
            assert after[metric.key][name] == pytest.approx(sign * value, rel=1e-9, abs=1e-9)


def test_signed_range_error_says_which_way_the_model_errs() -> None:
    t = np.linspace(0.0, 20.0 * np.pi, 5000)
    assert range_error(pair(np.sin(t), 0.9 * np.sin(t)))["range"] == pytest.approx(-10.0, abs=1e-3)
    assert range_error(pair(np.sin(t), 1.3 * np.sin(t)))["r95"] == pytest.approx(30.0, abs=1e-3)


def test_rmse_parts_follow_their_definitions() -> None:
    found = rmse(pair(np.zeros(4), np.array([1.0, -1.0, 3.0, 1.0])))
    assert found["rmse"] == pytest.approx(np.sqrt(3.0))
    assert found["bias"] == pytest.approx(1.0)
    assert found["max_abs"] == pytest.approx(3.0)


def test_cross_track_statistics_describe_each_signal_alone() -> None:
    found = cross_track(pair(np.array([1.0, -1.0, 1.0, -1.0]), np.full(4, 2.0)))
    assert found["measured_rms"] == pytest.approx(1.0)
    assert found["measured_sd"] == pytest.approx(np.sqrt(4.0 / 3.0))
    assert found["simulated_mean"] == pytest.approx(2.0)
    assert found["simulated_sd"] == pytest.approx(0.0)


def test_a_constant_signal_has_no_correlation_rather_than_a_wrong_one() -> None:
    found = companions(pair(np.zeros(50), np.linspace(0.0, 1.0, 50)))
    assert np.isnan(found["correlation"]["pearson"])
    assert np.isnan(found["nrmse"]["by_range"])
    assert np.isnan(found["iso18571"]["r"])


@pytest.mark.parametrize(
    ("measured", "simulated", "words"),
    [
        (np.zeros(3), np.zeros(4), "equally long"),
        (np.array([0.0, np.nan]), np.zeros(2), "finite"),
        (np.zeros(1), np.zeros(1), "two points"),
    ],
)
def test_a_pair_that_cannot_be_compared_is_refused(measured: Floats, simulated: Floats, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        pair(measured, simulated)


def test_the_compiled_warping_equals_its_uncompiled_self() -> None:
    a, b = walk(11, 60)
    steps, plain = np.zeros((60, 60), dtype=np.int8), np.zeros((60, 60), dtype=np.int8)
    assert warp_costs(a, b, 7, steps) == warp_costs.py_func(a, b, 7, plain)
    assert np.array_equal(steps, plain)
    path, other = np.zeros((120, 2), dtype=np.int64), np.zeros((120, 2), dtype=np.int64)
    assert trace_back(steps, path) == trace_back.py_func(steps, other)
    assert np.array_equal(path, other)


def test_warping_finds_the_cheapest_path_of_a_case_done_by_hand() -> None:
    # 0 1 2 against 0 0 2: the cheapest path is (0,0) (0,1) (1,1) (2,2) or (0,0) (1,1) (2,2), at a cost of 1.
    a, b = warped(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 2.0]), 2)
    assert float(np.sum((a - b) ** 2)) == 1.0
    assert (a[0], b[0], a[-1], b[-1]) == (0.0, 0.0, 2.0, 2.0)
