"""Traditional tests, analysis of variance, random fields and aliasing against published numbers and
statsmodels."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula.api as smf
from numpy.typing import NDArray
from smts_validate.pipeline.effects import (
    EffectsError,
    aliases,
    block_columns,
    effects_of,
    least_squares,
    nested_f,
    random_intercept,
)
from smts_validate.pipeline.traditional import (
    Track,
    cochran,
    cochran_critical,
    correlation_length,
    fisher_adequacy,
    of_cell,
)
from statsmodels.stats.anova import anova_lm

Floats = NDArray[np.float64]
ORACLES = Path(__file__).parent.parent / "oracles"
STEPS = {"speed": 0.3, "hitch_to_com": 1.0, "tyre_pressure_mpa": 0.02}


def nist(name: str) -> tuple[Floats, NDArray[np.int64], float]:
    """Responses, treatments and the certified F of a NIST StRD analysis of variance."""
    lines = (ORACLES / "nist_strd" / f"{name}.dat").read_text().splitlines()
    certified = next(float(line.split()[-1]) for line in lines if line.startswith("Between"))
    first, last = (int(n) for n in re.findall(r"lines (\d+) to (\d+)", "\n".join(lines[:10]))[1])
    rows = [line.split() for line in lines[first - 1 : last]]
    return np.array([float(r[1]) for r in rows]), np.array([int(float(r[0])) for r in rows]), certified


@pytest.mark.parametrize(
    ("name", "tolerance"),
    # SmLs07 has 13 constant leading digits: the data themselves hold four of the effect's.
    [("SiRstv", 1e-9), ("AtmWtAg", 1e-7), ("SmLs01", 1e-10), ("SmLs04", 1e-7), ("SmLs07", 2e-4)],
)
def test_analysis_of_variance_meets_nist_s_certified_f(name: str, tolerance: float) -> None:
    y, groups, certified = nist(name)
    constant = np.ones((y.size, 1))
    full = block_columns([[str(g) for g in groups]])
    found = nested_f(constant, full, y)
    assert found.f == pytest.approx(certified, rel=tolerance)
    assert (found.dof_between, found.dof_within) == (len(set(groups)) - 1, y.size - len(set(groups)))


def table(seed: int, fields: int = 2) -> pd.DataFrame:
    """Passes of a made-up campaign: speed and pressure vary freely, fields and directions are blocks."""
    generator = np.random.default_rng(seed)
    rows = [
        (f"f{f}", d, v, p, 0.3 * v + 2.0 * p + 0.2 * f + generator.normal(0.0, 0.1))
        for f in range(fields)
        for d in ("east", "west")
        for v in (2.5, 2.8)
        for p in (0.10, 0.12)
    ]
    return pd.DataFrame(rows, columns=["field", "direction", "speed", "tyre_pressure_mpa", "log"])


@pytest.mark.parametrize("seed", range(3))
def test_fixed_blocks_agree_with_statsmodels(seed: int) -> None:
    data = table(seed)
    other = smf.ols("log ~ C(field) + C(direction) + speed + tyre_pressure_mpa", data).fit()
    found = effects_of(
        "index",
        np.exp(data["log"].to_numpy()),
        {n: data[n].to_numpy() for n in ("speed", "tyre_pressure_mpa")},
        data["field"].tolist(),
        data["direction"].tolist(),
        STEPS,
    )
    for effect in found.effects:
        assert np.log(effect.ratio) / effect.step == pytest.approx(other.params[effect.factor], rel=1e-9)
        assert effect.p == pytest.approx(other.pvalues[effect.factor], rel=1e-7)
        low, high = other.conf_int().loc[effect.factor] * effect.step
        assert (np.log(effect.low), np.log(effect.high)) == pytest.approx((low, high), rel=1e-7)
    reduced = smf.ols("log ~ C(field) + C(direction)", data).fit()
    joint = anova_lm(reduced, other)
    assert found.joint is not None
    assert found.joint.f == pytest.approx(joint["F"][1], rel=1e-7)
    assert found.joint.p == pytest.approx(joint["Pr(>F)"][1], rel=1e-7)


def test_the_random_intercept_meets_lmer_on_the_dietox_pigs() -> None:
    data = pd.read_csv(ORACLES / "published" / "dietox.csv").dropna(subset=["Weight", "Time", "Pig"])
    design = np.column_stack((np.ones(len(data)), data["Time"].to_numpy(float)))
    found = random_intercept(design, data["Weight"].to_numpy(float), [str(p) for p in data["Pig"]])
    # R lmer, REML, as printed in statsmodels' own test.
    assert found.beta == pytest.approx([15.723523, 6.942505], rel=1e-6)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx([0.78805374, 0.03338727], rel=1e-6)
    assert found.variance == pytest.approx(11.36692, rel=1e-5)
    assert found.group_variance == pytest.approx(40.39395, rel=1e-5)


def test_the_random_intercept_agrees_with_statsmodels_on_the_pastes() -> None:
    data = pd.read_csv(ORACLES / "published" / "pastes.csv")
    other = smf.mixedlm("strength ~ 1", data, groups=data["batch"]).fit(reml=True)
    found = random_intercept(
        np.ones((len(data), 1)), data["strength"].to_numpy(float), data["batch"].astype(str).tolist()
    )
    assert found.beta[0] == pytest.approx(other.params["Intercept"], rel=1e-6)
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(other.bse["Intercept"], rel=1e-3)
    assert found.variance == pytest.approx(other.scale, rel=1e-3)


def test_five_fields_make_the_field_a_random_effect_and_four_do_not() -> None:
    for fields, model in ((4, "blocks"), (5, "random field")):
        data = table(1, fields)
        found = effects_of(
            "index",
            np.exp(data["log"].to_numpy()),
            {"speed": data["speed"].to_numpy()},
            data["field"].tolist(),
            data["direction"].tolist(),
            STEPS,
        )
        assert found.model == model
        assert np.log(found.effects[0].ratio) / 0.3 == pytest.approx(0.3, abs=0.15)


def test_in_the_paper_s_three_versions_speed_and_drawbar_cannot_be_told_apart() -> None:
    versions = [(2.5, 2.0, 0.10), (2.8, 3.0, 0.10), (2.8, 3.0, 0.12)] * 4
    speed, drawbar, pressure = np.array(versions).T
    factors = {"speed": speed, "hitch_to_com": drawbar, "tyre_pressure_mpa": pressure}
    directions = ["east"] * 6 + ["west"] * 6
    found = effects_of("index", 1.0 + 0.1 * np.arange(12.0), factors, ["field1"] * 12, directions, STEPS)
    assert found.aliased == (("speed", "hitch_to_com"),)
    assert [e.factor for e in found.effects] == ["speed", "tyre_pressure_mpa"]


def test_a_factor_that_changes_with_the_field_is_aliased_with_the_blocks() -> None:
    speed = np.array([2.5, 2.5, 2.8, 2.8])
    blocks = block_columns([["a", "a", "b", "b"], ["e", "w", "e", "w"]])
    assert aliases({"speed": speed}, blocks) == (("blocks", "speed"),)


def test_a_factor_that_never_changes_has_no_effect_to_estimate() -> None:
    found = effects_of(
        "index", np.array([1.0, 2.0, 3.0]), {"speed": np.full(3, 2.8)}, ["a"] * 3, ["e"] * 3, STEPS
    )
    assert found.constant == ("speed",)
    assert found.effects == ()
    assert found.note


def test_too_few_passes_give_a_note_and_no_effect() -> None:
    found = effects_of(
        "index", np.array([1.0, 2.0]), {"speed": np.array([2.5, 2.8])}, ["a"] * 2, ["e"] * 2, STEPS
    )
    assert found.effects == ()
    assert "2 passes" in found.note


def test_dependent_columns_are_refused_by_least_squares() -> None:
    with pytest.raises(EffectsError, match="depend"):
        least_squares(np.ones((5, 2)), np.arange(5.0))


def test_a_known_effect_is_covered_by_its_interval_at_the_stated_rate() -> None:
    covered = []
    for seed in range(200):
        data = table(seed)
        found = effects_of(
            "index",
            np.exp(data["log"].to_numpy()),
            {"speed": data["speed"].to_numpy(), "tyre_pressure_mpa": data["tyre_pressure_mpa"].to_numpy()},
            data["field"].tolist(),
            data["direction"].tolist(),
            STEPS,
        )
        covered.append(found.effects[0].low < np.exp(0.3 * 0.3) < found.effects[0].high)
    assert np.mean(covered) == pytest.approx(0.95, abs=0.04)


def test_cochran_s_critical_values_are_those_of_the_published_table() -> None:
    with (ORACLES / "published" / "cochran_critical_95.csv").open() as file:
        rows = list(csv.DictReader(file))
    checked = 0
    for row in rows:
        groups = int(row["n_datasets_l"])
        for repeats in range(2, 6):
            assert cochran_critical(groups, repeats) == pytest.approx(float(row[f"n={repeats}"]), abs=6e-4)
            checked += 1
    assert checked >= 40


def test_the_manual_s_worked_cochran_example_comes_out() -> None:
    case = json.loads((ORACLES / "published" / "tsatu_cochran_example.json").read_text())
    found = cochran(case["row_variances"], case["m_repeats"])
    assert found.statistic == pytest.approx(case["G_obs"], abs=0.005)
    assert found.critical == pytest.approx(case["G_crit_0_05"], abs=0.005)
    assert found.holds


def test_cochran_rejects_equal_spread_at_its_level() -> None:
    generator = np.random.default_rng(0)
    values = generator.standard_normal((4000, 6, 4)).var(axis=2, ddof=1)
    rejected = np.mean([not cochran(v, 4).holds for v in values])
    assert rejected == pytest.approx(0.05, abs=0.012)


def test_fisher_rejects_a_true_model_at_its_level() -> None:
    generator = np.random.default_rng(1)
    zero = np.zeros((8, 4))
    rejected = np.mean(
        [not fisher_adequacy(generator.standard_normal((8, 4)), zero).holds for _ in range(4000)]
    )
    assert rejected == pytest.approx(0.05, abs=0.012)


def test_fisher_rewards_sloppy_repeats() -> None:
    generator = np.random.default_rng(2)
    noise, wrong = generator.standard_normal((10, 3)), np.full((10, 3), 1.0)
    assert not fisher_adequacy(0.1 * noise, wrong).holds
    assert fisher_adequacy(10.0 * noise, wrong).holds


def test_fisher_follows_its_formula() -> None:
    measured = np.array([[1.0, 3.0], [5.0, 5.0], [2.0, 4.0]])
    simulated = np.array([[1.0, 1.0], [5.0, 7.0], [3.0, 3.0]])
    found = fisher_adequacy(measured, simulated, fitted=1)
    # Means 2, 5, 3 against 1, 6, 3: misfit 2; s²_ad = 2·2/(3 − 1) = 2; s²_y = (2 + 0 + 2)/3.
    assert found.statistic == pytest.approx(2.0 / (4.0 / 3.0))


def test_tests_without_repeats_are_refused() -> None:
    with pytest.raises(ValueError, match="two or more"):
        cochran_critical(3, 1)
    with pytest.raises(ValueError, match="two or more"):
        fisher_adequacy(np.zeros((5, 1)), np.zeros((5, 1)))


def test_stations_lie_a_correlation_length_apart() -> None:
    s = 0.2 * np.arange(500)
    wave = np.sin(2.0 * np.pi * s / 20.0)
    # cos(2π·d/20) = 1/e at d = 20·acos(1/e)/2π.
    length = correlation_length(wave, 0.2)
    assert length == pytest.approx(20.0 * np.arccos(1.0 / np.e) / (2.0 * np.pi), abs=0.4)
    tracks = [Track(s, wave + 0.01 * i, wave) for i in range(3)]
    found = of_cell(tracks)
    assert found is not None
    assert found["fisher"].groups == int(s[-1] / length) + 1
    assert of_cell(tracks[:1]) is None
