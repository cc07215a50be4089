"""Forecasts of planned campaigns: chances against the rules, precision against least squares, the whole."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2
from smts_validate.model.machine import Machine
from smts_validate.pipeline import planning, planning_chances
from smts_validate.pipeline.adequacy import Rules
from smts_validate.pipeline.bounds import RESPONSES, PassStatistics, ResponseStatistics
from smts_validate.pipeline.compare import compare
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.grid import slices
from smts_validate.pipeline.planning_pilots import PARAMETERS, changes, fly, information, known_parameters
from smts_validate.pipeline.planning_report import plan_to_folder
from smts_validate.pipeline.replay_settings import ReplaySettings
from smts_validate.pipeline.source import machine_of
from smts_validate.pipeline.twin import make_pass, write_raw
from smts_validate.pipeline.twin_campaign import campaign_from
from smts_validate.pipeline.twin_machine import MACHINE
from smts_validate.pipeline.twin_plan import preset
from smts_validate.pipeline.twin_tables import PlanError
from smts_validate.sensors.ingest import read_pass

RULES = Rules()
CELLS = (("field1", "east"), ("field1", "west"))
MACHINE_NOW = Machine.from_mapping(MACHINE, 0.12)


def _pilot(reading: float, scatter: float = 0.0, measuring: float = 0.01) -> PassStatistics:
    """A pilot whose responses swing 12 cm (3°) and read `reading` of that, times e^scatter."""
    responses = {}
    for name in RESPONSES:
        r95 = 0.12 if name.startswith("deviation") else math.radians(3.0)
        responses[name] = ResponseStatistics(
            mse=(reading * r95 * math.exp(scatter)) ** 2,
            null_mse=r95**2,
            r95=r95,
            u2=(measuring * r95) ** 2,
            u2_range=(measuring * r95) ** 2,
            u2_absolute=(measuring * r95) ** 2,
            u2_input=(measuring * r95) ** 2,
            n_eff=60.0,
            n_eff_range=60.0,
        )
    return PassStatistics("p", "field1", "east", 1, "b", responses, 1.0, True, True)


PILOTS = [_pilot(0.03, s) for s in (-0.2, -0.1, -0.05, 0.05, 0.1, 0.2)]


def test_a_right_model_is_found_adequate_and_a_wrong_one_not_given_repeats_enough() -> None:
    found = planning_chances.chances(PILOTS, CELLS, (8,), RULES, 1, ratios=(0.0, 2.0), simulated=50)
    assert (found[0].adequate, found[1].not_adequate) == (1.0, 1.0)


def test_a_model_over_the_threshold_is_hardly_ever_found_adequate() -> None:
    found = planning_chances.chances(PILOTS, CELLS, (2, 3, 5), RULES, 2, ratios=(1.5,), simulated=200)
    assert all(point.adequate < 0.05 for point in found)


def test_chances_of_a_point_add_up_and_name_what_stands_in_the_way() -> None:
    (point,) = planning_chances.chances(PILOTS, CELLS, (1,), RULES, 3, ratios=(0.0,), simulated=30)
    assert point.adequate + point.not_adequate + point.inconclusive == pytest.approx(1.0)
    assert point.inconclusive == 1.0  # two passes are under the least number
    assert point.doubts["few-passes"] == 1.0


def test_scattering_pilots_need_more_repeats_than_calm_ones() -> None:
    wild = [_pilot(0.06, s) for s in (-0.9, -0.5, -0.2, 0.2, 0.5, 0.9)]
    calm = [_pilot(0.06, s) for s in (-0.09, -0.05, -0.02, 0.02, 0.05, 0.09)]
    few = [planning_chances.chances(p, CELLS, (2,), RULES, 4, (0.0,), 100)[0] for p in (wild, calm)]
    assert few[0].adequate < few[1].adequate


def test_a_simulated_campaign_has_the_planned_cells_and_the_asked_discrepancy() -> None:
    rng = np.random.default_rng(5)
    drawn = [planning_chances.campaign(PILOTS, CELLS, 3, 0.15, rng) for _ in range(400)]
    assert {(p.field, p.direction, p.repeat) for p in drawn[0]} == {(*c, n) for c in CELLS for n in (1, 2, 3)}
    logs = np.array([0.5 * math.log(p.responses["yaw1"].mse) for passes in drawn for p in passes])
    expected = 0.5 * math.log((0.03**2 + 0.15**2) * math.radians(3.0) ** 2)
    assert logs.mean() == pytest.approx(expected, abs=0.02)
    pilots = np.array([-0.2, -0.1, -0.05, 0.05, 0.1, 0.2])
    assert logs.std() == pytest.approx(pilots.std(ddof=1), rel=0.05)


def test_precision_is_that_of_least_squares_and_falls_with_the_root_of_the_repeats() -> None:
    rng = np.random.default_rng(6)
    names = ("tyres.front.cornering_stiffness", "tyres.rear.cornering_stiffness", "seeder.hitch_to_com")
    slopes = rng.standard_normal((400, 3)) @ np.array([[1.0, 0.8, 0.0], [0.0, 0.5, 0.1], [0.0, 0.0, 2.0]])
    noise, cells, planned = 0.3, 2, 3
    per_pass = slopes.T @ slopes / noise**2
    found = planning.precisions(per_pass, names, MACHINE_NOW, cells, (1, planned, 12), planned)
    stacked = np.vstack([slopes] * (cells * planned))
    estimates = [
        np.linalg.lstsq(stacked, noise * rng.standard_normal(stacked.shape[0]), rcond=None)[0]
        for _ in range(600)
    ]
    spread = 100.0 * np.std(estimates, axis=0)
    assert [p.sd_percent[planned] for p in found] == pytest.approx(list(spread), rel=0.1)
    for p in found:
        single, many = p.sd_percent[1], p.sd_percent[12]
        assert single is not None
        assert many is not None
        assert single / many == pytest.approx(math.sqrt(12.0))
        assert p.alone_percent is not None
        assert p.alone_percent <= p.sd_percent[planned] * (1.0 + 1e-9)
    assert np.corrcoef(np.array(estimates).T)[0, 1] == pytest.approx(found[0].correlation, abs=0.08)


def test_the_steerings_scale_is_paid_for_in_full_however_many_the_repeats() -> None:
    rng = np.random.default_rng(7)
    names = ("tyres.front.cornering_stiffness", "seeder.hitch_to_com")
    slopes = rng.standard_normal((300, 2)) @ np.array([[1.0, 0.4], [0.0, 1.5]])
    noise, cells, planned, change = 0.3, 2, 4, rng.standard_normal(300)  # change: of the residual, by 1 sd
    found = planning.precisions(
        slopes.T @ slopes / noise**2, names, MACHINE_NOW, cells, (planned, 10_000), planned,
        slopes.T @ change / noise**2,
    )  # fmt: skip
    passes = cells * planned
    stacked, estimates = np.vstack([slopes] * passes), []
    for _ in range(600):
        errors = noise * rng.standard_normal(300 * passes) + np.tile(change, passes) * rng.standard_normal()
        estimates.append(np.linalg.lstsq(stacked, errors, rcond=None)[0])
    assert [p.sd_percent[planned] for p in found] == pytest.approx(
        list(100.0 * np.std(estimates, axis=0)), rel=0.1
    )
    floor = 100.0 * np.abs(np.linalg.lstsq(slopes, change, rcond=None)[0])
    assert [p.sd_percent[10_000] for p in found] == pytest.approx(list(floor), rel=0.02)


def test_a_parameter_without_information_and_two_that_cannot_be_told_apart_are_not_identifiable() -> None:
    names = ("tyres.front.cornering_stiffness", "tyres.rear.cornering_stiffness", "seeder.yaw_inertia")
    one = np.array([[100.0, 100.0, 0.0], [100.0, 100.0, 0.0], [0.0, 0.0, 0.0]])
    found = planning.precisions(one, names, MACHINE_NOW, 2, (3,), 3)
    assert not any(p.identifiable for p in found)
    assert [p.sd_percent[3] for p in found] == [None, None, None]
    assert found[2].alone_percent is None


def test_parameters_that_a_machine_lacks_are_left_out() -> None:
    alone = Machine.from_mapping(
        {**MACHINE, "seeder": None, "tyres": {**MACHINE["tyres"], "seeder": None}}, 0.12
    )
    wanted = ("tractor.yaw_inertia", "seeder.yaw_inertia", "tyres.seeder.cornering_stiffness")
    assert known_parameters(alone, wanted) == ("tractor.yaw_inertia",)
    assert known_parameters(MACHINE_NOW, wanted) == wanted


def test_readings_part_what_a_right_model_reads_into_its_causes() -> None:
    for reading in planning.readings([_pilot(0.05), _pilot(0.05)]):
        assert reading.total == pytest.approx(5.0)
        assert reading.measuring == reading.inputs == pytest.approx(1.0)
        assert reading.soil == pytest.approx(math.sqrt(23.0))


@pytest.mark.parametrize(("measuring", "says"), [(0.01, "are good enough"), (0.12, "are not good enough")])
def test_advice_says_whether_the_sensors_are_good_enough(measuring: float, says: str) -> None:
    pilots = [_pilot(0.12, s, measuring) for s in (-0.1, 0.0, 0.1)]
    chance = planning_chances.chances(pilots, CELLS, (8,), RULES, 1, (0.0,), 40)
    clear = [replace(c, inconclusive=0.0, adequate=1.0) for c in chance]
    words = planning.advice(pilots, planning.readings(pilots), clear, 8, RULES)
    assert says in words[-1]


def test_what_the_soil_does_is_not_blamed_on_the_sensors_and_is_told_in_words() -> None:
    """Alignments beyond their prior come of rough ground too."""
    pilots = [replace(_pilot(0.03, s), windows_within=0.5) for s in (-0.1, 0.0, 0.1)]
    chance = planning_chances.chances(pilots, CELLS, (8,), RULES, 1, (0.0,), 40)
    assert chance[0].doubts["alignment"] == chance[0].inconclusive == 1.0
    *_, blocked, sensors = planning.advice(pilots, planning.readings(pilots), chance, 8, RULES)
    assert "a rough soil" in blocked
    assert "are good enough" in sensors


def test_pilots_whose_fusion_fails_are_named_as_such() -> None:
    pilots = [_pilot(0.03), _pilot(0.03), _pilot(1.5)]
    chance = planning_chances.chances(pilots, CELLS, (3,), RULES, 1, (0.0,), 20)
    words = " ".join(planning.advice(pilots, planning.readings(pilots), chance, 3, RULES))
    assert "in 1 of 3 pilots" in words
    assert "not good enough" in words


def test_a_plan_without_repeats_or_pilots_is_refused() -> None:
    for wrong in ({"repeats": (0,)}, {"pilots": 1}):
        with pytest.raises(PlanError, match="1 or more"):
            planning.forecast(campaign_from({}), **wrong)  # type: ignore[arg-type]


@pytest.mark.slow
def test_a_forecast_is_made_from_a_plan_and_written_as_table_and_figure(tmp_path: Path) -> None:
    (tmp_path / "plan.toml").write_text(
        'seed = 3\nrepeats = 2\ndirections = ["east", "west"]\n[base.path]\nduration = 45.0\n'
    )
    document = plan_to_folder(tmp_path / "plan.toml", tmp_path / "out", repeats=(2, 5), pilots=2, workers=0)
    assert json.loads((tmp_path / "out/plan.json").read_text())["repeats"] == 2
    page = (tmp_path / "out/report.html").read_text()
    assert "Chance of each verdict" in page
    assert "Uncertainty of each parameter" in page
    assert "cornering_stiffness (front)" in page
    assert (tmp_path / "out/report.pdf").read_bytes().startswith(b"%PDF")
    (variant,) = document["variants"]
    assert {c["repeats"] for c in variant["chances"]} == {2, 5}
    assert variant["pilots"] == 2


@pytest.mark.slow
def test_a_plan_without_a_row_to_compare_says_so() -> None:
    short = campaign_from({"base": {"path": {"duration": 12.0}}})
    with pytest.raises(PlanError, match="fewer than two pilots"):
        planning.forecast(short, pilots=2, workers=0)


@pytest.mark.slow
def test_information_grows_with_excitation() -> None:
    calm = preset("benign")
    woven = replace(calm, driver=replace(calm.driver, weave_deg=0.7, weave_period=4.0))
    names = ("tyres.front.cornering_stiffness", "seeder.hitch_to_com")
    settings = ReplaySettings(horizons=(25.0,), draws=50)
    found = [fly(plan, 4, names, settings) for plan in (calm, woven)]
    assert found[0] is not None
    assert found[1] is not None
    less, more = (np.diag(pilot.information) for pilot in found if pilot is not None)
    assert (more > 1.5 * less).all()


def _estimate(seed: int, folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Relative changes of all parameters by one step of least squares on a pass, and their stated sd."""
    write_raw(make_pass(preset("benign"), seed), folder / "raw")
    log = read_pass(folder / "raw")
    settings = ReplaySettings(horizons=(25.0,), draws=20)
    comparison = compare(fuse(log), machine_of(log), log.manifest, settings)
    assert comparison.statistics is not None
    slope, total = np.zeros(len(PARAMETERS)), np.zeros((len(PARAMETERS), len(PARAMETERS)))
    for row in comparison.rows:
        total += information(row, comparison.statistics, PARAMETERS)
        moved = [changes(row, name) for name in PARAMETERS]
        for i, fit in enumerate(row.fits):
            columns = np.column_stack([m[i] for m in moved])
            for name, place in slices(fit.parts):
                response = comparison.statistics.responses[name]
                weight = response.n_eff / (row.valid[name].sum() * response.mse)
                valid = fit.valid[place]
                slope += weight * columns[place][valid].T @ fit.bounded[place][valid]
    return -np.linalg.solve(total, slope), np.sqrt(np.diag(np.linalg.inv(total)))


@pytest.mark.full
def test_parameters_estimated_from_twins_scatter_as_the_forecast_says(tmp_path: Path) -> None:
    found = [_estimate(200 + k, tmp_path / str(k)) for k in range(24)]
    pulls = np.array([estimate / sd for estimate, sd in found])
    low, high = (math.sqrt(chi2.ppf(p, 23) / 23) for p in (0.0005, 0.9995))
    assert (pulls.std(axis=0, ddof=1) < high).all()  # never more scatter than forecast
    assert low < np.median(pulls.std(axis=0, ddof=1)) < high
    assert np.abs(pulls.mean(axis=0)).max() < 3.5 / math.sqrt(24)
