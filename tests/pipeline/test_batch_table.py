"""campaign.parquet: the same rows and columns whether they were read once or, being many, twice."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from smts_validate.pipeline import batch_table
from smts_validate.pipeline.batch_table import write_rows

ROWS: dict[str, dict[str, Any]] = {
    "a": {"run": "a", "u": 1, "skid": None},
    "b": {"run": "b", "u": 0.5, "consistent": True},
    "c": {"run": "c", "u": None, "skid": 2, "note": "wet"},
    "d": {"run": "d", "note": 7},
}


@pytest.mark.parametrize(("rows_a_group", "reads"), [(1, 8), (3, 8), (4, 4), (256, 4)])
def test_rows_arrive_whole_with_every_column_of_any_row_read_once_where_a_group_holds_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rows_a_group: int, reads: int
) -> None:
    monkeypatch.setattr(batch_table, "ROWS_A_GROUP", rows_a_group)
    asked: list[str] = []

    def read(run: str) -> dict[str, Any]:
        asked.append(run)
        return ROWS[run]

    write_rows(tmp_path / "t.parquet", list(ROWS), read)
    table = pq.read_table(tmp_path / "t.parquet")
    assert table.to_pydict() == {
        "run": ["a", "b", "c", "d"],
        "u": [1.0, 0.5, None, None],
        "skid": [None, None, 2, None],
        "consistent": [None, True, None, None],
        "note": [None, None, "wet", "7"],
    }
    assert [table.schema.field(name).type for name in ("u", "skid", "consistent", "note")] == [
        pa.float64(), pa.int64(), pa.bool_(), pa.string()
    ]  # fmt: skip
    assert len(asked) == reads
