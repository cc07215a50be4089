"""What the paper's numbers cannot be at once: the arithmetic behind docs/paper.md."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy import stats
from smts_validate.pipeline.study import PAPER, simulate_study
from smts_validate.pipeline.study_claims import (
    EXACT,
    PRINTED,
    claim_values,
    free_energy_drift,
    headland_gap,
    peak_displacement,
    pressure_exponent_for,
    runs_to_tell,
    search_parameters,
    stiffness_frequencies,
    swing_acceleration,
)
from smts_validate.pipeline.study_plan import VERSIONS, StudyPlan, machine_of


def test_swing_at_a_frequency_has_the_acceleration_of_its_second_derivative():
    t = np.linspace(0.0, 1.0, 100_001)
    y = 0.06 * np.sin(2 * np.pi * 3.0 * t)
    acceleration = np.abs(np.gradient(np.gradient(y, t), t)[5:-5]).max()
    assert swing_acceleration(0.12, 3.0) == pytest.approx(acceleration / 9.80665, rel=1e-4)
    assert swing_acceleration(0.12, 3.0) > 2.0  # no tractor swings at 2 g


def test_displacement_behind_a_band_of_acceleration_is_its_double_integral():
    frequency = np.linspace(2.5, 4.0, 20_001)
    variance = np.trapezoid(0.045 / (2 * np.pi * frequency) ** 4, frequency)
    assert peak_displacement(0.045, 2.5, 4.0) == pytest.approx(np.sqrt(variance), rel=1e-6)
    assert peak_displacement(0.045, 2.5, 4.0) < 0.001  # under a millimetre, against a range of 0.12 m


@pytest.mark.slow
def test_runs_to_tell_two_versions_apart_give_the_promised_power():
    spread, generator = 0.2, np.random.default_rng(3)
    count = runs_to_tell(0.12, 0.11, spread)
    one = np.log(0.12) + spread * generator.standard_normal((4000, count))
    other = np.log(0.11) + spread * generator.standard_normal((4000, count))
    found = stats.ttest_ind(one, other, axis=1).pvalue < 0.05
    assert found.mean() == pytest.approx(0.8, abs=0.03)


def test_a_record_that_touches_its_line_cannot_deviate_further_than_its_range():
    by_name = {(f.index, f.version): f.middle for f in PAPER}
    assert (
        by_name["max_deviation1", "a"] > by_name["range1", "a"]
    )  # so the paper's record never touches the line
    generator = np.random.default_rng(1)
    for _ in range(100):
        record = np.cumsum(generator.standard_normal(200))
        record -= record[generator.integers(200)]  # touches 0
        assert np.abs(record).max() <= np.ptp(record)


def test_moving_the_peak_by_pressure_needs_an_exponent_beyond_any_tyre():
    exponent = pressure_exponent_for(5.0 / 3.1, 1.2)
    assert 1.2**exponent == pytest.approx((5.0 / 3.1) ** 2)
    assert exponent > 5.0


def test_natural_frequency_grows_no_faster_than_the_root_of_stiffness():
    frequencies = stiffness_frequencies(VERSIONS["c"], np.array([1.0, 4.0]))
    assert 1.3 < frequencies[1] / frequencies[0] < 2.05


def test_free_motion_keeps_its_energy_by_the_exact_equations_and_not_by_the_printed_ones():
    machine = machine_of(VERSIONS["a"])
    assert abs(free_energy_drift(machine, EXACT, 0.8)) < 1e-12
    assert abs(free_energy_drift(machine, PRINTED, 0.8)) > 0.05


def test_printed_equations_leave_the_track_in_a_headland_turn():
    assert 0.1 < headland_gap(VERSIONS["b"]) < 5.0


@pytest.mark.slow
def test_claims_and_a_small_search_are_plain_values():
    plan = StudyPlan(seeds=8, length=40.0, run_in=5.0)
    study = simulate_study(list(VERSIONS.values()), plan)
    search = search_parameters(count=6, rounds=1, soils=2)
    values = claim_values(study, search)
    assert json.loads(json.dumps(values))["search"]["candidates"] >= 6
    assert all(0.0 <= share <= 1.0 for share in search.met_share.values())
    assert len(search.best.met) == max(search.most_with.values())
    assert values["range as printed over exact"]["ratio"] == pytest.approx(1.0, abs=1e-3)
