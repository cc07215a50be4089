"""What a `ros2msg` schema text says: the fields of a message and of everything inside it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from .ros_messages import short_name

MAX_DEPTH = 32  # nesting of types; deeper is a definition that contains itself

PRIMITIVES: dict[str, str] = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2",
    "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8", "float32": "f4", "float64": "f8",
}  # fmt: skip
TIME_ALIASES = {"time": "builtin_interfaces/Time", "duration": "builtin_interfaces/Duration"}


class CdrError(ValueError):
    """A definition or a payload that cannot be read; one line: what and where."""


@dataclass(frozen=True)
class Field:
    """One field of a message. count: None for a single value, -1 for a sequence, n for an array of n."""

    name: str
    base: str
    count: int | None


@dataclass(frozen=True)
class MessageType:
    """A message's name and the fields of it and of every type that it contains."""

    name: str
    types: Mapping[str, tuple[Field, ...]]

    @property
    def fields(self) -> tuple[Field, ...]:
        return self.types[self.name]


@lru_cache(maxsize=256)
def message_type(name: str, text: str) -> MessageType:
    """The type that a `ros2msg` schema text defines.

    Raises CdrError for a text that is not a plain message (a service's `---`), misses a type, or recurses.
    """
    top = short_name(name)
    if re.search(r"^---\s*$", text, flags=re.MULTILINE):
        raise CdrError(f"{name}: is a service or action definition, not a message")
    bodies = {top: ""}
    for i, part in enumerate(re.split(r"^={3,}[ \t]*\r?$", text, flags=re.MULTILINE)):
        head, _, rest = part.lstrip().partition("\n")
        if i > 0 and head.startswith("MSG:"):
            bodies[short_name(head[len("MSG:") :].strip())] = rest
        elif i == 0:
            bodies[top] = part
    bodies.setdefault("builtin_interfaces/Time", "int32 sec\nuint32 nanosec")
    bodies.setdefault("builtin_interfaces/Duration", "int32 sec\nuint32 nanosec")
    types = {each: _fields(each, body, bodies) for each, body in bodies.items()}
    _check_depth(top, types, (), set())
    return MessageType(top, types)


def _fields(owner: str, body: str, known: Mapping[str, str]) -> tuple[Field, ...]:
    found = [_field(owner, line.split("#", 1)[0].strip(), known) for line in body.splitlines()]
    fields = tuple(each for each in found if each is not None)
    # rosidl gives a message without fields one byte, so that it has a size
    return fields or (Field("structure_needs_at_least_one_member", "uint8", None),)


_FIELD = re.compile(r"^([A-Za-z]\w*(?:/\w+)*)(<=\d+)?(?:\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)\s*(.*)$")


def _field(owner: str, line: str, known: Mapping[str, str]) -> Field | None:
    if not line:
        return None
    match = _FIELD.match(line)
    if match is None:
        raise CdrError(f"{owner}: cannot read the definition's line {line[:60]!r}")
    base, _, bounded, size, name, rest = match.groups()
    if rest.startswith("="):  # a constant takes no space
        return None
    count = None if size is None else int(size) if size and not bounded else -1
    if count == 0:  # not valid in ROS, and a type without bytes would let a message claim anything
        raise CdrError(f"{owner}: {name} is an array of no elements")
    return Field(name, _resolve(owner, base, known), count)


def _resolve(owner: str, base: str, known: Mapping[str, str]) -> str:
    if base in PRIMITIVES or base in ("string", "wstring"):
        return base
    if base in TIME_ALIASES:
        return TIME_ALIASES[base]
    for candidate in (short_name(base), f"{owner.split('/')[0]}/{base}", f"std_msgs/{base}"):
        if candidate in known:
            return candidate
    raise CdrError(f"{owner}: the definition of {base!r} is missing from the schema")


def _check_depth(
    name: str, types: Mapping[str, tuple[Field, ...]], above: tuple[str, ...], done: set[str]
) -> None:
    if name in above or len(above) > MAX_DEPTH:
        raise CdrError(f"{name}: the definition contains itself")
    for inner in {each.base for each in types[name] if each.base in types} - done:
        _check_depth(inner, types, (*above, name), done)
    done.add(name)
