"""Where a pass is read from: a raw folder, a log, or neither, which is said with the way out."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from smts_validate.pipeline.run import run_pass
from smts_validate.pipeline.run_settings import RunSettings
from smts_validate.pipeline.source import SourceError, ingest_pass, inspect_log, read_source
from smts_validate.sensors.log import write_log
from smts_validate.sensors.log_collect import LogError

SAMPLE = Path(__file__).parents[2] / "data_samples" / "field1"


@pytest.mark.parametrize(
    "command", [read_source, inspect_log, lambda folder: ingest_pass(folder, folder / "logs")]
)
def test_a_folder_without_run_toml_is_told_how_to_get_one(
    command: Callable[[Path], object], tmp_path: Path
) -> None:
    (tmp_path / "imd1.csv").write_text("t_host_ns,ax\n")
    with pytest.raises(SourceError, match=r"has no run\.toml.*`smts-validate init .*` drafts one") as caught:
        command(tmp_path)
    assert "\n" not in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    assert {each.name for each in tmp_path.iterdir()} == {"imd1.csv"}


@pytest.mark.parametrize("name", ["metadata.yaml", "a_0.mcap"])
def test_a_recordings_folder_is_not_taken_for_a_raw_pass(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("")
    with pytest.raises(LogError):
        read_source(tmp_path)


@pytest.mark.parametrize(
    ("hitch", "axle", "told"),
    [
        ("2.05", "-9.0", "leaves the seeder's wheels without load"),
        ("9.0", "2.0", "leaves the tractor's front wheels without load"),
    ],
)
def test_a_wheel_without_load_is_refused_with_file_line_and_key(
    hitch: str, axle: str, told: str, tmp_path: Path
) -> None:
    folder = shutil.copytree(SAMPLE, tmp_path / "field1")
    text = (folder / "run.toml").read_text(encoding="utf-8")
    for key, value in (("hitch", hitch), ("com_to_axle", axle)):
        text = re.sub(rf"^{key} = .*$", f"{key} = {value}", text, flags=re.MULTILINE)
    (folder / "run.toml").write_text(text, encoding="utf-8")
    line = 1 + text[: text.index("com_to_axle")].count("\n")
    log = read_source(folder)
    write_log(tmp_path / "field1.mcap", log)
    place = rf"run\.toml, line {line}: machine\.seeder\.com_to_axle is .*{told}"
    for refused in (
        lambda: ingest_pass(folder, tmp_path / "logs"),
        lambda: run_pass(log, RunSettings()),
        lambda: run_pass(read_source(tmp_path / "field1.mcap"), RunSettings()),
    ):
        with pytest.raises(SourceError, match=place) as caught:
            refused()
        assert str(tmp_path / "field1") in str(caught.value)
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "logs").exists()
