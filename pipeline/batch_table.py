"""campaign.parquet: a row a pass with every index and metric, written as a stream."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from ..sensors.manifest import Manifest

LEFT_OUT = ("schema", "warnings", "health", "provenance", "conditions")
ROWS_A_GROUP = 256

Row = dict[str, Any]


def row(manifest: Manifest, metrics: Mapping[str, Any]) -> Row:
    """One pass as a flat row: its place in the campaign, its design parameters, each figure of metrics.json.

    A nested figure's column is its keys joined by dots (`discrepancy.trajectory.combined`); an interval
    becomes `.low` and `.high`; other lists are left out, their length in `.count`.
    """
    run, machine = manifest.run, manifest.machine
    first: Row = {
        "run": run.id,
        "field": run.field,
        "direction": run.direction,
        "repeat": run.repeat,
        "variant": run.variant,
        "date": run.date.isoformat(),
        "speed": manifest.operating.speed,
        "tyre_pressure_mpa": manifest.operating.tyre_pressure_mpa,
        "hitch_to_com": None if machine.seeder is None else machine.seeder.hitch_to_com,
        "warnings": len(metrics.get("warnings", ())),
    }
    kept = {key: value for key, value in metrics.items() if key not in LEFT_OUT and key not in first}
    return first | dict(_flat(kept, ""))


def _flat(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else str(key))
    elif isinstance(value, list | tuple):
        if name.endswith("interval") and len(value) == 2:
            yield from ((f"{name}.low", value[0]), (f"{name}.high", value[1]))
        else:
            yield f"{name}.count", len(value)
    else:
        yield name, value


def write_rows(path: Path, rows: Sequence[Any], read: Any) -> None:
    """Write a Parquet file with a row for each item of `rows`, made by `read(item)`.

    More rows than a group holds are read twice, once for the columns and once for the values, and never held
    together.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    known = [read(item) for item in rows] if len(rows) <= ROWS_A_GROUP else None
    schema = _schema((read(item) for item in rows) if known is None else known)
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        waiting = (read(item) for item in rows) if known is None else iter(known)
        while values := list(islice(waiting, ROWS_A_GROUP)):
            columns = {
                name: [_as(value.get(name), schema.field(name).type) for value in values]
                for name in schema.names
            }
            writer.write_table(pa.table(columns, schema=schema))


def _schema(rows: Iterable[Row]) -> Any:
    """Columns in the order of their first appearance; one with any text is text, other numbers float64."""
    import pyarrow as pa

    kinds: dict[str, set[type]] = {}
    for one in rows:
        for name, value in one.items():
            kinds.setdefault(name, set()).update(() if value is None else (type(value),))
    return pa.schema([(name, _type(found)) for name, found in kinds.items()])


def _type(found: set[type]) -> Any:
    import pyarrow as pa

    if str in found:
        return pa.string()
    if found == {bool}:
        return pa.bool_()
    return pa.int64() if found == {int} else pa.float64()


def _as(value: Any, kind: Any) -> Any:
    import pyarrow as pa

    if value is None:
        return None
    if kind == pa.string():
        return str(value)
    return float(value) if kind == pa.float64() else value
