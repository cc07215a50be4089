"""The theoretical study: versions, indices, table, files, charts."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
from scipy.signal import welch
from smts_validate.model.machine import MachineError
from smts_validate.pipeline.study import PAPER, simulate_study, typical_run, write_study
from smts_validate.pipeline.study_charts import comparison_block, spectra_chart, trajectories_chart, yaw_chart
from smts_validate.pipeline.study_indices import INDICES, acceleration_spectrum, run_indices
from smts_validate.pipeline.study_linear import linear_map, steering_response
from smts_validate.pipeline.study_plan import (
    ASSUMPTIONS,
    VERSIONS,
    Soil,
    StudyError,
    StudyPlan,
    Version,
    assumed_machine,
    machine_of,
    read_version,
    soil_series,
)
from smts_validate.pipeline.study_run import find_version, make_study

SHORT = StudyPlan(seeds=4, length=60.0, run_in=10.0)


@pytest.fixture(scope="module")
def study():
    return simulate_study([VERSIONS["a"], VERSIONS["c"]], SHORT)


def test_indices_of_a_sine_are_its_amplitude_frequency_and_density():
    t = np.arange(0.0, 51.2, 0.02)
    y = 0.05 * np.sin(2 * np.pi * 0.5 * t)
    ay = 0.3 * np.sin(2 * np.pi * 2.5 * t)
    found = dict(
        zip(INDICES, run_indices(y, 2 * y, np.radians(y), np.radians(2 * y), ay, ay / 2, 0.02), strict=True)
    )
    assert found["max_deviation1"] == pytest.approx(0.05, rel=1e-3)
    assert found["range2"] == pytest.approx(0.2, rel=1e-3)
    assert found["r95_1"] == pytest.approx(2 * 0.05 * np.sin(np.pi / 2 * 0.95), rel=1e-2)
    assert found["rms1"] == pytest.approx(0.05 / np.sqrt(2), rel=1e-2)
    assert found["yaw_range2_deg"] == pytest.approx(0.2, rel=1e-3)
    assert found["peak_frequency1"] == pytest.approx(2.5, abs=0.1)
    assert found["peak1"] == pytest.approx(4 * found["peak2"], rel=1e-9)


@pytest.mark.parametrize("count", [2400, 255, 101])
def test_density_is_that_of_scipys_welch(count):
    noise = np.random.default_rng(2).standard_normal((2, count))
    found = acceleration_spectrum(noise, 0.02)
    frequency, density = welch(noise, 50.0, "hann", min(256, count), detrend="constant")
    assert found.frequency == pytest.approx(frequency)
    assert found.density == pytest.approx(density, rel=1e-9)


def test_density_integrates_to_the_variance():
    noise = np.random.default_rng(1).standard_normal((3, 60_000))
    found = acceleration_spectrum(noise, 0.02)
    total = np.trapezoid(found.density, found.frequency, axis=1)
    assert total == pytest.approx(np.ones(3), rel=0.03)


def test_every_assumed_number_has_a_source_or_is_called_an_assumption():
    for assumption in ASSUMPTIONS:
        assert any(word in assumption.source for word in ("assumption", "maker's data", "D497"))
        assert assumed_machine().parameter(assumption.name) == pytest.approx(assumption.value)


def test_versions_are_those_of_the_paper():
    values = {k: (v.speed, v.hitch_to_com, v.tyre_pressure_mpa) for k, v in VERSIONS.items()}
    assert values == {"a": (2.5, 2.0, 0.10), "b": (2.8, 3.0, 0.10), "c": (2.8, 3.0, 0.12)}
    machine = machine_of(VERSIONS["c"])
    assert machine.seeder.hitch_to_com == 3.0
    assert machine.tyre_pressure_mpa == 0.12


def test_soil_has_the_stated_sizes_and_each_row_depends_on_its_own_seed_alone():
    soil = Soil(level=2.0)
    many = soil_series(soil, 60, 100, 200.0)
    assert many.values[:, :, 1].std() == pytest.approx(2.0 * soil.force1, rel=0.05)
    assert many.values[:, :, 5].std() == pytest.approx(2.0 * soil.moment2, rel=0.05)
    assert not many.values[:, :, [0, 3]].any()
    assert np.array_equal(soil_series(soil, 3, 107, 200.0).values[0], many.values[7])


def test_run_of_the_median_range_is_the_typical_one():
    indices = np.zeros((5, len(INDICES)))
    indices[:, INDICES.index("range1")] = [0.3, 0.1, 0.5, 0.2, 0.4]
    assert typical_run(indices) == 0


def test_study_gives_the_same_runs_for_the_same_seed(study):
    again = simulate_study([VERSIONS["a"]], SHORT)
    assert np.array_equal(again.versions[0].indices, study.versions[0].indices)
    other = simulate_study([VERSIONS["a"]], dataclasses.replace(SHORT, seed=1))
    assert not np.array_equal(other.versions[0].indices, study.versions[0].indices)


def test_runs_are_straight_within_decimetres_hold_their_speed_and_cover_the_length(study):
    for item in study.versions:
        run = item.run
        assert run.x1[0] == 0.0
        assert run.x1[-1] == pytest.approx(SHORT.length, abs=0.5)
        assert run.v1.mean() == pytest.approx(item.version.speed, rel=0.01)
        assert 0.01 < np.ptp(run.y1) < 0.5
        assert item.step_error < 1e-4
        gap = np.hypot(run.x1 - run.x2, run.y1 - run.y2)
        length = item.machine.tractor.hitch + item.machine.seeder.hitch_to_com
        assert gap == pytest.approx(length, abs=0.05)


def test_table_sets_every_number_of_the_paper_beside_the_median_and_its_ratio(study):
    asked = [figure for figure in PAPER if figure.version in "ac"]
    assert len(study.table) == len(asked)
    row = next(r for r in study.table if (r.index, r.version) == ("range2", "c"))
    values = study.versions[1].index("range2")
    assert row.paper_low == row.paper_high == 0.08
    assert row.ours == pytest.approx(np.median(values))
    assert row.ratio == pytest.approx(np.median(values) / 0.08)
    assert row.ours_low <= row.ours <= row.ours_high


def test_files_hold_the_runs_indices_spectra_and_assumptions(study, tmp_path):
    written = write_study(tmp_path / "out", study)
    assert all(path.is_file() for path in written)
    run = pd.read_parquet(tmp_path / "out" / "c.parquet")
    assert np.allclose(run["y2"], study.versions[1].run.y2)
    assert len(pd.read_parquet(tmp_path / "out" / "indices.parquet")) == 8
    values = json.loads((tmp_path / "out" / "study.json").read_text())
    assert {a["name"] for a in values["assumptions"]} == {a.name for a in ASSUMPTIONS}
    assert len(values["table"]) == len(study.table)


def test_charts_show_the_papers_axes(study):
    labels = [
        chart.panels[0].y_label
        for chart in (trajectories_chart(study), yaw_chart(study), spectra_chart(study))
    ]
    assert labels == ["a: deviation, m", "a: yaw, deg", "a: S, (m/s²)²/Hz"]
    assert trajectories_chart(study).x_label == "distance, m"
    assert np.allclose(yaw_chart(study).panels[1].curves[0].y, np.degrees(study.versions[1].run.yaw1))
    assert spectra_chart(study).panels[0].curves[0].x.max() <= 10.0
    assert len(comparison_block(study).rows) == len(study.table)


def test_simulate_leaves_tables_and_figures(tmp_path):
    done = []
    output = make_study(tmp_path, ["b"], SHORT, done.append)
    assert done == ["version b: 4 soils"]
    names = {path.relative_to(tmp_path).as_posix() for path in output.files}
    assert {"b.parquet", "table.parquet", "linear.parquet", "figures/study-fig5-spectra.svg"} <= names
    assert all(path.stat().st_size > 0 for path in output.files)


def test_speed_above_the_critical_is_refused_before_any_run():
    unstable = Version("fast", 40.0, 1.5, 0.10)
    with pytest.raises(MachineError, match=r"speed is 40 m/s.*below the critical speed of"):
        simulate_study([unstable], SHORT)


def test_version_from_a_file_replaces_what_it_names(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text('hitch_to_com = 3.4\n[replaced]\n"seeder.mass" = 2500.0\n')
    version = find_version(str(path))
    assert (version.label, version.speed, version.hitch_to_com) == ("long", 2.8, 3.4)
    assert machine_of(version).seeder.mass == 2500.0


MANIFEST = """
[run]
variant = "mine"
[operating]
speed = 2.2
tyre_pressure_mpa = 0.11
[machine.tractor]
mass = 5200.0
driven = "rear"
[machine.seeder]
hitch_to_com = 2.7
com_to_axle = [0.1, 0.9]
track = [3.6, 3.6]
[machine.tyres.front]
cornering_stiffness = 5.5e4
"""


def test_version_from_a_manifest_is_its_machine(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text(MANIFEST)
    version = read_version(path)
    machine = machine_of(version)
    assert (version.label, version.speed, version.tyre_pressure_mpa) == ("mine", 2.2, 0.11)
    assert machine.tractor.mass == 5200.0
    assert machine.tractor.driven == "rear"
    assert machine.seeder.com_to_axle == (0.1, 0.9)
    assert machine.seeder.hitch_to_com == 2.7
    assert machine.tyres.front.cornering_stiffness == 5.5e4


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sped = 3.0", "sped: unknown key"),
        ("speed = -1.0", "speed is -1.0; it must be a finite number above 0"),
        ("speed = ", "not valid TOML"),
        ('speed = "fast"', "must be numbers"),
        ('[replaced]\n"seeder.mas" = 1.0', "did you mean `mass`"),
        ("[machine.tractor]\nmass = 5000.0", "this machine has none"),
    ],
)
def test_unusable_version_file_is_refused_in_one_line_that_names_file_and_key(tmp_path, text, message):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(StudyError, match=message) as caught:
        find_version(str(path))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: find_version("d"), "neither a, b, c nor a TOML file"),
        (lambda: StudyPlan(length=0.0), "length is 0.0"),
        (lambda: StudyPlan(seeds=1), "seeds is 1"),
        (lambda: Soil(correlation=0.0), "soil.correlation is 0.0"),
        (lambda: find_version("/nowhere/x.toml"), "cannot be read"),
    ],
)
def test_impossible_plans_are_refused(make, message):
    with pytest.raises(StudyError, match=message):
        make()


def test_linear_map_follows_speed_and_names_its_modes():
    found = linear_map(VERSIONS["b"], "speed", np.array([1.0, 2.8, 6.0]))
    assert len(found.modes) == 3
    assert (found.growth < 0.0).all()
    assert found.damping[2] > found.damping[0]  # relaxation swings die out over length, not time
    along_l5 = linear_map(VERSIONS["a"], "seeder.hitch_to_com", np.array([1.5, 2.0]))
    assert along_l5.critical_speed[0] < along_l5.critical_speed[1]


def test_steering_response_starts_from_the_steady_gain():
    found = steering_response(VERSIONS["b"])
    assert np.abs(found.gain[0, 0]) == pytest.approx(2.8 / 2.57, rel=0.15)  # kinematic
    assert np.abs(found.gain[-1, 0]) < 0.2 * np.abs(found.gain[0, 0])
