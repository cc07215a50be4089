"""OUT of a batch holds whole results only, and limits end a pass that needs too much."""

from __future__ import annotations

import fcntl
import json
import os
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from smts_validate.pipeline import batch_limits
from smts_validate.pipeline.batch_limits import LimitReached, Limits, limited, parse_bytes
from smts_validate.pipeline.batch_store import open_store, work_folder


def write_result(folder: Path, mark: str) -> None:
    folder.mkdir()
    (folder / "metrics.json").write_text(json.dumps({"provenance": {"fingerprint": mark}}), encoding="utf-8")
    (folder / "comparison.parquet").write_bytes(mark.encode())


@pytest.mark.parametrize("kind", ["folder", "memory"])
def test_a_result_appears_whole_and_is_replaced_whole(kind: str, tmp_path: Path) -> None:
    out = str(tmp_path / "out") if kind == "folder" else f"memory://store-{os.getpid()}"
    store = open_store(out, "w")
    assert store.fingerprint("one") is None
    for mark in ("first", "second"):
        with store.writing("one") as path:
            write_result(path, mark)
        assert store.fingerprint("one") == mark
    with store.local(["one"]) as local:
        assert (local / "passes" / "one" / "comparison.parquet").read_bytes() == b"second"


@pytest.mark.parametrize("kind", ["folder", "memory"])
def test_a_result_that_fails_half_way_leaves_the_old_one(kind: str, tmp_path: Path) -> None:
    out = str(tmp_path / "out") if kind == "folder" else f"memory://half-{os.getpid()}"
    store = open_store(out, "w")
    with store.writing("one") as path:
        write_result(path, "old")
    with pytest.raises(OSError, match="full"), store.writing("one") as path:
        write_result(path, "new")
        raise OSError("the disk is full")
    assert store.fingerprint("one") == "old"
    if kind == "folder":
        assert list((tmp_path / "out" / ".work" / "w").iterdir()) == []


def test_an_upload_that_is_cut_short_is_no_result() -> None:
    import fsspec

    out = f"memory://cut-{os.getpid()}"
    store = open_store(out, "w")
    with store.writing("one") as path:
        write_result(path, "old")
    order: list[str] = []
    system = fsspec.filesystem("memory")
    original = type(system).pipe_file

    def noting(self, path, value, **kwargs):  # type: ignore[no-untyped-def]
        order.append(path.rsplit("/", 1)[-1])
        return original(self, path, value, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(system), "pipe_file", noting)
        with store.writing("one") as path:
            write_result(path, "new")
    assert order == ["comparison.parquet", "metrics.json"]


def test_the_work_folder_is_gone_at_the_end_and_dead_batches_are_swept(tmp_path: Path) -> None:
    top = tmp_path / ".work"
    dead, alive = top / "dead", top / "alive"
    dead.mkdir(parents=True)
    alive.mkdir()
    (top / "dead.lock").touch()
    with (top / "alive.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with work_folder(str(tmp_path)) as name:
            (top / name).mkdir()
            assert not dead.exists()
            assert alive.exists()
        assert not (top / name).exists()
    with work_folder(str(tmp_path)):
        assert not alive.exists()
    assert not top.exists()


def test_a_pass_that_takes_too_long_is_ended_with_the_reason() -> None:
    begin = time.monotonic()
    with pytest.raises(LimitReached), limited(Limits(seconds=0.2)) as reasons:
        while time.monotonic() - begin < 10.0:
            pass
    assert time.monotonic() - begin < 2.0
    assert reasons == ["took longer than 0.2 s (--time-limit)"]


def test_a_pass_that_needs_too_much_memory_is_ended_with_the_reason() -> None:
    limit = Limits(memory=parse_bytes("64M") + _resident())
    kept = []
    with pytest.raises(LimitReached), limited(limit) as reasons:
        for _ in range(400):
            kept.append(np.ones(2**18))  # 2 MiB
            time.sleep(0.005)
    assert "--memory-limit" in reasons[0]
    assert len(kept) < 200


def _resident() -> int:
    from smts_validate.pipeline.batch_limits import resident_bytes

    return resident_bytes()


def test_a_library_that_drops_the_exception_does_not_lift_the_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_limits, "AGAIN", 0.2)

    def drops_one() -> None:
        with suppress(LimitReached):  # as C code does that cannot pass an exception on
            _busy()
        _busy()

    with pytest.raises(LimitReached), limited(Limits(seconds=0.1)):
        drops_one()


def _busy() -> None:
    until = time.monotonic() + 10.0
    while time.monotonic() < until:
        pass


def test_a_pass_within_its_limits_is_left_alone() -> None:
    before = threading.active_count()
    for _ in range(20):
        with limited(Limits(seconds=30.0, memory=2**40)) as reasons:
            sum(range(1000))
        assert reasons == []
    time.sleep(0.3)
    assert threading.active_count() <= before


def test_a_limit_holds_in_any_thread_as_on_a_dask_worker() -> None:
    ended: list[str] = []

    def work() -> None:
        try:
            with limited(Limits(seconds=0.1)) as reasons:
                while True:
                    time.sleep(0.01)
        except LimitReached:
            ended.extend(reasons)

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(5.0)
    assert ended == ["took longer than 0.1 s (--time-limit)"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [("2G", 2 * 1024**3), ("800M", 800 * 1024**2), ("1.5GiB", 3 * 2**29), ("64kb", 65536), ("1000", 1000)],
)
def test_sizes_are_read_as_people_write_them(text: str, expected: int) -> None:
    assert parse_bytes(text) == expected


@pytest.mark.parametrize("text", ["", "G", "-1G", "0", "nan", "two", "1e99G"])
def test_sizes_that_mean_nothing_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r".*"):
        parse_bytes(text)
