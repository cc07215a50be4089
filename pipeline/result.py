"""The results folder of one pass: its names, atomic writing, reading back."""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, is_dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sensors import manifest as manifests
from ..sensors.manifest import Manifest
from . import result_tables as tables
from .fusion.motion import Motion
from .report_view import PassView, PlotSeries
from .result_tables import RowLike

Floats = NDArray[np.float64]

MANIFEST = "run.toml"
TRAJECTORY = "trajectory.parquet"
SIMULATION = "simulation.parquet"
COMPARISON = "comparison.parquet"
PLOTS = "plots.parquet"
METRICS = "metrics.json"
LOG = "result.mcap"
HTML = "report.html"
PDF = "report.pdf"
FIGURES = "figures"
TABLES = "tables"
NAMES = (MANIFEST, TRAJECTORY, SIMULATION, COMPARISON, PLOTS, METRICS, LOG, HTML, PDF, FIGURES, TABLES)


class ResultError(ValueError):
    """A results folder that cannot be written or read; one line says where and how to mend it."""


@dataclass(frozen=True)
class PassResult:
    """All that one pass came to.

    rows : the rows found, each with its line and sample slice
    simulated : columns of simulation.parquet on motion.t (`x1 y1 yaw1 v1 yaw_rate1 ... steer window`), NaN
        outside rows; s and n are made here, from the rows' lines
    comparison : columns of comparison.parquet (`findings.comparison_columns`); empty without a compared row
    plots : further curves for the report, by plot and series
    metrics : metrics.json, which begins as the format page says
    """

    manifest: Manifest
    manifest_text: str
    motion: Motion
    rows: tuple[RowLike, ...]
    simulated: Mapping[str, Floats]
    metrics: Mapping[str, Any]
    comparison: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    plots: Mapping[str, Mapping[str, PlotSeries]] = field(default_factory=dict)


def package_version() -> str:
    """Version of this package as installed."""
    try:
        return version("smts-validate")
    except PackageNotFoundError:
        return "unknown"


def plain(value: Any) -> Any:
    """The same value in JSON's terms: arrays as lists, dataclasses as objects, numbers not finite as None."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def dump_json(value: Any) -> str:
    """Readable JSON without NaN, the same text for the same value."""
    return json.dumps(plain(value), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_result(out: Path, result: PassResult, finish: Callable[[Path], None] | None = None) -> Path:
    """Write a pass's results folder, whole or not at all; a result already there is then replaced.

    Parameters
    ----------
    out : the folder, made with its parents
    result : what the pass came to
    finish : called with the temporary folder before it is renamed; makes the reports and the log

    Returns the folder. Raises ResultError when `out` holds anything that a result does not leave.
    """
    with replaced_folder(Path(os.path.abspath(out))) as folder:
        write_tables(folder, result)
        if finish is not None:
            finish(folder)
    return Path(out)


def write_tables(folder: Path, result: PassResult) -> None:
    """The part of a result from which all else can be made again."""
    ours = package_version()
    (folder / MANIFEST).write_text(result.manifest_text, encoding="utf-8")
    tables.write_table(tables.trajectory_table(result.motion, result.rows, ours), folder / TRAJECTORY)
    simulation = tables.simulation_table(result.motion, result.rows, result.simulated, ours)
    tables.write_table(simulation, folder / SIMULATION)
    tables.write_table(tables.table_of(result.comparison), folder / COMPARISON)
    plots = {**result.plots, **tables.innovation_plots(result.motion)}
    tables.write_table(tables.plots_table(plots), folder / PLOTS)
    (folder / METRICS).write_text(dump_json(result.metrics), encoding="utf-8")


def read_result(out: Path) -> PassView:
    """A pass's result back from its folder.

    Raises ResultError, one line: which file is absent or cannot be read.
    """
    out = Path(out)
    for name in (MANIFEST, TRAJECTORY, SIMULATION, METRICS):
        if not (out / name).is_file():
            raise ResultError(f"{out}: has no {name}; give a folder that `smts-validate run` has left")
    try:
        return _view(out)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ResultError(f"{out}: cannot be read: {error}; run the pass again") from error


def _view(out: Path) -> PassView:
    text = (out / MANIFEST).read_text(encoding="utf-8")
    trajectory, metadata = tables.read_columns(out / TRAJECTORY)
    simulation, _ = tables.read_columns(out / SIMULATION)
    metrics = json.loads((out / METRICS).read_text(encoding="utf-8"))
    manifest = manifests.parse(text, str(out / MANIFEST))
    return PassView(
        manifest=manifest.dated(metrics.get("provenance", {}).get("date")),
        manifest_text=text,
        metrics=metrics,
        trajectory=trajectory,
        simulation=simulation,
        comparison=tables.read_columns(out / COMPARISON)[0] if (out / COMPARISON).is_file() else {},
        plots=tables.read_plots(out / PLOTS) if (out / PLOTS).is_file() else {},
        lines=tuple(metadata["lines"]),
        origin=metadata["origin"],
    )


@contextmanager
def replaced_folder(out: Path, names: tuple[str, ...] = NAMES) -> Iterator[Path]:
    """A temporary folder beside `out` that takes its place when the block ends well, and vanishes when not.

    Raises ResultError when `out` is not a folder, or holds something other than `names`.
    """
    _refuse_foreign(out, names)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))
    except OSError as error:
        raise ResultError(f"{out}: cannot be written: {error.strerror}; choose another OUT") from None
    try:
        folder.chmod(0o755)
        yield folder
        _swap(folder, out)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _refuse_foreign(out: Path, names: tuple[str, ...]) -> None:
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise ResultError(f"{out}: is there and is not a folder; choose another OUT")
    foreign = sorted(p.name for p in out.iterdir() if p.name not in names) if out.exists() else []
    if foreign:
        raise ResultError(
            f"{out}: holds {foreign[0]}, which no result leaves; choose another OUT or move that file"
        )


def _swap(folder: Path, out: Path) -> None:
    """Put `folder` in the place of `out`. An old result stays until the new one is whole."""
    if not out.exists():
        os.replace(folder, out)
        return
    old = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".old", dir=out.parent))
    os.replace(out, old)
    try:
        os.replace(folder, out)
    except OSError:
        with suppress(OSError):
            os.replace(old, out)
        raise
    shutil.rmtree(old, ignore_errors=True)
