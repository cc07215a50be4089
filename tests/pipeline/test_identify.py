"""Identification against simulated truth: what is recovered, what is held and named, what stays inadequate."""

from __future__ import annotations

import datetime as dt
import json
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from scipy.stats import binom, chi2
from smts_validate.model.machine import Machine
from smts_validate.pipeline.adequacy import Rules
from smts_validate.pipeline.compare import compare
from smts_validate.pipeline.console import identified
from smts_validate.pipeline.fusion.motion import Motion
from smts_validate.pipeline.identify import (
    SETTINGS,
    Identification,
    Recording,
    document_of,
    identify,
    verdict_of,
)
from smts_validate.pipeline.identify_fit import Fit, collinear, fit, lost, scores_scatter, worst
from smts_validate.pipeline.identify_parameter import IdentifyError, Parameter, parameter_of
from smts_validate.pipeline.identify_problem import (
    Layout,
    jacobian_of,
    residual_of,
    stretch_of,
    values_at,
    weights_by_response,
)
from smts_validate.pipeline.identify_profile import profile
from smts_validate.pipeline.identify_report import brief, number, write_report
from smts_validate.pipeline.identify_wishes import Wish
from smts_validate.pipeline.result import dump_json
from synthetic_motion import Errors, Field, alone, machine_of, manifest_of, motion_of, truth_of

FRONT = "tyres.front.cornering_stiffness"
SEEDER = "tyres.seeder.cornering_stiffness"
REFERENCE = "tyres.front.reference_pressure_mpa"  # acts only through the stiffness
SCHEMA = json.loads((Path(__file__).parents[2] / "docs" / "identify.schema.json").read_text("utf-8"))
SPEED = 2.8
CELLS = (("east", 0.02), ("west", math.pi + 0.02))
STATED = manifest_of()
TRUE = machine_of(STATED)
STEADY = replace(Errors(), steer=math.radians(0.03), steer_zero=math.radians(0.05), steer_scale=0.001)


@cache
def moved(seed: int, heading: float, truth: Machine = TRUE, errors: Errors = STEADY) -> Motion:
    """A smoothed motion of a pass with a machine, 130 m."""
    return motion_of(truth_of(truth, Field(heading=heading), SPEED, seed), truth, errors, 500 + seed)


