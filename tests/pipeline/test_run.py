"""The chain on the sample pass, whose truth is known: from raw files to a results folder."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from smts_validate.pipeline.batch_campaign import stored_row
from smts_validate.pipeline.campaign import read_record
from smts_validate.pipeline.result import read_result
from smts_validate.pipeline.run import compute, run_to_folder
from smts_validate.pipeline.source import SourceError, ingest_pass, read_source
from smts_validate.sensors.geodesy import to_enu

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "data_samples" / "field1"
TRUTH = ROOT / "data_samples" / "truth" / "field1"
SHARED = ROOT.parent / "shared" / "examples" / "visible"

BODY = ("x", "y", "yaw", "s", "n", "v", "yaw_rate")
WITH_SD = ("x", "y", "n", "yaw", "v")

pytestmark = pytest.mark.slow


class Place:
    """A geodetic origin."""

    def __init__(self, values: dict[str, float]) -> None:
        self.lat, self.lon, self.alt = values["lat"], values["lon"], values["alt"]


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("run") / "field1"
    compute(SAMPLE, folder)
    return folder


def metrics_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "metrics.json").read_text(encoding="utf-8")))


def errors(folder: Path, truth: Path, trim: float = 2.0) -> dict[str, float]:
    """RMSE of lateral position and yaw of both bodies against the truth, with nothing fitted."""
    table = pq.read_table(folder / "trajectory.parquet")
    got = table.to_pandas()
    origin = Place(json.loads(table.schema.metadata[b"smts"])["origin"])
    true_origin = Place(json.loads((truth / "truth_origin.json").read_text(encoding="utf-8")))
    east, north, _ = to_enu(
        np.array([origin.lat]), np.array([origin.lon]), np.array([origin.alt]), true_origin
    )
    true = pd.read_csv(truth / "truth.csv")
    t, tt = got["t"].to_numpy(), true["t"].to_numpy()
    use = (t >= tt[0] + trim) & (t <= tt[-1] - trim)
    found = {}
    for b in "12":
        yaw = np.interp(t, tt, np.unwrap(true[f"yaw{b}"]))
        dx = got[f"x{b}"] + east[0] - np.interp(t, tt, true[f"x{b}"])
        dy = got[f"y{b}"] + north[0] - np.interp(t, tt, true[f"y{b}"])
        lateral = dy * np.cos(yaw) - dx * np.sin(yaw)
        turned = np.angle(np.exp(1j * (got[f"yaw{b}"] - yaw)))
        found[f"lateral{b}"] = float(np.sqrt(np.mean(np.square(lateral[use]))))
        found[f"yaw{b}"] = math.degrees(float(np.sqrt(np.mean(np.square(turned[use])))))
    return found


def test_the_results_folder_holds_what_the_format_page_promises(out: Path) -> None:
    promised = {"trajectory.parquet", "simulation.parquet", "metrics.json", "result.mcap", "report.html"}
    assert promised | {"report.pdf"} <= {path.name for path in out.iterdir()}
    trajectory = pd.read_parquet(out / "trajectory.parquet")
    simulation = pd.read_parquet(out / "simulation.parquet")
    for b in "12":
        assert {f"{name}{b}" for name in BODY} <= set(trajectory) & set(simulation)
        assert {f"sd_{name}{b}" for name in WITH_SD} <= set(trajectory)
    assert {"t", "row", "steer", "sd_steer"} <= set(trajectory)
    assert {"t", "window"} <= set(simulation)
    assert np.array_equal(trajectory["t"], simulation["t"])
    assert np.allclose(np.diff(trajectory["t"]), 0.02, atol=1e-6)


def test_path_coordinates_exist_in_rows_and_nowhere_else(out: Path) -> None:
    trajectory = pd.read_parquet(out / "trajectory.parquet")
    outside = trajectory["row"] == -1
    assert outside.any()
    assert not outside.all()
    for name in ("s1", "n1", "s2", "n2"):
        assert trajectory.loc[outside, name].isna().all()
        assert trajectory.loc[~outside, name].notna().all()


def test_metrics_begin_as_the_format_page_says(out: Path) -> None:
    metrics = metrics_of(out)
    assert list(metrics)[:4] == ["schema", "run", "verdict", "discrepancy"]
    assert metrics["schema"] == 1
    assert metrics["run"] == "field1"
    assert metrics["verdict"]["value"] in {"adequate", "not adequate", "inconclusive"}
    assert metrics["verdict"]["scope"] == "pass"
    for kind in ("trajectory", "yaw"):
        assert {"body1", "body2", "combined", "interval"} <= set(metrics["discrepancy"][kind])
    assert all({"sensor", "file", "row", "what", "effect"} <= set(w) for w in metrics["warnings"])


def test_the_fused_motion_is_near_the_truth(out: Path) -> None:
    """The issue's bounds for a benign RTK pass: 1.6 cm, 0.08° and 0.12°."""
    found = errors(out, TRUTH)
    assert found["lateral1"] < 0.016
    assert found["yaw1"] < 0.08
    assert found["yaw2"] < 0.12


