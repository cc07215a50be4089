"""Which passes lie under the given paths: raw folders and logs, on disk or behind any fsspec URL."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MANIFEST = "run.toml"
CAMPAIGN = "campaign.toml"
LOG_SUFFIX = ".mcap"
BAG_INDEX = "metadata.yaml"
RESULT_MARK = "metrics.json"  # a folder that holds it is a result, not a pass


class FindError(ValueError):
    """A path under which no pass can be found; one line."""


@dataclass(frozen=True)
class Source:
    """One pass. path: its raw folder or its log; manifest: a run.toml beside a log that carries none."""

    path: str
    manifest: str | None = None


@dataclass(frozen=True)
class Found:
    """What lies under the paths: passes in the order of their paths, and the campaign file if any."""

    sources: tuple[Source, ...]
    campaign: str | None


def is_url(path: str) -> bool:
    """Whether a path is a URL for fsspec (`s3://bucket/x`, `memory://x`)."""
    return "://" in path


def filesystem(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path within it. Raises FindError without the extra."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise FindError(f"{url}: URLs need the extra: pip install 'smts-validate[cluster]'") from None
    try:
        system, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise FindError(f"{url}: {error}") from None
    return system, str(path)


def find(paths: Iterable[str], out: str) -> Found:
    """Every pass under the paths, each once. Folders of results, and `out` itself, are passed over.

    Raises FindError for a path that is not there, or that holds no pass, or for two campaign files.
    """
    sources: dict[str, Source] = {}
    campaigns: list[str] = []
    for path in paths:
        before = len(sources)
        for item in _under(path, out):
            if isinstance(item, str):
                campaigns += [item] if item not in campaigns else []
            else:
                sources.setdefault(item.path, item)
        if len(sources) == before and not any(path == source for source in sources):
            raise FindError(
                f"{path}: no pass under it; a pass is a folder with {MANIFEST}, or a {LOG_SUFFIX} log"
            )
    if len(campaigns) > 1:
        raise FindError(
            f"{campaigns[1]}: a second {CAMPAIGN} beside {campaigns[0]}; name one with --campaign"
        )
    return Found(tuple(sources[key] for key in sorted(sources)), campaigns[0] if campaigns else None)


def _under(path: str, out: str) -> Iterator[Source | str]:
    """Passes (Source) and campaign files (str) under one path."""
    if is_url(path):
        system, root = filesystem(path)
        if not system.exists(root):
            raise FindError(f"{path}: there is no such file or folder")
        if system.isfile(root):
            yield Source(path)
            return
        walk, prefix = system.walk(root), path.split("://")[0] + "://"
    else:
        if not os.path.exists(path):
            raise FindError(f"{path}: there is no such file or folder")
        if os.path.isfile(path):
            yield Source(path)
            return
        walk, prefix = os.walk(path), ""
    for folder, folders, files in walk:
        yield from _in_folder(prefix + folder.removeprefix(prefix), folders, sorted(files), out)


def _in_folder(folder: str, folders: Any, files: list[str], out: str) -> Iterator[Source | str]:
    """What one folder holds; empties `folders` (as os.walk allows) where the walk shall go no deeper."""
    if RESULT_MARK in files or same_place(folder, out):
        _clear(folders)
        return
    if CAMPAIGN in files:
        yield join(folder, CAMPAIGN)
    if MANIFEST in files or BAG_INDEX in files:
        _clear(folders)
        yield _pass_in(folder, files)
        return
    for name in files:
        if name.endswith(LOG_SUFFIX) and not name.startswith("."):
            yield Source(join(folder, name))
    _drop_hidden(folders)


def _pass_in(folder: str, files: list[str]) -> Source:
    """A raw folder; or the recording of a folder whose run.toml names topics instead of files."""
    if MANIFEST not in files:
        return Source(folder)
    if not names_topics(read_text(join(folder, MANIFEST))):
        return Source(folder)
    logs = [name for name in files if name.endswith(LOG_SUFFIX)]
    log = folder if BAG_INDEX in files or len(logs) != 1 else join(folder, logs[0])
    return Source(log, join(folder, MANIFEST))


def names_topics(manifest: str) -> bool:
    """Whether a manifest's sensors name topics of a recording; no for a broken one (its reader says why)."""
    try:
        sensors = tomllib.loads(manifest).get("sensors", {})
    except tomllib.TOMLDecodeError:
        return False
    tables = sensors.values() if isinstance(sensors, dict) else ()
    return any(isinstance(sensor, dict) and "topic" in sensor for sensor in tables)


def _clear(folders: Any) -> None:
    folders.clear()  # a list from os.walk, a dict of details from fsspec's walk


def _drop_hidden(folders: Any) -> None:
    for name in [name for name in folders if name.startswith(".")]:
        if isinstance(folders, dict):
            del folders[name]
        else:
            folders.remove(name)
    if isinstance(folders, list):
        folders.sort()


def join(folder: str, name: str) -> str:
    """A name inside a folder, on disk or behind a URL."""
    return f"{folder.rstrip('/')}/{name}"


def same_place(folder: str, out: str) -> bool:
    """Whether two paths mean the same folder."""
    if is_url(folder) or is_url(out):
        return folder.rstrip("/") == out.rstrip("/")
    return os.path.realpath(folder) == os.path.realpath(out)


def read_bytes(path: str) -> bytes:
    """A small file's bytes, from disk or behind a URL."""
    if not is_url(path):
        return Path(path).read_bytes()
    system, inner = filesystem(path)
    return bytes(system.cat_file(inner))


def read_text(path: str) -> str:
    """A small file as text; bytes that are not UTF-8 are replaced (its reader will complain of them)."""
    return read_bytes(path).decode("utf-8-sig", errors="replace")