def campaign(
    wrong: Machine, truth: Machine = TRUE, errors: Errors = STEADY, first: int = 0
) -> list[Recording]:
    """Two passes each way of the `truth`, with manifests that state the machine `wrong`."""
    found = []
    for k in range(4):
        direction, heading = CELLS[k % 2]
        manifest = manifest_of(id=f"pass-{k}", direction=direction, repeat=1 + k // 2)
        if truth.seeder is None:
            manifest = alone(manifest)
        found.append(Recording(manifest, moved(first + k, heading, truth, errors), wrong))
    return found


def fitted(recordings: Sequence[Recording], *names: str, seed: int = 1) -> Fit:
    stretches = [
        stretch_of(r.run, r.machine, row)
        for r in recordings
        for row in compare(r.motion, r.machine, r.manifest, SETTINGS).rows
    ]
    return fit(stretches, [parameter_of(n, [r.machine for r in recordings], None, None) for n in names], seed)


def holds(ends: tuple[float | None, float | None], truth: float) -> bool:
    """Whether an interval, open at an end that a bound cut off, holds the truth."""
    low, high = ends
    return (low is None or low < truth) and (high is None or truth < high)


@cache
def recovered() -> Identification:
    """A campaign whose manifests state a front stiffness 40 % too high and a parameter that says the same."""
    wrong = TRUE.replace_parameters({FRONT: 1.4 * TRUE.parameter(FRONT)})
    return identify(campaign(wrong), {FRONT: Wish(), REFERENCE: Wish()})


@pytest.mark.slow
def test_a_stiffness_40_percent_off_is_recovered_within_its_interval_which_is_narrower_than_the_error() -> (
    None
):
    (found,) = document_of(recovered())["parameters"]
    truth = TRUE.parameter(FRONT)
    for low, high in (found["interval"], found["profile_interval"]):
        assert low < truth < high < found["stated"]
    assert found["standard_error"] > found["standard_error_uncorrected"]


@pytest.mark.slow
def test_of_a_collinear_pair_one_is_held_and_the_other_named() -> None:
    (held,) = recovered().fit.held
    assert {held.name, held.partner} == {FRONT, REFERENCE}
    assert held.partner in held.reason


@pytest.mark.slow
def test_held_out_passes_are_judged_with_parameters_they_had_no_part_in() -> None:
    found = recovered()
    assert [set(f.runs) for f in found.folds] == [{"pass-0", "pass-2"}, {"pass-1", "pass-3"}]
    for fold in found.folds:
        assert fold.fit is not None
        assert not {s.run for s in fold.fit.stretches} & set(fold.runs)
        for run in fold.runs:
            used = found.held_out[run].rows[0].context.machine
            assert {p.name: used.parameter(p.name) for p in fold.fit.parameters} == fold.fit.values
    document = document_of(found)
    assert [stage for stage, v in document["stages"].items() if v["decides"]] == ["held_out"]
    assert document["verdict"] == document["stages"]["held_out"]["verdict"]


@pytest.mark.slow
def test_the_document_is_json_and_its_text_names_what_was_found_held_and_judged() -> None:
    document = json.loads(dump_json({**document_of(recovered()), "out": "identified"}))
    text = identified(document)
    for word in (FRONT, REFERENCE, "before", "after", "held out", document["verdict"]["value"]):
        assert word in text
    assert np.array(document["correlation"]["matrix"]) == pytest.approx(np.eye(1))


@pytest.mark.slow
def test_identify_json_satisfies_its_schema_and_puts_the_held_out_verdict_first() -> None:
    document = json.loads(dump_json(document_of(recovered())))
    jsonschema.validate(document, SCHEMA)
    assert list(document)[:2] == ["schema", "verdict"]
    assert [f["standard_errors"].keys() == f["estimates"].keys() for f in document["folds"]] == [True, True]


@pytest.mark.slow
def test_the_report_shows_the_estimates_what_was_held_and_all_three_stages(tmp_path: Path) -> None:
    document = json.loads(dump_json(document_of(recovered())))
    page = write_report(document, tmp_path, dt.date(2025, 5, 14)).read_text(encoding="utf-8")
    (found,), (held,) = document["parameters"], document["held"]
    for word in (
        number(found["estimate"]),
        brief(held["name"]),
        held["reason"],
        "before: as stated",
        "held out",
    ):
        assert word in page
    assert (tmp_path / "report.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.slow
def test_a_tractor_alone_is_identified_too() -> None:
    truth = machine_of(alone(STATED))
    wrong = truth.replace_parameters({FRONT: 1.4 * truth.parameter(FRONT)})
    found = fitted(campaign(wrong, truth), FRONT)
    assert found.layout.names == ("deviation1", "yaw1")
    assert holds(found.interval(0), truth.parameter(FRONT))


def test_without_a_steering_series_the_seeder_is_identified_behind_the_measured_tractor_and_nothing_else() -> (
    None
):
    length = "seeder.hitch_to_com"
    wrong = TRUE.replace_parameters({length: 4.0})
    recordings = [replace(r, motion=replace(r.motion, steer_input=None)) for r in campaign(wrong)]
    found = fitted(recordings, length)
    assert found.layout.names == ("deviation2", "yaw2")
    assert abs(found.values[length] - TRUE.parameter(length)) < 0.1
    with pytest.raises(IdentifyError, match="does not act on the motion compared"):
        fitted(recordings, FRONT)


@pytest.mark.slow
def test_a_missing_relaxation_length_is_not_hidden_by_fitting_stiffnesses() -> None:
    missing = {f"tyres.{axle}.relaxation_length": 4.0 for axle in ("front", "rear", "seeder")}
    recordings = campaign(TRUE, TRUE.replace_parameters(missing))
    found = identify(recordings, {FRONT: Wish(), SEEDER: Wish()}, kind="direction")
    rules = Rules(threshold_percent=10.0)
    verdict = verdict_of(found, found.held_out, rules)
    assert verdict.passes == 4
    assert verdict.value == document_of(found, rules)["verdict"]["value"] == "not adequate"
    # It is not for want of fitting: both were free in every fold.
    assert [set(fold.fit.values) for fold in found.folds if fold.fit is not None] == [{FRONT, SEEDER}] * 2


def test_the_jacobian_is_that_of_the_residuals_over_a_step_ten_times_as_long() -> None:
    (one, *_) = campaign(TRUE)
    (row,) = compare(one.motion, one.machine, one.manifest, SETTINGS).rows
    stretches = [stretch_of(one.run, one.machine, row)]
    free = [parameter_of(n, [TRUE], None, None) for n in (FRONT, "seeder.hitch_to_com")]
    slopes = jacobian_of(stretches, free, np.zeros(2))
    for i in range(2):
        side = np.zeros(2)
        side[i] = 0.1
        change = residual_of(stretches, values_at(free, side)) - residual_of(
            stretches, values_at(free, -side)
        )
        assert np.linalg.norm(change / 0.2 - slopes[:, i]) < 0.05 * np.linalg.norm(slopes[:, i])


def test_weights_count_each_response_by_its_independent_samples() -> None:
    rng = np.random.default_rng(3)
    white, slow = rng.standard_normal(4000), np.repeat(rng.standard_normal(100), 40) * 0.01
    layout = Layout(
        ("deviation1", "yaw1"),
        np.ones(8000, dtype=bool),
        np.repeat([0, 1], 4000),
        np.zeros(8000, dtype=np.int64),
        np.zeros(8000, dtype=np.int64),
    )
    residual = np.concatenate((white, slow))
    weighted = weights_by_response(residual, layout) * residual**2
    assert weighted[:4000].sum() == pytest.approx(4000.0, rel=0.1)
    # A step of 40 samples has the triangle's autocorrelation: Σρ² = 1 + 2·Σ(1 − k/40)² ≈ 26.7.
    assert weighted[4000:].sum() == pytest.approx(4000.0 / 26.7, rel=0.25)


def test_standard_errors_from_windows_scores_match_the_scatter_of_estimates_under_autocorrelation() -> None:
    rng = np.random.default_rng(4)
    windows, size = 60, 50
    layout = Layout(
        ("deviation1",),
        np.ones(windows * size, dtype=bool),
        np.zeros(windows * size, dtype=np.int64),
        np.repeat(np.arange(windows), size),
        np.zeros(windows * size, dtype=np.int64),
    )
    slopes = np.repeat(rng.standard_normal(windows), size)[:, None] + 0.3
    bread = 1.0 / float(slopes[:, 0] @ slopes[:, 0])
    estimates, stated = [], []
    for _ in range(300):
        noise = np.repeat(rng.standard_normal(windows), size) + 0.2 * rng.standard_normal(windows * size)
        z = bread * float(slopes[:, 0] @ noise)
        estimates.append(z)
        stated.append(bread**2 * float(scores_scatter(slopes, noise - z * slopes[:, 0], layout)[0, 0]))
    assert math.sqrt(np.mean(stated)) == pytest.approx(float(np.std(estimates)), rel=0.12)


def _plain(*names: str) -> list[Parameter]:
    return [Parameter(name, 1.0, 1.0, 0.1, 10.0, None) for name in names]


def test_a_prior_makes_a_collinear_pair_identifiable_and_three_that_sum_up_are_found() -> None:
    pair = np.array([[400.0, 400.0], [400.0, 400.0]])
    found = collinear(pair, np.zeros((2, 2)), _plain("a", "b"))
    assert found is not None
    assert {found.name, found.partner} == {"a", "b"}
    assert worst(pair, np.diag([0.0, 1e4]), _plain("a", "b")) is None
    rng = np.random.default_rng(5)
    slopes = rng.standard_normal((500, 3))
    slopes[:, 2] = slopes[:, 0] + slopes[:, 1] + 0.02 * rng.standard_normal(500)
    three = worst(slopes.T @ slopes, np.zeros((3, 3)), _plain("a", "b", "c"))
    assert three is not None


def test_what_autocorrelation_leaves_unsure_is_held_too() -> None:
    """The weights alone say 70 %: with the scatter of the windows it is 140 %, and nothing is known of it."""
    one = fitted(campaign(TRUE)[:2], FRONT)
    assert lost(one) is None
    two = replace(one, parameters=(*one.parameters, *_plain("b")), covariance=np.diag([0.01, 1.96]))
    found = lost(two)
    assert found is not None
    assert (found.name, found.partner) == ("b", FRONT)
    assert "140 %" in found.reason


def test_what_does_not_act_is_named_so() -> None:
    found = worst(np.diag([400.0, 0.01]), np.zeros((2, 2)), _plain("a", "b"))
    assert found is not None
    assert (found.name, found.partner) == ("b", "")
    assert "hardly acts" in found.reason


def test_parameters_that_cannot_be_freed_are_refused_with_the_way_out() -> None:
    other = TRUE.replace_parameters({FRONT: 7e4})
    with pytest.raises(IdentifyError, match="one version at a time"):
        parameter_of(FRONT, [TRUE, other], None, None)
    with pytest.raises(IdentifyError, match="did you mean `cornering_stiffness`"):
        parameter_of("tyres.front.cornering_stifness", [TRUE], None, None)
    with pytest.raises(IdentifyError, match=r"relaxation_length=LOW:HIGH"):
        parameter_of("tyres.front.relaxation_length", [TRUE], None, None)
    with pytest.raises(IdentifyError, match="numeric"):
        parameter_of("tractor.driven", [TRUE], None, None)
    with pytest.raises(IdentifyError, match="not below"):
        parameter_of(FRONT, [TRUE], (2.0, 1.0), None)


def test_passes_of_the_same_name_and_an_empty_list_are_refused() -> None:
    one = campaign(TRUE)[0]
    with pytest.raises(IdentifyError, match="pass-0: two passes"):
        identify([one, one], {FRONT: Wish()})
    with pytest.raises(IdentifyError, match="names no parameter"):
        identify([one], {})


def test_a_manifests_uncertainty_is_the_prior() -> None:
    base = campaign(TRUE)[0]
    manifest = base.manifest.model_copy(update={"uncertainty": {FRONT: 6.0}})  # 0.01 %: it cannot move
    wrong = TRUE.replace_parameters({FRONT: 1.4 * TRUE.parameter(FRONT)})
    found = identify([Recording(manifest, base.motion, wrong)], {FRONT: Wish()})
    assert found.fit.values[FRONT] == pytest.approx(wrong.parameter(FRONT), rel=1e-3)
    document = json.loads(dump_json(document_of(found)))
    jsonschema.validate(document, SCHEMA)
    assert document["parameters"][0]["prior_sd"] == 6.0
    assert document["folds"] == []
    assert document["verdict"]["value"] == "inconclusive"
    assert "no pass is left" in document["verdict"]["reasons"][0]


@pytest.mark.slow
def test_a_prior_of_the_asker_goes_before_the_manifests_and_pulls_to_its_own_mean() -> None:
    base = campaign(TRUE)[0]
    manifest = base.manifest.model_copy(update={"uncertainty": {FRONT: 6.0}})
    recording = Recording(manifest, base.motion, TRUE)
    sharp = identify([recording], {FRONT: Wish(mean=7e4, sd=1.0)}).fit
    assert sharp.values[FRONT] == pytest.approx(7e4, rel=1e-3)
    assert sharp.spreads[FRONT] == pytest.approx(1.0, rel=0.05)
    # Of a prior as sharp as the passes themselves the estimate lies between both, and its error is smaller.
    free = fitted([recording], FRONT)
    own = free.spreads[FRONT]
    some = identify([recording], {FRONT: Wish(mean=free.values[FRONT] + 3.0 * own, sd=own)})
    assert free.values[FRONT] + own < some.fit.values[FRONT] < free.values[FRONT] + 2.5 * own
    assert some.fit.spreads[FRONT] < own
    low, high = some.profiles[FRONT]
    assert low is not None
    assert high is not None
    assert high - low < 2.0 * free.quantile * own


@pytest.mark.full
@pytest.mark.timeout(5400)
def test_intervals_of_two_free_parameters_hold_the_truth_as_often_as_they_say_in_64_campaigns() -> None:
    stated = {FRONT: 1.4, SEEDER: 0.7}
    wrong = TRUE.replace_parameters({name: f * TRUE.parameter(name) for name, f in stated.items()})
    count = 64
    covered: Counter[tuple[str, str]] = Counter()
    pulls: dict[str, list[float]] = {name: [] for name in stated}
    for k in range(count):
        found = fitted(campaign(wrong, errors=Errors(), first=1000 + 4 * k), *stated, seed=k)
        moved.cache_clear()
        for i, p in enumerate(found.parameters):
            truth = TRUE.parameter(p.name)
            covered[p.name, "standard error"] += holds(found.interval(i), truth)
            covered[p.name, "profile"] += holds(profile(found, i), truth)
            pulls[p.name].append(float((found.z[i] - p.change(truth)) / found.sd[i]))
    low, high = (float(binom.ppf(p, count, 0.95)) for p in (0.0005, 0.9995))
    assert len(covered) == 4
    for which, held in covered.items():
        assert low <= held <= high, which
    # The region's upper end is all of them, so that it cannot tell an interval that is too wide: this can.
    narrow, wide = (math.sqrt(chi2.ppf(p, count) / count) for p in (0.0005, 0.9995))
    for name, found_pulls in pulls.items():
        assert narrow < math.sqrt(np.mean(np.square(found_pulls))) < wide, name
