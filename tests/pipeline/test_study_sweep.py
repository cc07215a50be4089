"""Sweeps: designs, equality with single runs, response surface, sensitivities, best design."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from smts_validate.pipeline.study import study_version
from smts_validate.pipeline.study_indices import INDICES
from smts_validate.pipeline.study_plan import VERSIONS, StudyError, StudyPlan
from smts_validate.pipeline.study_response import (
    base_values,
    best_design,
    fit_surface,
    paired_effects,
    sensitivities,
    single_effects,
    surface_sensitivities,
)
from smts_validate.pipeline.study_run import make_sweep
from smts_validate.pipeline.study_sweep import (
    PAPER_QUESTION,
    SWEEP_SETTINGS,
    Parameter,
    SweepPlan,
    make_design,
    parameter,
    run_sweep,
    sample_designs,
    simulate_designs,
)

SHORT = StudyPlan(length=60.0, run_in=10.0, settings=SWEEP_SETTINGS)
PLAN = SweepPlan(count=32, seeds=4, study=SHORT)


@pytest.fixture(scope="module")
def sweep():
    return run_sweep(PLAN)


@pytest.mark.parametrize("sampler", ["grid", "latin", "sobol"])
def test_designs_fill_the_bounds_and_repeat_with_their_seed(sampler):
    plan = dataclasses.replace(PLAN, sampler=sampler, count=64)
    designs = sample_designs(plan)
    assert designs.shape == (64, 3)
    assert (designs >= plan.bounds[:, 0]).all()
    assert (designs <= plan.bounds[:, 1]).all()
    assert np.array_equal(designs, sample_designs(plan))
    spread = (designs.max(axis=0) - designs.min(axis=0)) / (plan.bounds[:, 1] - plan.bounds[:, 0])
    assert (spread > 0.9).all()


def test_design_of_a_version_gives_the_versions_own_indices():
    study = dataclasses.replace(SHORT, seeds=4)
    plan = dataclasses.replace(PLAN, study=study, base=VERSIONS["a"])
    version = VERSIONS["c"]
    design = np.array([[version.speed, version.hitch_to_com, version.tyre_pressure_mpa]])
    swept = simulate_designs(plan, np.repeat(design, 3, axis=0))
    single = study_version(version, study).indices
    for row in swept:
        assert row == pytest.approx(single, rel=1e-6)


def test_number_of_threads_does_not_change_the_result(sweep):
    alone = simulate_designs(dataclasses.replace(PLAN, workers=1), sweep.designs[:5])
    assert np.array_equal(alone, sweep.indices[:5])


def test_soil_level_and_driver_are_parameters_too():
    plan = dataclasses.replace(
        PLAN, parameters=(Parameter("soil.level", 0.5, 2.4), Parameter("driver.delay", 0.2, 0.9))
    )
    calm, rough, late = simulate_designs(plan, np.array([[0.6, 0.5], [1.2, 0.5], [1.2, 0.9]]))
    column = INDICES.index("range1")
    assert rough[:, column] == pytest.approx(2.0 * calm[:, column], rel=0.05)  # nearly linear
    assert late[:, column].mean() > rough[:, column].mean()


def test_progress_counts_up_to_all_runs():
    seen = []
    plan = dataclasses.replace(PLAN, count=12)
    simulate_designs(plan, sample_designs(plan), lambda done, total: seen.append((done, total)))
    assert seen[-1] == (48, 48)
    assert [d for d, _ in seen] == sorted(d for d, _ in seen)


def test_response_surface_reproduces_designs_it_was_not_fitted_to(sweep):
    surface = fit_surface(sweep, "r95_1")
    fresh = sample_designs(dataclasses.replace(PLAN, sampler="latin", count=8))
    indices = simulate_designs(PLAN, fresh)
    truth = np.exp(np.log(indices[:, :, INDICES.index("r95_1")]).mean(axis=1))
    assert surface(fresh) == pytest.approx(truth, rel=0.05)
    assert surface.r2 > 0.9


def test_surface_through_a_known_quadratic_is_exact(sweep):
    unit = 2.0 * (sweep.designs - PLAN.bounds[:, 0]) / (PLAN.bounds[:, 1] - PLAN.bounds[:, 0]) - 1.0
    known = np.exp(0.3 - 0.2 * unit[:, 0] + 0.1 * unit[:, 1] * unit[:, 2] + 0.05 * unit[:, 1] ** 2)
    indices = sweep.indices.copy()
    indices[:, :, INDICES.index("rms1")] = known[:, None]
    surface = fit_surface(dataclasses.replace(sweep, indices=indices), "rms1")
    assert surface(sweep.designs) == pytest.approx(known, rel=1e-9)
    assert surface.r2 == pytest.approx(1.0)


def test_best_design_lies_within_bounds_and_beats_the_base_on_fresh_soils(sweep):
    best = best_design(sweep, "r95_1", soils=16)
    for item in PLAN.parameters:
        assert item.low <= best.values[item.name] <= item.high
    effect = next(e for e in best.effects if e.index == "r95_1")
    assert effect.low < effect.ratio < effect.high < 1.0


def test_effect_of_a_design_against_itself_is_one():
    base = base_values(PLAN)
    assert base == pytest.approx([2.8, 3.0, 0.10])
    for effect in paired_effects(PLAN, base, base, 4):
        assert effect.ratio == effect.low == effect.high == 1.0


def test_stiffer_tyres_by_pressure_run_straighter():
    effects = single_effects(PLAN, soils=8)
    assert set(effects) == set(PLAN.names)
    assert effects["tyre_pressure_mpa"].high < 1.0


@pytest.mark.slow
def test_sensitivities_find_the_parameter_that_matters_and_the_one_that_does_not():
    plan = dataclasses.replace(
        PLAN,
        seeds=2,
        parameters=(Parameter("soil.level", 0.6, 2.4), Parameter("seeder.draft", 7000.0, 7400.0)),
    )
    found = sensitivities(plan, "range1", samples=32)
    assert found.first[0] == pytest.approx(1.0, abs=0.3)
    assert abs(found.total[1]) < 0.05
    assert (found.total_interval[:, 0] <= found.total).all()


def test_sensitivities_of_a_known_surface_are_the_shares_of_its_variance(sweep):
    """ln y = u1 + 2·u2 over −1..1: variances 1/3 and 4/3, no interaction."""
    surface = dataclasses.replace(fit_surface(sweep), coefficients=np.array([0.0, 1.0, 2.0] + [0.0] * 7))
    found = surface_sensitivities(PLAN, surface)
    assert found.first == pytest.approx([0.2, 0.8, 0.0], abs=0.02)
    assert found.total == pytest.approx([0.2, 0.8, 0.0], abs=0.02)
    assert (found.first_interval[:2, 0] < [0.2, 0.8]).all()
    assert (found.first_interval[:2, 1] > [0.2, 0.8]).all()


def test_sweep_leaves_a_table_an_answer_and_figures(tmp_path):
    ranges = ["seeder.hitch_to_com=2:3", "tyre_pressure_mpa=0.09:0.13"]
    output = make_sweep(tmp_path, ranges, count=16, soils=2, plan=SHORT)
    table = pd.read_parquet(tmp_path / "sweep.parquet")
    assert len(table) == 16
    assert {"seeder.hitch_to_com", "r95_1", "damping", "critical_speed"} <= set(table.columns)
    answer = json.loads((tmp_path / "sweep.json").read_text())["answer"]
    assert set(answer["best"]["values"]) == {"seeder.hitch_to_com", "tyre_pressure_mpa"}
    assert (tmp_path / "figures" / "study-surface-r95-1.svg").is_file()
    assert output.sweep.step_error < 1e-3


def test_too_few_designs_for_a_surface_are_refused(sweep):
    few = dataclasses.replace(sweep, designs=sweep.designs[:5], indices=sweep.indices[:5])
    with pytest.raises(StudyError, match=r"5 designs are too few .*use a count of 20 or more"):
        fit_surface(few)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: parameter("speed=3:2"), "range 3 to 2 is empty"),
        (lambda: parameter("speed"), "is written name=low:high"),
        (lambda: SweepPlan(parameters=()), "one parameter or more"),
        (lambda: SweepPlan(parameters=PAPER_QUESTION[:1] * 2), "given twice"),
        (lambda: SweepPlan(count=0), "count is 0"),
        (lambda: SweepPlan(sampler="random"), "must be grid, latin or sobol"),
        (lambda: make_design(PLAN, {"seeder.hitch_to_con": 2.0}), "did you mean `hitch_to_com`"),
        (lambda: sensitivities(PLAN, samples=12), "samples is 12; .* power of 2"),
        (
            lambda: sensitivities(dataclasses.replace(PLAN, parameters=PAPER_QUESTION[:1])),
            "two parameters or more",
        ),
        (lambda: make_design(PLAN, {"driver.mood": 2.0}), r"driver\.mood: unknown parameter"),
        (lambda: make_design(PLAN, {"tractor.mass": np.float64(-1.0)}), r"tractor\.mass is -1\.0;"),
        (
            lambda: run_sweep(
                dataclasses.replace(PLAN, base=VERSIONS["a"], parameters=(Parameter("speed", 2.0, 50.0),))
            ),
            r"speed is [34]\d\.\d+ m/s in one of the designs; there the critical speed is 24\.",
        ),
    ],
)
def test_impossible_sweeps_are_refused_in_one_line(make, message):
    with pytest.raises(StudyError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
