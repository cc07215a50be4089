"""The official MCAP conformance suite: each of its 416 valid files gives the records that it lists."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from log_samples import REAL
from smts_validate.sensors.mcap_messages import Batch, open_chunk, read_messages
from smts_validate.sensors.mcap_records import MAGIC, Chunk, MessageIndex, Record, parse, walk
from smts_validate.sensors.mcap_scan import open_recording

ARCHIVE = REAL / "mcap_conformance" / "conformance_416.tar.gz"

pytestmark = pytest.mark.skipif(not ARCHIVE.exists(), reason="needs ../shared/real/mcap_conformance")


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("conformance")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(folder, filter="data")
    return sorted(folder.rglob("*.mcap"))


def expected(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """Type and fields of each record, as the suite lists them."""
    listed = json.loads(path.with_suffix(".json").read_text())["records"]
    return [(each["type"], dict(each["fields"])) for each in listed]


def records(path: Path) -> Iterator[Record]:
    """Every record in order, those of a chunk in its place. The suite does not list message indexes."""
    data = np.frombuffer(path.read_bytes(), np.uint8)

    def inside(part: Any, start: int, stop: int) -> Iterator[Record]:
        table = walk(part, start, stop)
        assert table.complete
        for opcode, at, length in zip(
            table.opcode.tolist(), table.start.tolist(), table.length.tolist(), strict=True
        ):
            record = parse(part, opcode, at, length)
            if isinstance(record, Chunk):
                block = open_chunk(data, record)
                assert not block.faults
                yield from inside(block.data, 0, block.data.size)
            elif record is not None and not isinstance(record, MessageIndex):
                yield record

    yield from inside(data, len(MAGIC), data.size - len(MAGIC))


def as_listed(value: Any) -> Any:
    """A field in the suite's notation: numbers and bytes as decimal strings."""
    if isinstance(value, bytes):
        return [str(byte) for byte in value]
    if isinstance(value, dict):
        return {str(key): as_listed(each) for key, each in value.items()}
    return str(value) if isinstance(value, int) else value


def test_all_files_of_the_suite_give_the_records_that_they_list(suite: list[Path]) -> None:
    assert len(suite) == 416
    for path in suite:
        ours = [
            (type(each).__name__, {k: as_listed(v) for k, v in vars(each).items()}) for each in records(path)
        ]
        theirs = [each for each in expected(path) if each[0] != "MessageIndex"]
        assert [kind for kind, _ in ours] == [kind for kind, _ in theirs], path.name
        for (kind, got), (_, wanted) in zip(ours, theirs, strict=True):
            assert {key: got[key] for key in wanted} == wanted, f"{path.name}: {kind}"


def test_all_files_of_the_suite_are_read_without_complaint(suite: list[Path]) -> None:
    for path in suite:
        recording = open_recording(path)
        found = list(read_messages(recording, lambda channel: True))
        batches = [each for each in found if isinstance(each, Batch)]
        assert recording.faults == (), path.name
        assert len(batches) == len(found), path.name
        sent = [fields for kind, fields in expected(path) if kind == "Message"]
        assert [str(t) for batch in batches for t in batch.log_time.tolist()] == [m["log_time"] for m in sent]
        assert [as_listed(batch.payloads.at(i)) for batch in batches for i in range(len(batch.payloads))] == [
            m["data"] for m in sent
        ]
