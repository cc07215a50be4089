"""The same batch on a Dask cluster of two worker processes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import batch_samples
import dask
import psutil
import pytest
from distributed import Client, LocalCluster
from smts_validate.pipeline.batch_executors import ClusterError, dask_executor
from smts_validate.pipeline.batch_loop import Progress, run_all

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as running,
    ):
        yield running


def cluster_pids(cluster: Any) -> set[int]:
    with Client(cluster.scheduler_address, set_as_default=False) as client:
        return set(client.run(os.getpid).values())


def test_a_cluster_runs_every_pass_once_in_a_process_that_each_worker_keeps_for_it(cluster: Any) -> None:
    executor, slots = dask_executor(cluster.scheduler_address)
    assert slots == 2
    seen: list[Progress] = []
    tasks = [batch_samples.task(str(i)) for i in range(12)]
    with executor:
        result = run_all(tasks, executor, slots, watch=seen.append, work=batch_samples.succeed)
    assert result.done == 12
    computed_in = {int(progress.last.verdict) for progress in seen if progress.last}
    workers = cluster_pids(cluster)
    assert len(computed_in) == len(workers) == 2
    assert {psutil.Process(pid).ppid() for pid in computed_in} == workers


def test_equal_submissions_all_run(cluster: Any, tmp_path: Path) -> None:
    executor, slots = dask_executor(cluster.scheduler_address)
    same = batch_samples.task("same", out=str(tmp_path))
    with executor:
        run_all([same, same, same], executor, slots, work=batch_samples.nap)
    assert len((tmp_path / "same.tries").read_text()) == 3


def test_a_pass_that_kills_its_worker_is_named_and_the_others_are_done(cluster: Any, tmp_path: Path) -> None:
    executor, slots = dask_executor(cluster.scheduler_address)
    tasks = [batch_samples.task(run, out=str(tmp_path)) for run in ("a", "deadly", "b", "c")]
    with executor:
        result = run_all(tasks, executor, slots, work=batch_samples.die_when_named_deadly)
    assert result.done == 3
    assert [failure.run for failure in result.failures] == ["deadly"]
    assert "worker died" in result.failures[0].reason
    assert len((tmp_path / "deadly.tries").read_text()) >= 3


def test_an_address_where_nobody_answers_is_named() -> None:
    with pytest.raises(ClusterError, match=r"tcp://127\.0\.0\.1:9: no Dask scheduler answers"):
        dask_executor("tcp://127.0.0.1:9", timeout=2.0)


def test_a_scheduler_without_workers_is_refused_with_the_command_that_starts_one() -> None:
    with (
        LocalCluster(n_workers=0, processes=True, dashboard_address=None) as empty,
        pytest.raises(ClusterError, match="dask worker"),
    ):
        dask_executor(empty.scheduler_address)
