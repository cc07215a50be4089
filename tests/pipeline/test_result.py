"""The results folder: what is in it, and that it is there whole or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import report_samples as samples
from smts_validate.pipeline import result as results
from smts_validate.pipeline.result import ResultError, read_result, write_result


def _nothing(folder: Path) -> None:
    """In place of the reports, which have tests of their own."""


def _write(out: Path, **options: object) -> Path:
    return write_result(out, samples.pass_result(**options), finish=_nothing)  # type: ignore[arg-type]


def test_trajectory_has_the_columns_of_the_format_page(tmp_path: Path) -> None:
    table = pq.read_table(_write(tmp_path / "out") / "trajectory.parquet")
    wanted = {"t", "row", "steer", "sd_steer"}
    wanted |= {f"{k}{b}" for k in ("x", "y", "yaw", "s", "n", "v", "yaw_rate") for b in "12"}
    wanted |= {f"sd_{k}{b}" for k in ("x", "y", "n", "yaw", "v") for b in "12"}
    assert wanted <= set(table.column_names)
    metadata = json.loads(table.schema.metadata[b"smts"])
    assert metadata["origin"] == {"lat": 50.0, "lon": 36.5, "alt": 120.0}
    assert metadata["lines"][0]["row"] == 0
    assert metadata["version"] == results.package_version()


def test_simulation_has_the_same_names_without_deviations_and_the_window(tmp_path: Path) -> None:
    out = _write(tmp_path / "out")
    trajectory = pq.read_table(out / "trajectory.parquet").column_names
    simulation = pq.read_table(out / "simulation.parquet").column_names
    assert set(simulation) == {name for name in trajectory if not name.startswith("sd_")} | {"window"}


def test_deviation_is_the_weave_of_the_closed_form_and_nan_outside_rows(tmp_path: Path) -> None:
    view = read_result(_write(tmp_path / "out"))
    inside = view.trajectory["row"] == 0
    s, n = view.trajectory["s1"], view.trajectory["n1"]
    expected = samples.AMPLITUDE * np.sin(2 * np.pi * s[inside] / samples.WAVELENGTH)
    np.testing.assert_allclose(n[inside], expected, atol=1e-9)
    assert np.isnan(s[~inside]).all()
    assert np.isnan(n[~inside]).all()
    assert (view.trajectory["row"][~inside] == -1).all()


def test_sd_of_the_deviation_is_the_covariance_turned_into_the_rows_frame(tmp_path: Path) -> None:
    view = read_result(_write(tmp_path / "out"))
    inside = view.trajectory["row"] == 0
    np.testing.assert_allclose(view.trajectory["sd_n1"][inside], 0.01, rtol=1e-9)
    np.testing.assert_allclose(view.trajectory["sd_s1"][inside], 0.02, rtol=1e-9)


def test_innovations_are_kept_for_the_report(tmp_path: Path) -> None:
    result = samples.pass_result()
    view = read_result(_write(tmp_path / "out"))
    for channel, columns in result.motion.innovations.items():
        stored = view.plots["innovations"][channel]
        np.testing.assert_array_equal(stored.x, columns["t"])
        np.testing.assert_array_equal(stored.y, columns["value"])
    assert "innovations refused" not in view.plots


def test_tractor_alone_has_no_column_of_body_two(tmp_path: Path) -> None:
    view = read_result(_write(tmp_path / "out", seeder=False))
    assert view.bodies == ("1",)
    assert not [name for name in view.trajectory if name.endswith("2")]
    assert not [name for name in view.simulation if name.endswith("2")]


def test_metrics_hold_no_nan_and_begin_as_the_format_page_says(tmp_path: Path) -> None:
    result = samples.pass_result()
    metrics = {**result.metrics, "rate": np.float64("nan"), "list": np.arange(2), "inf": float("inf")}
    text = results.dump_json(metrics)
    back = json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert back["rate"] is None
    assert back["inf"] is None
    assert back["list"] == [0, 1]
    assert list(back)[:4] == ["schema", "run", "verdict", "discrepancy"]


def test_same_result_gives_the_same_bytes(tmp_path: Path) -> None:
    first, second = _write(tmp_path / "a"), _write(tmp_path / "b")
    for path in sorted(first.iterdir()):
        assert path.read_bytes() == (second / path.name).read_bytes(), path.name


def test_failure_leaves_the_old_result_and_no_temporary_folder(tmp_path: Path) -> None:
    out = _write(tmp_path / "out")
    before = (out / "metrics.json").read_bytes()

    def broken(folder: Path) -> None:
        (folder / "metrics.json").write_text("half")
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        write_result(out, samples.pass_result(), finish=broken)
    assert (out / "metrics.json").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_result_replaces_an_older_one(tmp_path: Path) -> None:
    out = _write(tmp_path / "out", seeder=True)
    _write(tmp_path / "out", seeder=False)
    assert read_result(out).bodies == ("1",)
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_folder_with_other_files_is_refused_and_untouched(tmp_path: Path) -> None:
    (tmp_path / "thesis.docx").write_text("years of work")
    with pytest.raises(ResultError, match=r"thesis\.docx"):
        _write(tmp_path)
    assert (tmp_path / "thesis.docx").read_text() == "years of work"


def test_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    with pytest.raises(ResultError, match="not a folder"):
        _write(tmp_path / "out")


def test_folder_without_a_result_is_refused_by_name_of_the_missing_file(tmp_path: Path) -> None:
    with pytest.raises(ResultError, match=r"run\.toml"):
        read_result(tmp_path)


def test_damaged_table_is_refused_in_one_line(tmp_path: Path) -> None:
    out = _write(tmp_path / "out")
    (out / "trajectory.parquet").write_bytes(b"PAR1 not really")
    with pytest.raises(ResultError, match="run the pass again") as caught:
        read_result(out)
    assert "\n" not in str(caught.value)


def test_curves_come_back_as_they_were_stored(tmp_path: Path) -> None:
    from smts_validate.pipeline import result_tables
    from smts_validate.pipeline.report_view import PlotSeries

    x = np.linspace(0.0, 1.0, 5)
    plots = {
        "spectrum": {"one": PlotSeries(x, x**2, x, 2 * x), "two": PlotSeries(x[:3], x[:3])},
        "b": {"one": PlotSeries(x, -x)},
    }
    back = result_tables.plots_of_table(result_tables.plots_table(plots))
    assert {p: list(s) for p, s in back.items()} == {"spectrum": ["one", "two"], "b": ["one"]}
    np.testing.assert_array_equal(back["spectrum"]["one"].high, 2 * x)
    assert back["spectrum"]["two"].low is None
