"""Inputs and OUT behind URLs: a local S3 server, a store in memory; and a parent whose memory is flat."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import batch_killed
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from moto.server import ThreadedMotoServer
from s3fs import S3FileSystem
from smts_validate.pipeline.batch import Request, run_batch
from smts_validate.pipeline.batch_loop import Progress

SAMPLE = Path(__file__).parents[2] / "data_samples" / "field1"
COMMAND = [sys.executable, "-m", "smts_validate.pipeline.cli"]

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def s3() -> Iterator[dict[str, str]]:
    """Environment of a batch that talks to a local S3 server with the sample pass in it."""
    server = ThreadedMotoServer(port=0)
    server.start()
    host, port = server.get_host_and_port()
    variables = {
        "AWS_ENDPOINT_URL": f"http://{host}:{port}",
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    store = S3FileSystem(key="testing", secret="testing", endpoint_url=variables["AWS_ENDPOINT_URL"])
    store.mkdir("field")
    store.put(str(SAMPLE) + "/", "field/raw/field1", recursive=True)
    yield variables
    server.stop()


def batch(s3: dict[str, str]) -> list[dict[str, object]]:
    words = ["batch", "s3://field/raw", "-o", "s3://field/results", "-j", "1", "--json"]
    ran = subprocess.run(
        [*COMMAND, *words], capture_output=True, text=True, timeout=300, env={**os.environ, **s3}, check=False
    )
    assert ran.returncode == 0, ran.stderr + ran.stdout
    return [json.loads(line) for line in ran.stdout.splitlines()]


def test_a_batch_from_and_to_an_object_store_resumes_there(s3: dict[str, str]) -> None:
    assert [event["event"] for event in batch(s3)] == ["done", "end"]
    store = S3FileSystem(key="testing", secret="testing", endpoint_url=s3["AWS_ENDPOINT_URL"])
    results = {path.removeprefix("field/results/") for path in store.find("field/results")}
    ours = {"metrics.json", "trajectory.parquet", "report.html", "report.pdf", "result.mcap"}
    assert {f"passes/field1/{name}" for name in ours} <= results
    assert {"campaign.json", "campaign.parquet", "failures.json", "report.html", "report.pdf"} <= results
    metrics = json.loads(store.cat_file("field/results/passes/field1/metrics.json"))
    assert metrics["run"] == "field1"
    assert [event["event"] for event in batch(s3)] == ["unchanged", "end"]


def test_a_batch_from_and_to_memory_in_one_process() -> None:
    store = MemoryFileSystem()
    text = (SAMPLE / "run.toml").read_bytes()
    for number in range(3):
        store.pipe_file(f"/mem/raw/p{number}/run.toml", text.replace(b'"field1"', f'"p{number}"'.encode(), 1))
    request = Request(paths=("memory://mem/raw",), out="memory://mem/out", workers=0, summarise=False)
    with pytest.MonkeyPatch.context() as patch:
        batch_killed.replace_chain(patch.setitem)
        assert run_batch(request, lambda progress: None)["done"] == 3
        assert run_batch(request, lambda progress: None)["unchanged"] == 3
        store.pipe_file("/mem/raw/p1/run.toml", text.replace(b'"field1"', b'"p1"', 1) + b"# changed\n")
        again = run_batch(request, lambda progress: None)
    assert (again["done"], again["unchanged"]) == (1, 2)
    assert store.cat_file("/mem/out/passes/p1/run.toml").endswith(b"# changed\n")


MEASURE = """
import resource, sys
sys.path.insert(0, {folder!r})
import batch_killed
from smts_validate.pipeline import batch
from smts_validate.pipeline.batch_limits import resident_bytes
request = batch.Request(paths=({raw!r},), out={out!r}, workers=2, summarise=False)
summary = batch.run_batch(request, lambda progress: None, batch_killed.quick)
print(summary["done"], summary["unchanged"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def parent_of(raw: Path, out: Path, count: int) -> tuple[int, int, int]:
    """Passes done and unchanged, and the parent's peak memory in KiB, of a batch over `count` tiny passes."""
    text = (SAMPLE / "run.toml").read_text(encoding="utf-8")
    for number in range(count):
        folder = raw / f"p{number:04d}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.toml").write_text(text.replace('"field1"', f'"p{number:04d}"', 1), encoding="utf-8")
    code = MEASURE.format(folder=str(Path(batch_killed.__file__).parent), raw=str(raw), out=str(out))
    ran = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=600, check=True
    )
    done, unchanged, peak = map(int, ran.stdout.split())
    return done, unchanged, peak


def test_the_parents_memory_is_flat_in_the_number_of_passes(tmp_path: Path) -> None:
    """2,000 passes are planned, run and found again in the memory of 20, but for a few kB a pass."""
    few = parent_of(tmp_path / "few", tmp_path / "few-out", 20)
    many = parent_of(tmp_path / "many", tmp_path / "many-out", 2000)
    again = parent_of(tmp_path / "many", tmp_path / "many-out", 2000)
    assert [run[:2] for run in (few, many, again)] == [(20, 0), (2000, 0), (0, 2000)]
    assert many[2] - few[2] < 16 * 1024
    assert again[2] - few[2] < 16 * 1024


def test_progress_is_an_event_a_pass_whatever_their_number() -> None:
    progress = Progress(total=2000, done=7, unchanged=1990, failed=1, running=("a", "b"), elapsed=10.0)
    assert progress.ended == 1998
    assert progress.time_left == pytest.approx(2 * 10.0 / 8)
