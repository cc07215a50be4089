"""A pass from where it lies: a raw folder or a log; and what `ingest` and `inspect` say of it."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..model.machine import Machine, MachineError
from ..sensors.draft import draft_manifest
from ..sensors.ingest import read_pass
from ..sensors.log import read_log, write_log
from ..sensors.manifest_errors import line_of
from ..sensors.streams import FieldLog


class SourceError(ValueError):
    """A path that holds neither a raw pass nor a log, or one of a machine that cannot be."""


def read_source(source: Path, manifest: Path | None = None) -> FieldLog:
    """The streams of a raw pass's folder (it has a run.toml) or of a log (an MCAP file, a rosbag2 folder)."""
    if not source.exists():
        raise SourceError(f"{source}: there is no such file or folder; give a log or a raw pass's folder")
    if source.is_dir() and manifest is None and not _recording(source):
        return read_pass(with_manifest(source))
    return read_log(source, manifest)


def machine_of(log: FieldLog) -> Machine:
    """The pass's machine, at the pass's tyre pressure.

    Raises SourceError, with the manifest's place and key, for a geometry that leaves a wheel without load.
    """
    manifest = log.manifest
    try:
        return Machine.from_mapping(manifest.machine.model_dump(), manifest.operating.tyre_pressure_mpa)
    except MachineError as error:
        key = f"machine.{str(error).split()[0]}"
        line = line_of(log.manifest_text, key.split("."))
        inside = Path(log.source) / "run.toml"
        where = str(inside) if inside.is_file() else f"{log.source}, its run.toml"
        raise SourceError(f"{where}{f', line {line}' if line else ''}: machine.{error}") from None


def _recording(folder: Path) -> bool:
    """Whether a folder without run.toml is a recording (rosbag2): it has its metadata, or an MCAP file."""
    if (folder / "run.toml").is_file():
        return False
    return (folder / "metadata.yaml").is_file() or any(folder.glob("*.mcap"))


def with_manifest(folder: Path) -> Path:
    """The folder itself. Raises SourceError where it has no run.toml: that it is missing, and what drafts one."""
    if not (folder / "run.toml").exists():
        draft = f"`smts-validate init {folder}` drafts one from the raw files in it"
        raise SourceError(f"{folder}: has no run.toml, which says what the raw files are; {draft}")
    return folder


def draft_pass(folder: Path, force: bool = False) -> dict[str, Any]:
    """Write a first run.toml into a folder of raw files; its path and the reasons for what it says.

    Raises SourceError : no such folder; or there is one already, and `force` is not given.
    """
    if not folder.is_dir():
        raise SourceError(f"{folder}: is not a folder; give the one that holds the raw files")
    path = folder / "run.toml"
    if path.exists() and not force:
        raise SourceError(f"{path}: is there already; --force writes over it")
    text, reasons = draft_manifest(folder)
    path.write_text(text, encoding="utf-8")
    return {"manifest": str(path), "reasons": reasons}


def ingest_pass(folder: Path, logs: Path) -> dict[str, Any]:
    """Turn one raw pass into `logs/<run.id>.mcap`; what was found on the way, as plain values."""
    if not folder.is_dir():
        raise SourceError(f"{folder}: is not a folder; a raw pass is a folder with a run.toml")
    log = read_pass(with_manifest(folder))
    machine_of(log)  # before a log is made that no run would take
    path = logs / f"{log.manifest.run.id}.mcap"
    logs.mkdir(parents=True, exist_ok=True)
    write_log(path, log)
    return {"log": str(path), **describe_log(log)}


def inspect_log(source: Path, manifest: Path | None = None) -> dict[str, Any]:
    """What is in a log (or a raw pass): health by sensor, and what was wrong."""
    return {"log": str(source), **describe_log(read_source(source, manifest))}


def describe_log(log: FieldLog) -> dict[str, Any]:
    """A log's run table, health and warnings as plain values."""
    return {
        "run": log.manifest.run.model_dump(mode="json"),
        "sha256": log.sha256,
        "health": dict(log.health),
        "warnings": [asdict(warning) for warning in log.warnings],
    }
