"""A manifest's mistakes told in one line: where in the file, what, and the key that was perhaps meant."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import BaseModel, ValidationError

Tables = Mapping[str, type[BaseModel]]  # by dotted place; "*" stands for a sensor's name


def one_line(text: str) -> str:
    """Without line breaks or control characters, and not endless."""
    plain = "".join(c if c.isprintable() else " " for c in text)
    return plain if len(plain) <= 400 else plain[:397] + "..."


def told(error: ValidationError, text: str, tables: Tables) -> str:
    """The mistake most worth naming: a misspelt key makes others seem missing, so it goes first."""
    found = error.errors(include_url=False)
    order = {"extra_forbidden": 0, "missing": 2}
    first = min(found, key=lambda one: order.get(one["type"], 1))
    place = _place(first["loc"])
    line = line_of(text, place[:-1] if first["type"] == "missing" else place)  # of the table that lacks it
    more = f" ({len(found) - 1} more)" if len(found) > 1 and first["type"] != "extra_forbidden" else ""
    at = f", line {line}" if line else ""
    return f"{at}: {'.'.join(place)}{': ' if place else ''}{_complaint(dict(first), place, tables)}{more}"


def _place(loc: Sequence[int | str]) -> list[str]:
    """Keys that lead to a mistake, without the tag that tells the kinds of sensor apart."""
    parts = [str(part) for part in loc]
    if len(parts) > 2 and parts[0] == "sensors":
        del parts[2]
    return parts


def _complaint(mistake: Mapping[str, Any], place: Sequence[str], tables: Tables) -> str:
    if mistake["type"] == "extra_forbidden":
        return "unknown key" + _nearest(place[-1], mistake["loc"], tables)
    if mistake["type"] == "missing":
        return "this key is missing"
    if mistake["type"].startswith("union_tag"):
        return 'needs kind = "imd", "wds", "steer", "speed" or "gps"'
    value = mistake.get("input")
    shown = f" (it is {value!r})" if isinstance(value, int | float | str) else ""
    return str(mistake["msg"]).removeprefix("Value error, ") + shown


def _nearest(key: str, loc: Sequence[int | str], tables: Tables) -> str:
    """The nearest known key: of the same table, or of another, with its place."""
    same, elsewhere = _keys_at(loc, tables), dict(_known_keys(tables))
    for known, place in ((same, ""), (list(elsewhere), "of")):
        near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
        if near:
            where = f" of [{elsewhere[near[0]]}]" if place else ""
            return f"; did you mean `{near[0]}`{where}?"
    return f"; known here: {', '.join(same)}" if same else ""


def _keys_at(loc: Sequence[int | str], tables: Tables) -> list[str]:
    """Known keys of the table that holds the last key of `loc`."""
    path = [str(part) for part in loc[:-1]]
    if path[:1] == ["sensors"] and len(path) > 1:
        path[1] = "*"
        path[2:3] = ["*"] if len(path) > 3 else path[2:3]
    table = tables.get(".".join(path))
    return [info.alias or name for name, info in table.model_fields.items()] if table else []


def _known_keys(tables: Tables) -> Iterator[tuple[str, str]]:
    """Every known key and its table."""
    for place, table in tables.items():
        for name, info in table.model_fields.items():
            shown = place.replace(".*.units", ".units").replace(".*", "").split(".")
            yield info.alias or name, ".".join(shown)


def line_of(text: str, place: Sequence[str]) -> int | None:
    """Line of the text where the last key of `place` stands, or its table begins; None if not found."""
    table: list[str] = []
    found = None
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*\[\s*([^\[\]]+?)\s*\]", line)
        key = re.match(r"""\s*["']?([^"'=\s]+)["']?\s*=""", line)
        if header:
            table = [part.strip(" \"'") for part in header.group(1).split(".")]
            found = number if table == list(place) else found
        elif key and [*table, *key.group(1).split(".")] == list(
            place[: len(table) + key.group(1).count(".") + 1]
        ):
            found = number if len(place) > len(table) else found
    return found
