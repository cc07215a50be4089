"""One pass of a batch as one task: paths in, a small summary out. Runs in a worker, on any machine."""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from time import monotonic, process_time
from typing import TYPE_CHECKING, Any, Literal

from .batch_find import Source, filesystem, is_url
from .batch_limits import LimitReached, Limits, limited
from .batch_store import Store, open_store
from .batch_warm import compiled_once

if TYPE_CHECKING:
    from .run_settings import RunSettings

Status = Literal["done", "unchanged", "failed"]
BLOCK = 1 << 20


@dataclass(frozen=True)
class Task:
    """What a worker needs to know of one pass. resume: keep a stored result that is still right."""

    run: str
    source: Source
    out: str
    work: str
    settings: RunSettings
    resume: bool = True
    limits: Limits = Limits()


@dataclass(frozen=True)
class Outcome:
    """What became of a pass, kept small. reason: of a failure, one line."""

    run: str
    source: str
    status: Status
    reason: str = ""
    verdict: str = ""
    discrepancy: dict[str, float | None] = field(default_factory=dict)
    seconds: float = 0.0
    cpu_seconds: float = 0.0


def get_ready(computing: bool) -> None:
    """Import what a worker needs for its first task; computing: also what computes a pass, which takes long."""
    from . import run_settings  # noqa: F401

    if computing:
        import pandas  # noqa: F401  by pyarrow at its first array

        from . import report, run  # noqa: F401


def run_task(task: Task) -> Outcome:
    """Run one pass, unless its stored result is that of the same inputs, options and version.

    A failing pass is an Outcome with its reason, not an exception.
    """
    begin, cpu = monotonic(), process_time()
    status, reason, metrics = compiled_once(
        program_digest(), lambda: _attempt(task), good=lambda attempted: attempted[0] == "done"
    )
    return Outcome(
        run=task.run,
        source=task.source.path,
        status=status,
        reason=reason,
        verdict=str(metrics.get("verdict", {}).get("value", "")),
        discrepancy={name: entry.get("combined") for name, entry in metrics.get("discrepancy", {}).items()},
        seconds=monotonic() - begin,
        cpu_seconds=process_time() - cpu,
    )


def _attempt(task: Task) -> tuple[Status, str, dict[str, Any]]:
    reasons: list[str] = []
    if task.limits.any:
        get_ready(computing=True)  # an import that a limit breaks off is lost to the passes after it
    try:
        with limited(task.limits) as reasons, _near(task.source) as source:
            return _unless_unchanged(task, source)
    except LimitReached:
        return "failed", (reasons or ["reached a limit"])[0], {}
    except MemoryError:
        return "failed", "ran out of memory; give its worker more, or run fewer at once (-j)", {}
    except Exception as error:
        return "failed", one_line(error), {}


def _unless_unchanged(task: Task, source: Source) -> tuple[Status, str, dict[str, Any]]:
    store = open_store(task.out, task.work)
    wanted = fingerprint(source, task.settings)
    if task.resume and store.fingerprint(task.run) == wanted:
        return "unchanged", "", store.metrics(task.run)
    return "done", "", _compute(task, source, store, wanted)


def _compute(task: Task, source: Source, store: Store, wanted: str) -> dict[str, Any]:
    from .run import compute

    manifest = Path(source.manifest) if source.manifest else None
    with store.writing(task.run) as out:
        result = compute(Path(source.path), out, manifest, task.settings, fingerprint=wanted)
        if result.manifest.run.id != task.run:
            raise ValueError(
                f"{task.source.path}: became {result.manifest.run.id} while the batch ran; start again"
            )
    return dict(result.metrics)


@contextmanager
def _near(source: Source) -> Iterator[Source]:
    """The source on this machine: itself, or a temporary copy of what a URL holds."""
    if not is_url(source.path):
        yield source
        return
    with tempfile.TemporaryDirectory(prefix="smts-") as folder:
        path = _fetch(source.path, Path(folder))
        yield Source(str(path), str(_fetch(source.manifest, Path(folder) / "m")) if source.manifest else None)


def _fetch(url: str, folder: Path) -> Path:
    system, inner = filesystem(url)
    target = folder / inner.rstrip("/").rsplit("/", 1)[-1]
    folder.mkdir(exist_ok=True)
    if system.isfile(inner):
        system.get_file(inner, str(target))
    else:
        system.get(inner.rstrip("/") + "/", str(target), recursive=True)
    return target


def fingerprint(source: Source, settings: RunSettings) -> str:
    """Digest of all that a result depends on: the pass's files, the options, this program."""
    digest = hashlib.sha256()
    digest.update(program_digest().encode())
    digest.update(json.dumps(asdict(settings), sort_keys=True, default=str).encode())
    for path in _files(source):
        digest.update(f"\n{path.name}\n".encode())
        _add_file(digest, path)
    return digest.hexdigest()


def _files(source: Source) -> list[Path]:
    path = Path(source.path)
    files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    return files + ([Path(source.manifest)] if source.manifest else [])


def _add_file(digest: Any, path: Path) -> None:
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            digest.update(block)


@cache
def program_digest() -> str:
    """Digest of this program's own sources: an edited program computes anew, whatever its version says."""
    from .. import model, sensors

    digest = hashlib.sha256()
    for package in (
        Path(__file__).parent,
        Path(str(model.__file__)).parent,
        Path(str(sensors.__file__)).parent,
    ):
        for path in sorted(package.rglob("*.*")):
            if path.is_file() and path.suffix in {".py", ".html", ".css", ".js", ".jinja", ".j2"}:
                _add_file(digest, path)
    return digest.hexdigest()


def one_line(error: BaseException) -> str:
    """An error's message in one line; its class too where the message alone would not say what happened."""
    message = " ".join(str(error).split())
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'input or output'}: {error.strerror}"
    if isinstance(error, ValueError | RuntimeError) and message:
        return message
    return f"{type(error).__name__}: {message}" if message else type(error).__name__
