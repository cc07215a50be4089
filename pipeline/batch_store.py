"""OUT of a batch: whole results only, on disk (by renaming) or behind a URL (metrics.json comes last).

On disk a result is written into OUT/.work/<batch> and renamed into OUT/passes/<run> when it is whole. An
object store cannot rename: there the files are uploaded first and metrics.json, which makes a result of them,
last; it is also the first to go when a result is replaced.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from .batch_find import RESULT_MARK, filesystem, is_url

PASSES = "passes"
WORK = ".work"
LOCK = ".lock"
SUMMED_UP = (RESULT_MARK, "run.toml", "comparison.parquet")  # what a campaign needs of a result


class Store(Protocol):
    """Where a batch keeps its results."""

    @property
    def out(self) -> str:
        """OUT as it was given."""
        ...

    def fingerprint(self, run: str) -> str | None:
        """Fingerprint of the stored result of a run; None where there is no whole one."""
        ...

    def metrics(self, run: str) -> dict[str, Any]:
        """metrics.json of a stored result."""
        ...

    def writing(self, run: str) -> Any:
        """Context: a local path to write a result to; it becomes the stored one when the block ends well."""
        ...

    def local(self, runs: list[str]) -> Any:
        """Context: a local folder laid out as OUT, with what a campaign needs of `runs`; files at its top
        are kept."""
        ...


def open_store(out: str, work: str) -> Store:
    """The store of an OUT: a folder or a URL. work: name of this batch's folder for unfinished results."""
    return RemoteStore(out) if is_url(out) else LocalStore(out, work)


def fingerprint_of(metrics: bytes) -> str | None:
    """The fingerprint in a metrics.json; None when it cannot be read."""
    try:
        stored = json.loads(metrics)["provenance"]["fingerprint"]
    except (ValueError, KeyError, TypeError):
        return None
    return stored if isinstance(stored, str) else None


@dataclass(frozen=True)
class LocalStore:
    """OUT on a disk or a network share."""

    out: str
    work: str

    def _result(self, run: str) -> Path:
        return Path(self.out) / PASSES / run

    def fingerprint(self, run: str) -> str | None:
        """Fingerprint of the stored result of a run; None where there is no whole one."""
        try:
            return fingerprint_of((self._result(run) / RESULT_MARK).read_bytes())
        except OSError:
            return None

    def metrics(self, run: str) -> dict[str, Any]:
        """metrics.json of a stored result."""
        return dict(json.loads((self._result(run) / RESULT_MARK).read_bytes()))

    @contextmanager
    def writing(self, run: str) -> Iterator[Path]:
        """A path in the work folder; renamed to OUT/passes/<run> at the end."""
        work = Path(self.out) / WORK / self.work
        work.mkdir(parents=True, exist_ok=True)
        folder = Path(tempfile.mkdtemp(prefix=f"{run}.", dir=work))
        try:
            yield folder / run
            self._commit(folder / run, folder / "old")
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _commit(self, whole: Path, aside: Path) -> None:
        target = self._result(whole.name)
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists():
            os.replace(target, aside)
        try:
            os.replace(whole, target)
        except OSError:
            if aside.exists():
                os.replace(aside, target)
            raise

    @contextmanager
    def local(self, runs: list[str]) -> Iterator[Path]:
        """OUT itself."""
        yield Path(self.out)


@dataclass(frozen=True)
class RemoteStore:
    """OUT behind an fsspec URL."""

    out: str

    def _at(self, *parts: str) -> tuple[Any, str]:
        system, root = filesystem(self.out)
        return system, "/".join((root.rstrip("/"), *parts))

    def fingerprint(self, run: str) -> str | None:
        """Fingerprint of the stored result of a run; None where there is no whole one."""
        system, path = self._at(PASSES, run, RESULT_MARK)
        try:
            return fingerprint_of(bytes(system.cat_file(path)))
        except FileNotFoundError:
            return None

    def metrics(self, run: str) -> dict[str, Any]:
        """metrics.json of a stored result."""
        system, path = self._at(PASSES, run, RESULT_MARK)
        return dict(json.loads(system.cat_file(path)))

    @contextmanager
    def writing(self, run: str) -> Iterator[Path]:
        """A local temporary path; uploaded at the end, metrics.json last."""
        with tempfile.TemporaryDirectory(prefix="smts-") as folder:
            yield Path(folder) / run
            self._replace(Path(folder) / run)

    def _replace(self, whole: Path) -> None:
        system, target = self._at(PASSES, whole.name)
        if system.exists(f"{target}/{RESULT_MARK}"):
            system.rm_file(f"{target}/{RESULT_MARK}")
        if system.exists(target):
            system.rm(target, recursive=True)
        _upload(system, whole, target)

    @contextmanager
    def local(self, runs: list[str]) -> Iterator[Path]:
        """A temporary copy of what a campaign needs; files at its top are uploaded to OUT at the end."""
        with tempfile.TemporaryDirectory(prefix="smts-") as folder:
            for run in runs:
                (Path(folder) / PASSES / run).mkdir(parents=True)
                for name in SUMMED_UP:
                    system, source = self._at(PASSES, run, name)
                    if system.exists(source):
                        system.get_file(source, str(Path(folder) / PASSES / run / name))
            yield Path(folder)
            system, target = self._at()
            for path in sorted(Path(folder).iterdir()):
                if path.name != PASSES:
                    _upload(system, path, f"{target.rstrip('/')}/{path.name}")


def _upload(system: Any, path: Path, target: str) -> None:
    """Upload a file, or a folder's files with metrics.json as the last."""
    if path.is_file():
        system.pipe_file(target, path.read_bytes())
        return
    files = [file for file in sorted(path.rglob("*")) if file.is_file()]
    for file in sorted(files, key=lambda file: file.name == RESULT_MARK):
        system.pipe_file(f"{target}/{file.relative_to(path).as_posix()}", file.read_bytes())


@contextmanager
def work_folder(out: str) -> Iterator[str]:
    """The name of a folder OUT/.work/<name> for this batch's unfinished results, gone at the end.

    A file lock beside it is held for as long as this process lives; what dead batches left is removed first.
    """
    name = uuid.uuid4().hex
    if is_url(out):
        yield name
        return
    top = Path(out) / WORK
    top.mkdir(parents=True, exist_ok=True)
    _sweep(top)
    with (top / f"{name}{LOCK}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        try:
            yield name
        finally:
            _remove(top, name)
            with suppress(OSError):  # another batch is at work beside this one
                top.rmdir()


def _sweep(top: Path) -> None:
    """Remove what batches left whose lock is held by nobody any more."""
    for path in sorted(top.glob(f"*{LOCK}")):
        with suppress(OSError), path.open("a") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove(top, path.name.removesuffix(LOCK))


def _remove(top: Path, name: str) -> None:
    shutil.rmtree(top / name, ignore_errors=True)
    (top / f"{name}{LOCK}").unlink(missing_ok=True)
