"""From the passes found to tasks: each pass by its run id, and none under another's."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from .batch_find import LOG_SUFFIX, MANIFEST, Source, is_url, join, read_text
from .batch_limits import Limits
from .batch_task import Outcome, Task

if TYPE_CHECKING:
    from .run_settings import RunSettings

RUN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")  # it becomes a folder's name


@dataclass(frozen=True)
class Named:
    """A source with its run id and the text of its manifest (empty where only its reader can tell)."""

    run: str
    source: Source
    manifest: str = ""


@dataclass(frozen=True)
class Plan:
    """Tasks in the order of their runs; refused: passes that cannot be run under the id they claim."""

    tasks: tuple[Task, ...]
    refused: tuple[Outcome, ...]


@dataclass(frozen=True)
class Terms:
    """What all passes of a batch have in common."""

    out: str
    work: str
    settings: RunSettings
    resume: bool = True
    limits: Limits = Limits()


def plan(sources: Iterable[Source], terms: Terms) -> Plan:
    """One task for each pass. A raw pass whose log is there too is run once, from the log.

    Passes that share an id but not the manifest are all refused: which result would be whose?
    """
    by_run: dict[str, list[Named]] = {}
    for source in sources:
        named = name(source)
        by_run.setdefault(named.run, []).append(named)
    tasks: list[Task] = []
    refused: list[Outcome] = []
    for run in sorted(by_run):
        group = _without_ingested(by_run[run])
        if len(group) == 1:
            tasks.append(
                Task(run, group[0].source, terms.out, terms.work, terms.settings, terms.resume, terms.limits)
            )
        else:
            refused += [_refuse(one, group) for one in group]
    return Plan(tuple(tasks), tuple(refused))


def _without_ingested(group: list[Named]) -> list[Named]:
    """Drop raw passes that were ingested into a log of the same group."""
    logs = {one.manifest for one in group if one.source.path.endswith(LOG_SUFFIX) and one.manifest}
    return [one for one in group if one.source.path.endswith(LOG_SUFFIX) or one.manifest not in logs]


def _refuse(one: Named, group: list[Named]) -> Outcome:
    other = next(b.source.path for b in group if b is not one)
    reason = (
        f"{one.source.path}: its run id {one.run} is also that of {other}; give each pass an id of its own"
    )
    return Outcome(one.run, one.source.path, "failed", reason)


def name(source: Source) -> Named:
    """A pass's run id from its manifest; its file's name where that has no valid one (the task says why)."""
    fallback = PurePosixPath(source.path.split("://")[-1].rstrip("/")).name.removesuffix(LOG_SUFFIX)
    manifest = _manifest_text(source)
    try:
        run = tomllib.loads(manifest)["run"]["id"]
    except (tomllib.TOMLDecodeError, KeyError, TypeError):
        return Named(fallback, source)
    valid = isinstance(run, str) and RUN_ID.fullmatch(run) and ".." not in run
    return Named(run, source, manifest) if valid else Named(fallback, source)


def _manifest_text(source: Source) -> str:
    if source.manifest:
        return read_text(source.manifest)
    if is_url(source.path):
        return "" if source.path.endswith(LOG_SUFFIX) else read_text(join(source.path, MANIFEST))
    if Path(source.path).is_dir():
        path = Path(source.path) / MANIFEST
        return read_text(str(path)) if path.is_file() else ""
    return _carried(Path(source.path))


def _carried(log: Path) -> str:
    """The run.toml that rides along in a log."""
    from ..sensors.mcap_records import McapError
    from ..sensors.mcap_scan import open_recording

    try:
        attachments = open_recording(log).attachments
    except (McapError, OSError):
        return ""
    return next((bytes(a.data).decode("utf-8-sig", "replace") for a in attachments if a.name == MANIFEST), "")
