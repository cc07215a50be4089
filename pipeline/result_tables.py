"""The tables of a pass's result: values in, Arrow tables out, and back."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from .fusion.motion import BodyMotion, Motion
from .report_view import PlotSeries

Floats = NDArray[np.float64]

X, Y, YAW, V, V_LATERAL, YAW_RATE = range(6)  # order of BodyMotion.covariance
METADATA_KEY = b"smts"


class LineLike(Protocol):
    """A row's line: a, b in m ENU in the direction of travel."""

    @property
    def a(self) -> Floats: ...
    @property
    def b(self) -> Floats: ...

    def project(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        """Chainage s along the line from a, and deviation n to its left, m."""
        ...


class RowLike(Protocol):
    """A row of a pass: samples start to stop (excluded) of the motion's grid, and its line."""

    @property
    def index(self) -> int: ...
    @property
    def line(self) -> LineLike: ...
    @property
    def start(self) -> int: ...
    @property
    def stop(self) -> int: ...


def row_column(n: int, rows: Sequence[RowLike]) -> NDArray[np.int32]:
    """(n,) index of the row that each sample belongs to, -1 outside rows."""
    column = np.full(n, -1, dtype=np.int32)
    for row in rows:
        column[row.start : row.stop] = row.index
    return column


def path_columns(x: Floats, y: Floats, rows: Sequence[RowLike]) -> tuple[Floats, Floats]:
    """(N,) s and n in m of a track relative to each row's own line; NaN outside rows."""
    s, n = np.full(x.size, np.nan), np.full(x.size, np.nan)
    for row in rows:
        part = slice(row.start, row.stop)
        s[part], n[part] = row.line.project(x[part], y[part])
    return s, n


def heading_column(n: int, rows: Sequence[RowLike]) -> Floats:
    """(n,) rad heading of the line of the row that each sample belongs to, NaN outside rows."""
    heading = np.full(n, np.nan)
    for row in rows:
        step = np.asarray(row.line.b) - np.asarray(row.line.a)
        heading[row.start : row.stop] = np.arctan2(step[1], step[0])
    return heading


def sd_across(covariance: Floats, heading: Floats) -> tuple[Floats, Floats]:
    """(N,) standard deviations in m of a position along `heading` (rad, (N,)) and across it."""
    c, s = np.cos(heading), np.sin(heading)
    xx, yy, xy = covariance[:, X, X], covariance[:, Y, Y], covariance[:, X, Y]
    along = c * c * xx + s * s * yy + 2.0 * s * c * xy
    across = s * s * xx + c * c * yy - 2.0 * s * c * xy
    return np.sqrt(np.maximum(along, 0.0)), np.sqrt(np.maximum(across, 0.0))


def body_columns(body: BodyMotion, b: str, rows: Sequence[RowLike]) -> dict[str, Floats]:
    """Columns of trajectory.parquet of one body; b is its suffix ("1" or "2")."""
    s, n = path_columns(body.x, body.y, rows)
    sd_s, sd_n = sd_across(body.covariance, heading_column(body.x.size, rows))
    sd_along, sd_lateral = sd_across(body.covariance, body.yaw)
    values = {
        "x": body.x,
        "y": body.y,
        "yaw": body.yaw,
        "s": s,
        "n": n,
        "v": body.v,
        "yaw_rate": body.yaw_rate,
    }
    sds = {"x": body.sd(X), "y": body.sd(Y), "yaw": body.sd(YAW), "s": sd_s, "n": sd_n, "v": body.sd(V),
           "yaw_rate": body.sd(YAW_RATE), "along": sd_along, "lateral": sd_lateral}  # fmt: skip
    named = {f"{name}{b}": value for name, value in values.items()}
    return named | {f"sd_{name}{b}": value for name, value in sds.items()}


def trajectory_table(motion: Motion, rows: Sequence[RowLike], version: str) -> pa.Table:
    """trajectory.parquet of the format page, with its metadata key `smts`."""
    columns: dict[str, NDArray[Any]] = {"t": motion.t, "row": row_column(motion.t.size, rows)}
    for b, body in zip("12", motion.bodies, strict=False):
        columns |= body_columns(body, b, rows)
    columns |= {"steer": motion.steer, "sd_steer": motion.sd_steer}
    origin = {"lat": motion.origin.lat, "lon": motion.origin.lon, "alt": motion.origin.alt}
    lines = [
        {"row": r.index, "a": [float(v) for v in r.line.a], "b": [float(v) for v in r.line.b]} for r in rows
    ]
    return with_metadata(table_of(columns), {"origin": origin, "lines": lines, "version": version})


SIMULATED = ("x", "y", "yaw", "v", "yaw_rate")


def simulation_table(
    motion: Motion, rows: Sequence[RowLike], simulated: Mapping[str, Floats], version: str
) -> pa.Table:
    """simulation.parquet: the model on the trajectory's grid, without standard deviations, with `window`."""
    n = motion.t.size
    nan = np.full(n, np.nan)
    columns: dict[str, NDArray[Any]] = {"t": motion.t, "row": row_column(n, rows)}
    for b, _ in zip("12", motion.bodies, strict=False):
        body = {f"{name}{b}": simulated.get(f"{name}{b}", nan) for name in SIMULATED}
        s, across = path_columns(body[f"x{b}"], body[f"y{b}"], rows)
        columns |= body | {f"s{b}": s, f"n{b}": across}
    columns |= {"steer": simulated.get("steer", nan), "window": simulated.get("window", nan)}
    return with_metadata(table_of(columns), {"version": version})


def table_of(columns: Mapping[str, NDArray[Any]]) -> pa.Table:
    """The columns (numbers) as a table that shares their memory; pyarrow's own way there imports pandas."""
    return pa.table({name: _arrow(np.ascontiguousarray(values)) for name, values in columns.items()})


def _arrow(values: NDArray[Any]) -> pa.Array:
    kind = pa.from_numpy_dtype(values.dtype)
    return pa.Array.from_buffers(kind, values.size, [None, pa.py_buffer(values)])


def values_of(column: pa.ChunkedArray) -> NDArray[Any]:
    """Numbers of a column without nulls; the way back of `table_of`."""
    return np.asarray(np.from_dlpack(column.combine_chunks()))


def with_metadata(table: pa.Table, metadata: Mapping[str, Any]) -> pa.Table:
    """The table with `metadata` as JSON under the file's metadata key `smts`."""
    packed = json.dumps(metadata, sort_keys=True, allow_nan=False).encode()
    return table.replace_schema_metadata({METADATA_KEY: packed})


def plots_table(plots: Mapping[str, Mapping[str, PlotSeries]]) -> pa.Table:
    """The curves in one long table: plot, series, x, y, low, high (NaN: no band)."""
    flat = [(plot, name, series) for plot, group in plots.items() for name, series in group.items()]
    sizes = [series.x.size for _, _, series in flat]

    def joined(parts: list[Floats]) -> Floats:
        return np.concatenate(parts).astype(np.float64) if parts else np.empty(0)

    def band(values: Floats | None, size: int) -> Floats:
        return np.full(size, np.nan) if values is None else values

    words = {
        "plot": _repeated([p for p, _, _ in flat], sizes),
        "series": _repeated([s for _, s, _ in flat], sizes),
    }
    numbers = {
        "x": joined([series.x for _, _, series in flat]),
        "y": joined([series.y for _, _, series in flat]),
        "low": joined([band(s.low, n) for (_, _, s), n in zip(flat, sizes, strict=True)]),
        "high": joined([band(s.high, n) for (_, _, s), n in zip(flat, sizes, strict=True)]),
    }
    return pa.table({**words, **{name: _arrow(values) for name, values in numbers.items()}})


def _repeated(names: Sequence[str], counts: Sequence[int]) -> pa.Array:
    """Each name so many times, as a column of text."""
    encoded = [name.encode() for name in names]
    ends = np.cumsum(np.repeat([len(name) for name in encoded], counts), dtype=np.int32)
    offsets = np.concatenate([np.zeros(1, np.int32), ends.astype(np.int32)])
    text = b"".join(name * count for name, count in zip(encoded, counts, strict=True))
    return pa.StringArray.from_buffers(ends.size, pa.py_buffer(offsets), pa.py_buffer(text))


def plots_of_table(table: pa.Table) -> dict[str, dict[str, PlotSeries]]:
    """The curves back from `plots_table`, in their order."""
    plot, series = table["plot"].to_pylist(), table["series"].to_pylist()
    columns = {name: values_of(table[name]).astype(np.float64) for name in ("x", "y", "low", "high")}
    edges = [i for i in range(len(plot)) if i == 0 or (plot[i], series[i]) != (plot[i - 1], series[i - 1])]
    found: dict[str, dict[str, PlotSeries]] = {}
    for start, stop in pairwise([*edges, len(plot)]):
        part = {name: values[start:stop] for name, values in columns.items()}
        banded = bool(np.isfinite(part["low"]).any())
        curve = PlotSeries(
            part["x"], part["y"], part["low"] if banded else None, part["high"] if banded else None
        )
        found.setdefault(plot[start], {})[series[start]] = curve
    return found


def innovation_plots(motion: Motion) -> dict[str, dict[str, PlotSeries]]:
    """Normalised innovations over time by channel (`innovations`), and those that the filter refused."""
    used, refused = {}, {}
    for channel, columns in motion.innovations.items():
        kept = columns["used"] > 0.5
        used[channel] = PlotSeries(columns["t"][kept], columns["value"][kept])
        if not kept.all():
            refused[channel] = PlotSeries(columns["t"][~kept], columns["value"][~kept])
    return {"innovations": used, "innovations refused": refused} if motion.innovations else {}


def read_plots(path: Path) -> dict[str, dict[str, PlotSeries]]:
    """The curves of plots.parquet."""
    return plots_of_table(pq.ParquetFile(path).read())


def write_table(table: pa.Table, path: Path) -> None:
    """One Parquet file, zstd compressed."""
    pq.write_table(table, path, compression="zstd")


def read_columns(path: Path) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
    """Columns of a Parquet file as arrays, and its metadata under `smts`."""
    table = pq.ParquetFile(path).read()
    packed = (table.schema.metadata or {}).get(METADATA_KEY, b"{}")
    return {name: values_of(table[name]) for name in table.column_names}, dict(json.loads(packed))