def test_a_model_with_the_true_parameters_is_not_condemned(out: Path) -> None:
    """The twin's machine and the manifest's are the same."""
    metrics = metrics_of(out)
    assert metrics["verdict"]["value"] in {"adequate", "inconclusive"}
    assert 0.0 < metrics["discrepancy"]["trajectory"]["combined"] < 15.0


def test_the_same_pass_gives_the_same_bytes(out: Path, tmp_path: Path) -> None:
    again = tmp_path / "field1"
    compute(SAMPLE, again)
    names = {path.name for path in out.iterdir()}
    assert {path.name for path in again.iterdir()} == names
    for name in names:
        assert (again / name).read_bytes() == (out / name).read_bytes(), name


def test_a_log_gives_the_same_motion_as_the_raw_pass_it_was_made_from(out: Path, tmp_path: Path) -> None:
    made = ingest_pass(SAMPLE, tmp_path / "logs")
    run_to_folder(Path(made["log"]), tmp_path / "out", None)
    raw = pd.read_parquet(out / "trajectory.parquet")
    logged = pd.read_parquet(tmp_path / "out" / "trajectory.parquet")
    for name in ("x1", "y1", "yaw1", "x2", "y2", "yaw2"):
        assert np.abs(raw[name] - logged[name]).max() < 1e-4, name  # a log's stamps are whole nanoseconds
    verdicts = [metrics_of(folder)["verdict"]["value"] for folder in (out, tmp_path / "out")]
    assert verdicts[0] == verdicts[1]


def test_provenance_names_inputs_versions_and_options_and_nothing_that_changes(out: Path) -> None:
    provenance = metrics_of(out)["provenance"]
    assert len(provenance["source_sha256"]) == len(provenance["manifest_sha256"]) == 64
    assert {"python", "numpy", "smts-validate"} <= set(provenance["versions"])
    assert str(Path.home()) not in json.dumps(provenance)
    assert "field1" in provenance["source"]


def test_a_result_keeps_the_day_that_its_run_toml_does_not_tell(out: Path, tmp_path: Path) -> None:
    told = read_result(out).manifest.run.date
    folder = shutil.copytree(out, tmp_path / "undated")
    lines = (folder / "run.toml").read_text(encoding="utf-8").splitlines(keepends=True)
    kept = [line for line in lines if not line.startswith("date")]
    assert len(kept) == len(lines) - 1
    (folder / "run.toml").write_text("".join(kept), encoding="utf-8")
    assert read_result(folder).manifest.run.date == told
    assert read_record(folder).manifest.run.date == told
    assert stored_row(folder)["date"] == told.isoformat()


def test_a_path_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="absent: there is no such file"):
        read_source(tmp_path / "absent")


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared is not beside this checkout")
def test_the_shared_example_is_within_the_issues_bounds(tmp_path: Path) -> None:
    (raw,) = (SHARED / "raw").iterdir()
    compute(raw, tmp_path / "out")
    found = errors(tmp_path / "out", SHARED)
    assert found["lateral1"] < 0.016
    assert found["yaw1"] < 0.08
    assert found["yaw2"] < 0.12
