"""Tables of plain values into frozen dataclasses and back: strict about keys and types, nearest known
key in errors."""

from __future__ import annotations

import difflib
import tomllib
import types
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, replace
from datetime import date
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints


class PlanError(ValueError):
    """A plan that cannot be used; one line: what, where, how to mend."""


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises PlanError that names the file."""
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise PlanError(f"{path}: cannot be read: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise PlanError(f"{path}: not valid TOML: {error}") from None


def with_table(value: Any, table: Mapping[str, Any], where: tuple[str, ...] = ()) -> Any:
    """A dataclass with the keys of `table` replaced, recursively; free tables are merged."""
    hints = get_type_hints(type(value))
    new = {}
    for key, given in table.items():
        if key not in hints:
            raise PlanError(f"{'.'.join((*where, key))}: unknown key{near(key, hints)}")
        new[key] = _converted(getattr(value, key), given, hints[key], (*where, key))
    return replace(value, **new)


def _converted(old: Any, given: Any, kind: Any, where: tuple[str, ...]) -> Any:
    if is_dataclass(old) or isinstance(old, Mapping):
        if not isinstance(given, Mapping):
            raise PlanError(f"{'.'.join(where)}: must be a table")
        return with_table(old, given, where) if is_dataclass(old) else _merged(old, given)
    if not _fits(given, kind):
        raise PlanError(f"{'.'.join(where)}: {given!r} is not {_spoken(kind)}")
    return _frozen(given, kind)


def _fits(given: Any, kind: Any) -> bool:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return given in arguments
    if origin in (types.UnionType, Union):
        return any(_fits(given, one) for one in arguments)
    if origin is tuple:
        return _fits_tuple(given, arguments)
    if kind is float:
        return isinstance(given, int | float) and not isinstance(given, bool) and given == given
    if kind is int:
        return isinstance(given, int) and not isinstance(given, bool)
    return isinstance(given, kind) or (kind is str and isinstance(given, date))


def _fits_tuple(given: Any, arguments: tuple[Any, ...]) -> bool:
    if not isinstance(given, list | tuple):
        return False
    if len(arguments) == 2 and arguments[1] is Ellipsis:
        return all(_fits(item, arguments[0]) for item in given)
    return len(given) == len(arguments) and all(_fits(g, a) for g, a in zip(given, arguments, strict=True))


def _frozen(given: Any, kind: Any) -> Any:
    if isinstance(given, list | tuple):
        return tuple(_frozen(item, None) for item in given)
    if isinstance(given, date):
        return given.isoformat()
    return float(given) if kind is float else given


def _merged(old: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """`old` with the keys of `given`, tables within tables merged; false removes a table."""
    out = dict(old)
    for key, value in given.items():
        if value is False and isinstance(old.get(key), Mapping):
            del out[key]
        elif isinstance(value, Mapping) and isinstance(old.get(key), Mapping):
            out[key] = _merged(old[key], value)
        else:
            out[key] = value
    return out


def _spoken(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(map(repr, get_args(kind)))
    return "of type " + (kind.__name__ if isinstance(kind, type) else str(kind))


def near(key: str, known: Iterable[str]) -> str:
    """ "; did you mean `...`?" of the nearest known key, or nothing."""
    close = difflib.get_close_matches(key, list(known), n=1, cutoff=0.5)
    return f"; did you mean `{close[0]}`?" if close else ""


def as_table(plan: Any) -> dict[str, Any]:
    """A plan as plain TOML values, None left out (for the record beside the truth)."""
    out: dict[str, Any] = {}
    for item in fields(plan):
        value = getattr(plan, item.name)
        if value is not None:
            out[item.name] = as_table(value) if is_dataclass(value) else value
    return out
