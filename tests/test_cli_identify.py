"""identify as a person types it: a tractor alone from raw files to a held-out verdict, and what goes wrong."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import jsonschema
import pandas as pd
import pytest

COMMAND = [sys.executable, "-m", "smts_validate.pipeline.cli"]
ROOT = Path(__file__).parents[1]
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
FRONT = "tyres.front.cornering_stiffness"
TRUTH = 0.5  # of the stated stiffness
PLAN = f"""
preset = "tractor_alone"
seed = 11
repeats = 2
directions = ["east", "west"]
[base.path]
duration = 45.0
[base.driver]
weave_deg = 0.7
weave_period = 4.0
[base.truth]
"{FRONT}" = {TRUTH}
[base.sensors.steer]
kind = "steer"
file = "steer.csv"
rate = 50.0
"""

pytestmark = pytest.mark.slow


def smts(*words: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*COMMAND, *map(str, words)],
        capture_output=True,
        text=True,
        timeout=600,
        env={**os.environ, **ONE_THREAD},
        check=False,
    )


def document(*words: object) -> Any:
    ran = smts(*words, "--json")
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout)


@pytest.fixture(scope="module")
def passes(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Raw folders of a tractor without a seeder, two passes each way."""
    folder = tmp_path_factory.mktemp("alone")
    (folder / "plan.toml").write_text(PLAN, encoding="utf-8")
    made = document("synth", folder / "raw", "--campaign", folder / "plan.toml")["passes"]
    assert len(made) == 4
    return list(made)


def test_a_tractor_alone_is_identified_from_raw_folders_and_judged_on_what_was_held_out(
    passes: list[str], tmp_path: Path
) -> None:
    found = document("identify", *passes, "--free", "cornering_stiffness.front", "-o", tmp_path / "out")
    (front,) = found["parameters"]
    low, high = front["interval"]
    assert front["parameter"] == FRONT
    assert low < TRUTH * front["stated"] < high
    assert high < front["stated"]  # the stated value is found out
    assert [fold["left_out"] for fold in found["folds"]] == ["field1 east", "field1 west"]
    assert found["verdict"]["passes"] == 4
    for stage in found["stages"].values():
        assert stage["discrepancy"]["trajectory"]["body2"] is None
    stored = json.loads((tmp_path / "out" / "identify.json").read_text(encoding="utf-8"))
    schema = json.loads((ROOT / "docs" / "identify.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(stored, schema)
    assert stored["verdict"] == found["verdict"]
    assert "before: as stated" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_a_tractor_alone_goes_through_the_chain_and_body_two_is_absent_everywhere(
    passes: list[str], tmp_path: Path
) -> None:
    (log,) = document("ingest", passes[0], "-o", tmp_path / "logs")["logs"]
    head = document("run", log["log"], "-o", tmp_path / "out")
    assert head["discrepancy"]["trajectory"]["body1"] is not None
    assert head["discrepancy"]["trajectory"]["body2"] is None
    for table in ("trajectory", "simulation"):
        columns = pd.read_parquet(tmp_path / "out" / f"{table}.parquet").columns
        assert "x1" in columns
        assert not [name for name in columns if name.endswith("2")]


def test_one_pass_alone_is_identified_and_says_that_nothing_is_left_to_judge(
    passes: list[str], tmp_path: Path
) -> None:
    for words in (passes[:1], [*passes[:2], "--folds", "direction"]):
        found = document("identify", *words, "--free", "cornering_stiffness.front", "-o", tmp_path / "out")
        assert found["folds"] == []
        assert found["verdict"]["value"] == "inconclusive"
        assert "no pass is left to judge" in found["verdict"]["reasons"][0]
        assert found["stages"]["held_out"]["discrepancy"]["trajectory"]["combined"] is None


def test_the_names_that_can_be_freed_are_listed(passes: list[str]) -> None:
    ran = smts("identify", passes[0], "--free", "help")
    assert ran.returncode == 0
    assert FRONT in ran.stdout
    assert "cornering_stiffness.front" in ran.stdout


@pytest.mark.parametrize(
    ("words", "status", "says"),
    [
        (["--free", "cornering_stifness.front"], 2, f"did you mean `{FRONT}`"),
        (["--free", "l5"], 2, "no seeder"),
        (["--free", ","], 2, "names no parameter"),
        (["--free", "cornering_stiffness.front=3:1"], 2, "3 is not below 1"),
        (["--free", "front.relaxation_length"], 2, "give its bounds"),
        (["--free", "l2", "--prior", "l2=1"], 2, "NAME=MEAN:SD"),
        (["--free", "l2", "--prior", "l2=1:-1"], 2, "must be above 0"),
        (["--free", "l2", "--prior", "l2=900:1"], 2, "outside the bounds"),
        (["--free", "l2", "--prior", "l3=1:1"], 2, "is not free"),
        (["--free", "l2", "--priors", "absent.toml"], 1, "absent.toml: "),
        (["--free", "l2", "--folds", "month"], 2, "--folds"),
        (["--free", "l2", "--manifest", "a.toml", "--manifest", "b.toml"], 2, "2 for 1 passes"),
        (["--free", "cog_height"], 1, "does not act on the motion compared"),
        ([], 2, "--free"),
    ],
)
def test_what_cannot_be_identified_is_one_line_and_a_status(
    passes: list[str], tmp_path: Path, words: list[str], status: int, says: str
) -> None:
    ran = smts("identify", passes[0], *words, "-o", tmp_path / "out")
    assert ran.returncode == status, ran.stderr
    assert says in ran.stderr
    assert ran.stderr.count("\n") == 1
    assert ran.stdout == ""
    assert not (tmp_path / "out").exists()


def test_sources_that_are_missing_or_the_same_are_named(passes: list[str], tmp_path: Path) -> None:
    for words, says in (
        ([tmp_path / "absent"], "absent: there is no such file or folder"),
        ([passes[0], passes[0]], "two passes have this run.id"),
    ):
        ran = smts("identify", *words, "--free", "cornering_stiffness.front", "-o", tmp_path / "out")
        assert ran.returncode == 1
        assert says in ran.stderr
        assert ran.stderr.count("\n") == 1


def test_a_pass_without_a_row_says_why_there_is_nothing_to_fit(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(
        'preset = "tractor_alone"\n[path]\nduration = 22.0\n', encoding="utf-8"
    )
    (folder,) = document("synth", tmp_path / "raw", "--plan", tmp_path / "short.toml")["passes"]
    ran = smts("identify", folder, "--free", "cornering_stiffness.front", "-o", tmp_path / "out")
    assert ran.returncode == 1
    assert "no pass has a row that could be compared" in ran.stderr
    assert "a row needs 60 m" in ran.stderr
    assert ran.stderr.count("\n") == 1
