"""A batch that is killed leaves whole results only, no process behind, and the same bytes after going on."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import batch_killed
import psutil
import pytest

PASSES = 12
SCRIPT = Path(batch_killed.__file__)
SAMPLE = Path(__file__).parents[2] / "data_samples" / "field1" / "run.toml"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def raw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("raw")
    text = SAMPLE.read_text(encoding="utf-8")
    for number in range(PASSES):
        one = folder / f"pass{number}"
        one.mkdir()
        (one / "run.toml").write_text(text.replace('id = "field1"', f'id = "pass{number}"'), encoding="utf-8")
    return folder


def start(raw: Path, out: Path, workers: int = 2) -> subprocess.Popen[str]:
    command = [sys.executable, str(SCRIPT), str(raw), str(out), str(workers)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(raw: Path, out: Path) -> dict[str, int]:
    output, errors = start(raw, out).communicate(timeout=120)
    assert output, errors
    summary: dict[str, int] = json.loads(output)
    return summary


def tree(out: Path) -> dict[str, bytes]:
    return {p.relative_to(out).as_posix(): p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


def results(out: Path) -> Iterator[Path]:
    passes = out / "passes"
    yield from sorted(passes.iterdir()) if passes.is_dir() else ()


def wait_for(count: int, out: Path, batch: subprocess.Popen[str]) -> None:
    """Until so many results stand, or the batch is over."""
    while batch.poll() is None and len(list(results(out))) < count:
        time.sleep(0.001)


def all_gone(processes: list[psutil.Process], seconds: float = 5.0) -> bool:
    _, alive = psutil.wait_procs(processes, timeout=seconds)
    return not alive


@pytest.fixture(scope="module")
def undisturbed(raw: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    assert finish(raw, out)["done"] == PASSES
    return tree(out)


@pytest.mark.parametrize(
    ("whom", "moment"), [*(("parent", moment) for moment in range(10)), *(("worker", i) for i in (0, 4, 8))]
)
def test_killed_at_any_moment_it_leaves_whole_results_and_goes_on_to_the_same_bytes(
    raw: Path, undisturbed: dict[str, bytes], tmp_path: Path, moment: int, whom: str
) -> None:
    out = tmp_path / "out"
    batch = start(raw, out)
    wait_for(moment + 1, out, batch)
    time.sleep(0.007 * moment)  # another phase of writing each time
    children = psutil.Process(batch.pid).children(recursive=True)
    if whom == "parent":
        batch.kill()
        batch.communicate()
        assert all_gone(children), "workers outlived their batch"
    else:
        for child in children[-1:]:
            os.kill(child.pid, signal.SIGKILL)
        batch.communicate(timeout=120)
    assert all(batch_killed.is_whole(result) for result in results(out))
    stood = len(list(results(out)))
    summary = finish(raw, out)
    assert summary["unchanged"] == stood
    assert summary["done"] == PASSES - stood
    assert tree(out) == undisturbed


def test_an_interrupt_ends_it_within_seconds_with_status_of_failure_and_no_half_results(
    raw: Path, undisturbed: dict[str, bytes], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    batch = start(raw, out)
    wait_for(3, out, batch)
    children = psutil.Process(batch.pid).children(recursive=True)
    begin = time.monotonic()
    batch.send_signal(signal.SIGINT)
    _, errors = batch.communicate(timeout=30)
    assert time.monotonic() - begin < 5.0
    assert "the same command goes on from there" in errors
    assert all_gone(children)
    assert all(batch_killed.is_whole(result) for result in results(out))
    assert not (out / ".work").exists()
    finish(raw, out)
    assert tree(out) == undisturbed


def test_a_disk_that_is_full_fails_passes_by_name_and_leaves_no_half_result(
    raw: Path, tmp_path: Path
) -> None:
    """A limit on the size of files stands in for the disk: the write fails half-way with an OSError."""
    out = tmp_path / "out"
    limited = (
        f"import resource, runpy, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096));"
        f"sys.argv = [{str(SCRIPT)!r}, {str(raw)!r}, {str(out)!r}, '2'];"
        f"runpy.run_path({str(SCRIPT)!r}, run_name='__main__')"
    )
    ran = subprocess.run(
        [sys.executable, "-c", limited], capture_output=True, text=True, timeout=120, check=False
    )
    summary = json.loads(ran.stdout)
    assert summary["failed"] == PASSES
    assert all("File too large" in failure["reason"] for failure in summary["failures"])
    assert list(results(out)) == []
    assert finish(raw, out)["done"] == PASSES


def test_a_changed_input_is_computed_again_and_nothing_else(raw: Path, tmp_path: Path) -> None:
    copy = tmp_path / "raw"
    for one in raw.iterdir():
        (copy / one.name).mkdir(parents=True)
        (copy / one.name / "run.toml").write_bytes((one / "run.toml").read_bytes())
    out = tmp_path / "out"
    finish(copy, out)
    with (copy / "pass3" / "run.toml").open("a", encoding="utf-8") as file:
        file.write("# a remark\n")
    (copy / "pass5" / "extra.csv").write_text("t\n", encoding="utf-8")
    summary = finish(copy, out)
    assert (summary["done"], summary["unchanged"]) == (2, PASSES - 2)
    assert b"# a remark" in (out / "passes" / "pass3" / "run.toml").read_bytes()
