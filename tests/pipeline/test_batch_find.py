"""Which passes a batch finds, and under which name it runs them."""

from __future__ import annotations

from pathlib import Path

import pytest
from smts_validate.pipeline.batch import Request, absolute
from smts_validate.pipeline.batch_find import FindError, Source, find
from smts_validate.pipeline.batch_plan import Terms, name, plan
from smts_validate.pipeline.run_settings import RunSettings
from smts_validate.sensors.log import Attachment, write_channels


def raw_pass(folder: Path, run: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "run.toml").write_text(f'schema = 1\n[run]\nid = "{run}"\n', encoding="utf-8")
    return folder


def log(path: Path, manifest: str | None) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    attached = () if manifest is None else (Attachment("run.toml", "application/toml", manifest.encode()),)
    write_channels(path, [], attached, {})
    return path


def terms(tmp_path: Path) -> Terms:
    return Terms(out=str(tmp_path / "out"), work="w", settings=RunSettings())


def test_raw_passes_and_logs_are_found_at_any_depth_each_once(tmp_path: Path) -> None:
    raw = raw_pass(tmp_path / "data" / "may" / "one", "one")
    other = log(tmp_path / "data" / "logs" / "two.mcap", None)
    found = find([str(tmp_path / "data"), str(raw)], str(tmp_path / "out"))
    assert {source.path for source in found.sources} == {str(raw), str(other)}
    assert found.campaign is None


def test_results_and_hidden_folders_are_no_passes(tmp_path: Path) -> None:
    raw = raw_pass(tmp_path / "one", "one")
    result = raw_pass(tmp_path / "results" / "passes" / "one", "one")
    (result / "metrics.json").write_text("{}", encoding="utf-8")
    raw_pass(tmp_path / ".work" / "x", "one")
    raw_pass(tmp_path / "out" / "y", "y")
    found = find([str(tmp_path)], str(tmp_path / "out"))
    assert [source.path for source in found.sources] == [str(raw)]


def test_a_campaign_file_in_a_path_is_found_and_a_second_one_refused(tmp_path: Path) -> None:
    raw_pass(tmp_path / "one", "one")
    (tmp_path / "campaign.toml").write_text("", encoding="utf-8")
    assert find([str(tmp_path)], "out").campaign == str(tmp_path / "campaign.toml")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "campaign.toml").write_text("", encoding="utf-8")
    with pytest.raises(FindError, match=r"second campaign\.toml"):
        find([str(tmp_path)], "out")


@pytest.mark.parametrize("there", [False, True])
def test_a_path_without_a_pass_is_refused_by_name(tmp_path: Path, there: bool) -> None:
    path = tmp_path / "empty"
    if there:
        path.mkdir()
    with pytest.raises(FindError, match="empty: "):
        find([str(path)], "out")


def test_a_recording_beside_a_manifest_that_names_topics_is_run_with_it(tmp_path: Path) -> None:
    folder = raw_pass(tmp_path / "bag", "bag")
    with (folder / "run.toml").open("a", encoding="utf-8") as file:
        file.write('[sensors.imu]\nkind = "imd"\ntopic = "/imu"\n')
    recording = log(folder / "drive.mcap", None)
    found = find([str(tmp_path)], "out")
    assert found.sources == (Source(str(recording), str(folder / "run.toml")),)


def test_passes_are_named_by_their_manifest_and_logs_by_the_one_they_carry(tmp_path: Path) -> None:
    raw = raw_pass(tmp_path / "folder", "the-id")
    carried = log(tmp_path / "renamed.mcap", 'schema = 1\n[run]\nid = "inside"\n')
    assert name(Source(str(raw))).run == "the-id"
    assert name(Source(str(carried))).run == "inside"


@pytest.mark.parametrize("run", ["../../etc", "a/b", "", ".hidden", "a..b"])
def test_an_id_that_would_climb_out_of_the_results_is_never_a_folder_name(tmp_path: Path, run: str) -> None:
    raw = raw_pass(tmp_path / "folder", run)
    assert name(Source(str(raw))).run == "folder"


def test_a_damaged_log_keeps_its_files_name_so_that_its_failure_can_be_listed(tmp_path: Path) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(b"not a log")
    assert name(Source(str(broken))).run == "broken"


def test_a_raw_pass_and_the_log_made_of_it_are_one_pass(tmp_path: Path) -> None:
    raw = raw_pass(tmp_path / "raw", "one")
    made = log(tmp_path / "one.mcap", (raw / "run.toml").read_text(encoding="utf-8"))
    planned = plan([Source(str(raw)), Source(str(made))], terms(tmp_path))
    assert [task.source.path for task in planned.tasks] == [str(made)]
    assert planned.refused == ()


def test_different_passes_with_one_id_are_both_refused_each_naming_the_other(tmp_path: Path) -> None:
    first, second = raw_pass(tmp_path / "a", "one"), raw_pass(tmp_path / "b", "one")
    third = raw_pass(tmp_path / "c", "three")
    planned = plan([Source(str(p)) for p in (first, second, third)], terms(tmp_path))
    assert [task.run for task in planned.tasks] == ["three"]
    reasons = [outcome.reason for outcome in planned.refused]
    assert len(reasons) == 2
    assert str(second) in reasons[0]
    assert str(first) in reasons[1]


def test_memory_urls_are_walked_like_folders() -> None:
    import fsspec

    store = fsspec.filesystem("memory")
    store.pipe_file("/find/a/run.toml", b'schema = 1\n[run]\nid = "far"\n')
    store.pipe_file("/find/results/passes/far/run.toml", b"")
    store.pipe_file("/find/results/passes/far/metrics.json", b"{}")
    store.pipe_file("/find/logs/b.mcap", b"")
    found = find(["memory://find"], "memory://find/results")
    assert {source.path for source in found.sources} == {"memory:///find/a", "memory:///find/logs/b.mcap"}
    assert name(found.sources[0]).run == "far"


def test_a_clusters_workers_get_paths_that_do_not_depend_on_where_they_run() -> None:
    request = absolute(Request(paths=("data", "s3://bucket/x"), out="results", scheduler="tcp://a:1"))
    assert request.paths == (str(Path("data").resolve()), "s3://bucket/x")
    assert request.out == str(Path("results").resolve())
