"""Where a pass is read from: a raw folder, a log, or neither, which is said with the way out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from smts_validate.pipeline.source import SourceError, ingest_pass, inspect_log, read_source
from smts_validate.sensors.log_collect import LogError


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
