"""rosbag2 recordings: a folder whose metadata.yaml lists the files that a recording was split into."""

from __future__ import annotations

import re
from pathlib import Path

from .mcap_records import McapError

METADATA_NAME = "metadata.yaml"
MAX_METADATA = 16 * 2**20  # bytes
_NUMBERS = re.compile(r"(\d+)")


def files_of(path: Path) -> list[Path]:
    """The MCAP files of a log, in order: the file itself, or those of a rosbag2 folder.

    Raises McapError when a folder holds none, or names files outside itself.
    """
    if not path.is_dir():
        return [path]
    metadata = path / METADATA_NAME
    if metadata.is_file():
        return [_inside(path, name) for name in _listed(metadata)]
    files = sorted(path.glob("*.mcap"), key=_natural)
    if not files:
        raise McapError(
            f"{path}: holds neither {METADATA_NAME} nor *.mcap; give an MCAP file or a rosbag2 folder"
        )
    return files


def _natural(path: Path) -> list[str | int]:
    """bag_2 before bag_10: parts are split by number."""
    return [int(part) if part.isdigit() else part for part in _NUMBERS.split(path.name)]


def _inside(folder: Path, name: str) -> Path:
    path = folder / name
    if not path.resolve().is_relative_to(folder.resolve()):
        raise McapError(f"{folder / METADATA_NAME}: lists {name!r}, which lies outside its folder; refused")
    return path


def _listed(metadata: Path) -> list[str]:
    """`relative_file_paths` of a metadata.yaml: the one key that is needed, so no YAML reader is.

    rosbag2 writes it as a block list; a storage other than MCAP is refused by name.
    """
    if metadata.stat().st_size > MAX_METADATA:
        raise McapError(f"{metadata}: is larger than {MAX_METADATA} bytes; refused")
    lines = metadata.read_text(encoding="utf-8", errors="replace").splitlines()
    storage = [_scalar(line) for line in lines if line.strip().startswith("storage_identifier:")]
    if storage and storage[0] != "mcap":
        raise McapError(f"{metadata}: storage is {storage[0]!r}; convert it with `ros2 bag convert` to mcap")
    starts = [i for i, line in enumerate(lines) if line.strip() == "relative_file_paths:"]
    names: list[str] = []
    for line in lines[starts[0] + 1 :] if starts else ():
        if not line.strip().startswith("- "):
            break
        names.append(line.strip()[2:].strip().strip("'\""))
    if not names:
        raise McapError(f"{metadata}: lists no files under relative_file_paths; give the MCAP file itself")
    return names


def _scalar(line: str) -> str:
    return line.split(":", 1)[1].strip().strip("'\"")
