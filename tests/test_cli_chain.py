"""The commands on real files, as a person types them: ingest, inspect, run, report, batch, synth."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import duckdb
import pandas as pd
import pytest

COMMAND = [sys.executable, "-m", "smts_validate.pipeline.cli"]
SAMPLE = Path(__file__).parents[1] / "data_samples" / "field1"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

pytestmark = pytest.mark.slow

Ran = subprocess.CompletedProcess[str]


def smts(*words: object, folder: Path | None = None, **variables: str) -> Ran:
    return subprocess.run(
        [*COMMAND, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=300,
        cwd=folder,
        env={**os.environ, **ONE_THREAD, **variables},
        check=False,
    )


def document(ran: Ran) -> Any:
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


def events(ran: Ran) -> list[dict[str, Any]]:
    return [json.loads(line) for line in ran.stdout.splitlines()]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the two commands of the README have run."""
    folder = tmp_path_factory.mktemp("work")
    assert smts("ingest", SAMPLE, "-o", "logs", folder=folder).returncode == 0
    ran = smts("run", "logs/field1.mcap", folder=folder)
    assert ran.returncode == 0, ran.stderr
    (folder / "run.txt").write_text(ran.stdout, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def passes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two short synthetic passes and one that cannot be read."""
    folder = tmp_path_factory.mktemp("passes")
    plan = folder / "plan.toml"
    plan.write_text(
        'seed = 3\ndirections = ["east", "west"]\n[base.path]\nduration = 40.0\nrow_length = 80.0\n',
        encoding="utf-8",
    )
    made = document(smts("synth", folder / "raw", "--campaign", plan, "--json"))
    assert len(made["passes"]) == 2
    broken = folder / "raw" / "broken"
    shutil.copytree(made["passes"][0], broken)
    text = (broken / "run.toml").read_text(encoding="utf-8")
    (broken / "run.toml").write_text(text.replace("field1-b-east-1", "broken"), encoding="utf-8")
    (broken / "gps.nmea").unlink()
    return folder / "raw"


def test_run_prints_verdict_discrepancies_and_the_report_to_open(work: Path) -> None:
    text = (work / "run.txt").read_text(encoding="utf-8")
    assert "verdict (pass field1): " in text
    assert "discrepancy of trajectory: " in text
    assert "discrepancy of yaw: " in text
    assert text.splitlines()[-1] == "report: results/field1/report.html"
    assert (work / "results" / "field1" / "report.html").is_file()


def test_a_terminal_is_told_what_goes_on_and_a_pipe_is_not(work: Path) -> None:
    ran = smts("inspect", "logs/field1.mcap", folder=work)
    assert ran.stderr == ""


def test_ingest_and_inspect_agree_on_what_is_in_the_log(work: Path) -> None:
    inspected = document(smts("inspect", "logs/field1.mcap", "--json", folder=work))
    ingested = document(smts("ingest", SAMPLE, "-o", "again", "--json", folder=work))["logs"][0]
    assert inspected["run"]["id"] == ingested["run"]["id"] == "field1"
    assert inspected["warnings"] == ingested["warnings"]
    assert {"imd1", "gps", "wds1"} <= set(inspected["health"])
    assert (work / "again" / "field1.mcap").read_bytes() == (work / "logs" / "field1.mcap").read_bytes()


def test_json_of_run_is_the_head_of_metrics_and_the_reference_engine_says_the_same(work: Path) -> None:
    words = ("run", "logs/field1.mcap", "-o", "json", "--json", "--engine", "filterpy", "--require-adequate")
    ran = smts(*words, "--figures", folder=work)
    head = json.loads(ran.stdout)
    assert ran.returncode == (0 if head["verdict"]["value"] == "adequate" else 3)
    metrics = json.loads((work / "json" / "metrics.json").read_text(encoding="utf-8"))
    for key in ("schema", "run", "verdict", "discrepancy", "warnings"):
        assert head[key] == metrics[key]
    assert list((work / "json" / "figures").glob("*.svg"))
    compiled = json.loads((work / "results" / "field1" / "metrics.json").read_text(encoding="utf-8"))
    for kind in ("trajectory", "yaw"):
        ours = metrics["discrepancy"][kind]["combined"]
        assert ours == pytest.approx(compiled["discrepancy"][kind]["combined"], rel=1e-3)
    assert metrics["provenance"]["options"]["fusion"]["engine"] == "filterpy"


def test_a_log_without_a_row_is_inconclusive_and_status_three_when_adequate_is_required(work: Path) -> None:
    plan = work / "short.toml"
    plan.write_text("[path]\nduration = 20.0\nrow_length = 30.0\n", encoding="utf-8")
    assert smts("synth", work / "short", "--plan", plan, "--id", "short").returncode == 0
    ran = smts("run", work / "short" / "short", "-o", work / "short-out", "--require-adequate")
    assert ran.returncode == 3, ran.stderr
    metrics = json.loads((work / "short-out" / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["verdict"]["value"] == "inconclusive"
    assert metrics["discrepancy"]["trajectory"]["combined"] is None


def test_report_makes_the_same_pages_again(work: Path, tmp_path: Path) -> None:
    copy = tmp_path / "field1"
    shutil.copytree(work / "results" / "field1", copy)
    before = {name: (copy / name).read_bytes() for name in ("report.html", "report.pdf", "result.mcap")}
    for name in before:
        (copy / name).unlink()
    ran = smts("report", copy, "--csv", "--latex", "--figures")
    assert ran.returncode == 0, ran.stderr
    assert {name: (copy / name).read_bytes() for name in before} == before
    assert list((copy / "tables").glob("*.csv"))
    assert list((copy / "tables").glob("*.tex"))
    assert {path.suffix for path in (copy / "figures").iterdir()} == {".svg", ".pdf", ".png"}
    assert not list(copy.glob(".report*"))


def test_a_typo_in_the_manifest_is_one_line_that_names_the_nearest_key(tmp_path: Path) -> None:
    folder = tmp_path / "pass"
    shutil.copytree(SAMPLE, folder)
    text = (folder / "run.toml").read_text(encoding="utf-8")
    (folder / "run.toml").write_text(text.replace("front_track", "front_trak"), encoding="utf-8")
    ran = smts("run", folder, "-o", tmp_path / "out")
    assert ran.returncode == 1
    assert len(ran.stderr.splitlines()) == 1
    assert "front_trak" in ran.stderr
    assert "`front_track`" in ran.stderr
    assert not (tmp_path / "out").exists()


def test_an_output_folder_that_holds_something_else_is_refused_and_left_alone(
    work: Path, tmp_path: Path
) -> None:
    (tmp_path / "thesis.tex").write_text("years of work", encoding="utf-8")
    ran = smts("run", "logs/field1.mcap", "-o", tmp_path, folder=work)
    assert ran.returncode == 1
    assert "thesis.tex" in ran.stderr
    assert (tmp_path / "thesis.tex").read_text(encoding="utf-8") == "years of work"


@pytest.fixture(scope="module")
def batch(passes: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ran]:
    out = tmp_path_factory.mktemp("batch") / "out"
    return out, smts("batch", passes, "-o", out, "-j", "2", "--json")


def test_a_batch_does_what_it_can_names_what_failed_and_exits_with_one(batch: tuple[Path, Ran]) -> None:
    out, ran = batch
    assert ran.returncode == 1
    *passed, end = events(ran)
    assert sorted(event["event"] for event in passed) == ["done", "done", "failed"]
    assert (end["event"], end["passes"], end["done"], end["failed"]) == ("end", 3, 2, 1)
    failures = json.loads((out / "failures.json").read_text(encoding="utf-8"))
    assert [failure["run"] for failure in failures["failures"]] == ["broken"]
    assert "gps.nmea" in failures["failures"][0]["reason"]
    assert "\n" not in failures["failures"][0]["reason"]
    assert sorted(path.name for path in (out / "passes").iterdir()) == ["field1-b-east-1", "field1-b-west-1"]
    assert {"campaign.json", "campaign.parquet", "report.html", "report.pdf"} <= {
        p.name for p in out.iterdir()
    }
    assert not (out / ".work").exists()


def test_the_campaign_table_has_a_row_a_pass_for_pandas_and_duckdb(batch: tuple[Path, Ran]) -> None:
    out, _ = batch
    path = out / "campaign.parquet"
    table = pd.read_parquet(path).set_index("run")
    assert list(table.index) == ["field1-b-east-1", "field1-b-west-1"]
    for run, row in table.iterrows():
        metrics = json.loads((out / "passes" / str(run) / "metrics.json").read_text(encoding="utf-8"))
        assert row["verdict.value"] == metrics["verdict"]["value"]
        assert row["discrepancy.trajectory.combined"] == metrics["discrepancy"]["trajectory"]["combined"]
        assert row["straightness.deviation1.r95"] == metrics["straightness"]["deviation1"]["r95"]
    average = 'avg("discrepancy.trajectory.combined")'
    query = f"SELECT direction, {average} FROM '{path}' GROUP BY ALL ORDER BY ALL"
    assert [row[0] for row in duckdb.sql(query).fetchall()] == ["east", "west"]


def test_resuming_computes_nothing_that_is_there_and_leaves_the_same_bytes(
    batch: tuple[Path, Ran], passes: Path
) -> None:
    out, _ = batch
    before = {path: path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}
    ran = smts("batch", passes, "-o", out, "-j", "2", "--json")
    assert sorted(event["event"] for event in events(ran)) == ["end", "failed", "unchanged", "unchanged"]
    assert {path: path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()} == before


def test_a_batch_leaves_each_pass_as_run_does(batch: tuple[Path, Ran], passes: Path, tmp_path: Path) -> None:
    out, _ = batch
    run = "field1-b-east-1"
    assert smts("run", passes / run, "-o", tmp_path / run).returncode == 0
    for name in ("trajectory.parquet", "simulation.parquet", "comparison.parquet", "run.toml"):
        assert (tmp_path / run / name).read_bytes() == (out / "passes" / run / name).read_bytes(), name


def test_a_job_arrays_commands_make_what_the_batch_makes(
    batch: tuple[Path, Ran], passes: Path, tmp_path: Path
) -> None:
    whole, _ = batch
    out = tmp_path / "out"
    commands = document(smts("batch", passes, "-o", out, "--print-commands", "--json"))["commands"]
    assert len(commands) == 4
    assert not out.exists()
    for command in reversed(commands[:-1]):
        words = command.replace("smts-validate", " ".join(COMMAND), 1)
        subprocess.run(words, shell=True, capture_output=True, timeout=300, check=False)
    assert not (out / "campaign.json").exists()
    ended = smts(*commands[-1].split()[1:], "--json")
    assert sorted(event["event"] for event in events(ended)) == ["end", "failed", "unchanged", "unchanged"]
    ours = {p.relative_to(out): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}
    theirs = {p.relative_to(whole): p.read_bytes() for p in sorted(whole.rglob("*")) if p.is_file()}
    assert ours == theirs


def test_limits_are_options_and_a_size_that_means_nothing_is_wrong_use(passes: Path, tmp_path: Path) -> None:
    ran = smts("batch", passes, "-o", tmp_path, "--memory-limit", "much")
    assert ran.returncode == 2
    assert len(ran.stderr.splitlines()) == 1
    one = passes / "field1-b-east-1"
    ran = smts("batch", one, "-o", tmp_path / "out", "-j", "1", "--time-limit", "0.2", "--json")
    assert ran.returncode == 1
    assert "--time-limit" in events(ran)[0]["reason"]
    ran = smts("batch", one, "-o", tmp_path / "out", "-j", "1", "--memory-limit", "60M", "--json")
    assert "--memory-limit" in events(ran)[0]["reason"]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (("simulate", "--variant", "z"), "'z'"),
        (("sweep", "--range", "nonsense=1:2"), "nonsense"),
        (("sweep", "--range", "speed"), "speed"),
        (("plan", "absent.toml"), "absent.toml"),
        (("synth", "out", "--preset", "benin"), "benign"),
        (("init", "absent"), "absent"),
    ],
    ids=lambda value: value[0] if isinstance(value, tuple) else "",
)
def test_what_a_command_cannot_use_is_named_in_one_line(
    words: tuple[str, ...], named: str, tmp_path: Path
) -> None:
    ran = smts(*words, folder=tmp_path)
    assert ran.returncode == 1
    assert len(ran.stderr.splitlines()) == 1
    assert named in ran.stderr
    assert "unexpected" not in ran.stderr


def test_a_small_sweep_prints_the_best_design_and_leaves_its_files(tmp_path: Path) -> None:
    ran = smts("sweep", "--count", "16", "--soils", "2", "-j", "2", "-o", "swept", "--json", folder=tmp_path)
    answer = document(ran)
    assert answer["out"] == "swept"
    assert all((tmp_path / file).is_file() for file in answer["files"])
    assert answer["tables"][0]["rows"]
