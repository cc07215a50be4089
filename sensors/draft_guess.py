"""What one raw file seems to be, and what drafts of every kind of sensor need."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .raw import Floats, Ints
from .tables import find_header, read_text

USUAL_RATES = (
    1.0,
    2.0,
    4.0,
    5.0,
    8.0,
    10.0,
    20.0,
    25.0,
    50.0,
    100.0,
    125.0,
    200.0,
    250.0,
    400.0,
    500.0,
    1000.0,
)


@dataclass(frozen=True)
class Guess:
    """What one file seems to be: its table in run.toml, and the reasons."""

    file: str
    kind: str
    keys: Mapping[str, str]
    reasons: tuple[str, ...]
    moment: float | None = None  # UTC of its start, where it tells
    words: tuple[str, ...] = field(default=())


def time_units(path: Path, column: str, key: str) -> dict[str, str]:
    """The unit in which a column of times is a date of this century; nothing where none makes it one."""
    data = read_text(path)
    header = find_header(data, path.name, [column])
    lines = data[:65536].decode("utf-8", "replace").splitlines()[header.lines : header.lines + 1]
    cells = lines[0].split(header.separator) if lines else []
    at = header.names.index(column) if column in header.names else -1
    try:
        value = abs(float(cells[at].strip('" ').replace(",", ".")))
    except (IndexError, ValueError):
        return {}
    for unit, size in (("s", 1.0), ("ms", 1.0e-3), ("us", 1.0e-6)):
        if 9.0e8 < value * size < 4.2e9:
            return {key: unit}
    return {}


def source_keys(columns: Mapping[str, str], units: Mapping[str, str]) -> dict[str, str]:
    """The keys `columns` and `units`, where they are needed."""
    renamed = {key: name for key, name in columns.items() if key != name}
    keys = {}
    if renamed:
        keys["columns"] = inline(renamed)
    if units:
        keys["units"] = inline(units)
    return keys


def inline(table: Mapping[str, str]) -> str:
    """Texts by key as TOML's inline table."""
    return "{ " + ", ".join(f"{key} = {quoted(value)}" for key, value in table.items()) + " }"


def quoted(text: str) -> str:
    """A text as TOML's basic string, whatever is in it."""
    plain = "".join(c if c.isprintable() else "?" for c in text)
    escaped = plain.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'


def usual_rate(t: Floats | Ints) -> float:
    """Samples a second, rounded to what loggers are set to. t : s, or whole ns."""
    scale = 1.0e-9 if np.issubdtype(t.dtype, np.integer) else 1.0
    step = np.diff(t)
    step = step[step > 0]
    if step.size == 0:
        return 1.0
    rate = float(step.size / (step.sum() * scale))
    usual = min(USUAL_RATES, key=lambda known: abs(known - rate))
    return usual if abs(usual - rate) < 0.1 * usual else max(float(f"{rate:.2g}"), 0.1)


def words_of(path: Path) -> tuple[str, ...]:
    """The words of a file's name, lower case."""
    return tuple(re.findall(r"[a-z]+", path.stem.lower()))
