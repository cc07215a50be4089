"""ROS 2 messages as columns: CDR payloads of one layout are read and written with numpy, all at once.

A message whose strings and sequences keep their lengths has every number at a fixed offset. `layout_of`
finds those offsets by walking one payload; `Layout.fits` checks, over a whole matrix of payloads, the
encapsulation and every length prefix that the offsets rest on; then a column is a strided view.

    kind = message_type("sensor_msgs/msg/Imu", schema_text)
    for group in decode(kind, payloads):
        group.rows, group.column("linear_acceleration")        # (n,), (n, 3)

    template = make_template(kind, {"header": {"frame_id": "imd1"}})
    encode(template, {**stamp_columns("header.stamp", t_ns), "linear_acceleration": a}, n)  # (n, L) bytes

A leaf's path is dotted, elements of a sequence by number: `transforms.0.transform.translation.x`,
`name.1`. A number sequence is one leaf of shape (k,). Source: OMG CDR (DDS-XTypes 1.3, 7.4), encapsulations
CDR_BE and CDR_LE.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .ros_types import PRIMITIVES, CdrError, Field, MessageType, message_type

__all__ = [
    "CdrError",
    "Group",
    "Layout",
    "MessageType",
    "Payloads",
    "Template",
    "decode",
    "encode",
    "layout_of",
    "make_template",
    "message_type",
    "serialise",
    "stamp_columns",
]

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

ENCAPSULATION = 4  # bytes in front of every payload; alignment counts from behind them
MAX_LEAVES = 100_000  # fields of one message; a path of 10,000 poses still fits
BLOCK = 8192  # messages that are grouped at once: bounds the work where every one has its own layout
MAX_PAD = 3  # writers may round a payload up to a multiple of four bytes


@dataclass(frozen=True)
class Leaf:
    """Where a number, a run of numbers or a string lies. dtype is "S" for a string (without its zero)."""

    offset: int
    dtype: str
    count: int | None


@dataclass(frozen=True)
class Layout:
    """Offsets of every leaf of payloads that share all lengths."""

    kind: MessageType
    length: int
    order: str  # "<" or ">"
    leaves: Mapping[str, Leaf]
    prefix_at: Ints
    prefix: NDArray[np.uint32]

    def fits(self, payloads: Bytes) -> NDArray[np.bool_]:
        """Which rows of an (n, length) matrix have this encapsulation and all these length prefixes."""
        begins = 1 if self.order == "<" else 0
        good: NDArray[np.bool_] = _view(payloads, 0, ">u2", 1)[:, 0] == begins
        for at, value in zip(self.prefix_at, self.prefix, strict=True):
            good &= _view(payloads, int(at), self.order + "u4", 1)[:, 0] == value
        return good

    def leaf(self, path: str) -> Leaf:
        """The leaf at a path, or the run of equal leaves in a row that a message of numbers is.

        Raises CdrError when there is none.
        """
        if path in self.leaves:
            return self.leaves[path]
        inside = [leaf for name, leaf in self.leaves.items() if name.startswith(path + ".")]
        if not inside or not _adjacent(inside):
            raise CdrError(f"{self.kind.name} has no numbers at {path!r}")
        return Leaf(inside[0].offset, inside[0].dtype, len(inside))


@dataclass(frozen=True)
class Group:
    """Payloads of one layout. rows: their places among all payloads; matrix: (n, length) bytes."""

    rows: Ints
    layout: Layout
    matrix: Bytes

    def column(self, path: str) -> NDArray[Any]:
        """Values at a path: (n,) for a number, (n, k) for k of them, (n,) of dtype S for a string."""
        leaf = self.layout.leaf(path)
        if leaf.dtype == "S":
            if not leaf.count:
                return np.full(self.rows.size, b"")
            return _view(self.matrix, leaf.offset, f"S{leaf.count}", 1)[:, 0]
        values = _numbers(self.matrix, self.layout.order, leaf)
        return values[:, 0] if leaf.count is None else values

    def stamp_ns(self, path: str) -> Ints:
        """A builtin_interfaces/Time as nanoseconds since the epoch, (n,)."""
        seconds = self.column(path + ".sec").astype(np.int64)
        return seconds * 1_000_000_000 + self.column(path + ".nanosec").astype(np.int64)


@dataclass(frozen=True)
class Payloads:
    """Serialised messages inside one buffer: message i is data[start[i] : start[i] + length[i]]."""

    data: Bytes
    start: Ints
    length: Ints

    def __len__(self) -> int:
        return int(self.start.size)

    def at(self, row: int) -> bytes:
        """One message's bytes."""
        start = int(self.start[row])
        return self.data[start : start + int(self.length[row])].tobytes()

    def matrix(self, rows: Ints) -> Bytes:
        """(n, length) bytes of rows that share one length; a view where they lie evenly spaced."""
        start, length = self.start[rows], int(self.length[rows[0]])
        step = int(start[1] - start[0]) if rows.size > 1 else length
        if step > 0 and (rows.size < 2 or bool((np.diff(start) == step).all())):
            first = self.data[int(start[0]) :]
            return np.lib.stride_tricks.as_strided(first, (rows.size, length), (step, 1), writeable=False)
        windows = np.lib.stride_tricks.sliding_window_view(self.data, length)
        return np.asarray(windows[start])


def _view(matrix: Bytes, offset: int, dtype: str, count: int) -> NDArray[Any]:
    kind = np.dtype(dtype)
    return matrix[:, offset : offset + kind.itemsize * count].view(kind)


def _numbers(matrix: Bytes, order: str, leaf: Leaf) -> NDArray[Any]:
    """A leaf's numbers as a view, (n, k); k = 1 for a single one."""
    return _view(matrix, leaf.offset, order + leaf.dtype, 1 if leaf.count is None else leaf.count)


def _adjacent(leaves: list[Leaf]) -> bool:
    first = leaves[0]
    size = np.dtype(first.dtype).itemsize if first.dtype != "S" else 0
    return size > 0 and all(
        leaf.count is None and leaf.dtype == first.dtype and leaf.offset == first.offset + i * size
        for i, leaf in enumerate(leaves)
    )


# -- reading ---------------------------------------------------------------------------------------------


@dataclass
class _Walk:
    """Walks one payload and notes offsets; raises CdrError where the bytes run out."""

    kind: MessageType
    data: bytes
    order: str
    at: int = ENCAPSULATION
    leaves: dict[str, Leaf] = field(default_factory=dict)
    prefixes: list[tuple[int, int]] = field(default_factory=list)

    def message(self, name: str, path: str) -> None:
        for each in self.kind.types[name]:
            self.value(each, f"{path}.{each.name}" if path else each.name)

    def value(self, each: Field, path: str) -> None:
        count = self.prefix(path) if each.count == -1 else each.count
        if each.base in PRIMITIVES:
            self.numbers(PRIMITIVES[each.base], count, path)
            return
        for i in range(1 if count is None else count):
            inner = path if count is None else f"{path}.{i}"
            if each.base in ("string", "wstring"):
                self.string(each.base, inner)
            else:
                self.message(each.base, inner)

    def numbers(self, dtype: str, count: int | None, path: str) -> None:
        size = int(dtype[1])
        if count != 0:  # an empty sequence is not aligned
            self.at = _aligned(self.at, size)
        self.note(path, Leaf(self.at, dtype, count))
        self.skip(size * (1 if count is None else count), path)

    def string(self, base: str, path: str) -> None:
        if base == "wstring":
            raise CdrError(f"{self.kind.name}: {path} is a wide string, which is not supported")
        length = self.prefix(path)
        self.note(path, Leaf(self.at, "S", max(length - 1, 0)))
        self.skip(length, path)

    def note(self, path: str, leaf: Leaf) -> None:
        if len(self.leaves) >= MAX_LEAVES:
            raise CdrError(f"{self.kind.name}: a message has more than {MAX_LEAVES} fields")
        self.leaves[path] = leaf

    def prefix(self, path: str) -> int:
        self.at = _aligned(self.at, 4)
        start = self.at
        self.skip(4, path)
        (value,) = struct.unpack_from(self.order + "I", self.data, start)
        self.prefixes.append((start, value))
        if value > len(self.data) - self.at:  # every element takes a byte at least: never loop over a lie
            raise CdrError(
                f"{self.kind.name}: {path} claims {value} elements, {len(self.data) - self.at} bytes are left"
            )
        return int(value)

    def skip(self, size: int, path: str) -> None:
        self.at += size
        if self.at > len(self.data):
            raise CdrError(f"{self.kind.name}: the message ends inside {path} ({len(self.data)} bytes)")


def _aligned(at: int, size: int) -> int:
    return at + (ENCAPSULATION - at) % size


def layout_of(kind: MessageType, payload: bytes) -> Layout:
    """The layout of one payload.

    Raises CdrError when it is not plain CDR of this type: encapsulation, length, prefixes.
    """
    if len(payload) < ENCAPSULATION or payload[0] != 0 or payload[1] not in (0, 1):
        shown = payload[:ENCAPSULATION].hex(" ") or "nothing"
        raise CdrError(f"{kind.name}: the message does not begin as CDR (it begins with {shown})")
    walk = _Walk(kind, payload, "<" if payload[1] else ">")
    walk.message(kind.name, "")
    if len(payload) - walk.at > MAX_PAD:
        raise CdrError(f"{kind.name}: {len(payload) - walk.at} bytes are left over behind the last field")
    at, values = zip(*walk.prefixes, strict=True) if walk.prefixes else ((), ())
    return Layout(
        kind, len(payload), walk.order, walk.leaves, np.array(at, np.int64), np.array(values, np.uint32)
    )


def decode(kind: MessageType, payloads: Payloads, likely: Layout | None = None) -> Iterator[Group]:
    """Payloads in groups of one layout, BLOCK messages at a time.

    A recording whose strings keep their lengths is one group a block, read without a loop; in the worst
    case every message is its own group. likely is a layout to try first: that of the messages before.
    Raises CdrError naming the message that cannot be read.
    """
    for start in range(0, len(payloads), BLOCK):
        for group in _groups(kind, payloads, np.arange(start, min(start + BLOCK, len(payloads))), likely):
            likely = group.layout
            yield group


def _groups(kind: MessageType, payloads: Payloads, left: Ints, likely: Layout | None) -> Iterator[Group]:
    while left.size:
        layout = _layout(kind, payloads, int(left[0]), likely)
        alike = payloads.length[left] == layout.length
        rows = left[alike] if not alike.all() else left
        matrix = payloads.matrix(rows)
        good = layout.fits(matrix)
        if good.all():
            yield Group(rows, layout, matrix)
        else:
            yield Group(rows[good], layout, matrix[good])
        rest = rows[~good]
        left = rest if alike.all() else np.sort(np.concatenate([left[~alike], rest]))


def _layout(kind: MessageType, payloads: Payloads, row: int, likely: Layout | None) -> Layout:
    """The layout of one message: the likely one where it fits."""
    if likely is not None and likely.kind is kind and payloads.length[row] == likely.length:
        only = np.array([row])
        if likely.fits(payloads.matrix(only))[0]:
            return likely
    try:
        return layout_of(kind, payloads.at(row))
    except CdrError as error:
        raise CdrError(f"message {row}: {error}") from None


# -- writing ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Template:
    """One serialised message, and where its numbers lie."""

    data: Bytes
    layout: Layout


def make_template(kind: MessageType, values: Mapping[str, Any] | None = None) -> Template:
    """Serialise a nested mapping of fields (absent ones are zero or empty), little endian.

    Sequences take lists: their lengths fix the layout, `encode` then fills the numbers.
    Raises CdrError for an unknown field, or an array of the wrong length.
    """
    out = bytearray(b"\x00\x01\x00\x00")
    _put_message(kind, kind.name, values or {}, out)
    return Template(np.frombuffer(bytes(out), np.uint8), layout_of(kind, bytes(out)))


def serialise(kind: MessageType, values: Mapping[str, Any]) -> bytes:
    """One message's CDR bytes, for messages whose lengths change from one to the next."""
    out = bytearray(b"\x00\x01\x00\x00")
    _put_message(kind, kind.name, values, out)
    return bytes(out)


def _put_message(kind: MessageType, name: str, values: Mapping[str, Any], out: bytearray) -> None:
    fields = kind.types[name]
    unknown = set(values) - {each.name for each in fields}
    if unknown:
        raise CdrError(f"{name} has no field {sorted(unknown)[0]!r}")
    for each in fields:
        _put(kind, each, values.get(each.name), out)


def _put(kind: MessageType, each: Field, value: Any, out: bytearray) -> None:
    if each.count is None:
        _put_one(kind, each.base, value, out)
        return
    items = list(value) if value is not None else [None] * max(each.count, 0)
    if each.count >= 0 and len(items) != each.count:
        raise CdrError(f"{each.name} takes {each.count} values, not {len(items)}")
    if each.count == -1:
        _put_one(kind, "uint32", len(items), out)
    for item in items:
        _put_one(kind, each.base, item, out)


def _put_one(kind: MessageType, base: str, value: Any, out: bytearray) -> None:
    if base in PRIMITIVES:
        number = np.dtype("<" + PRIMITIVES[base]).type(0 if value is None else value)
        out.extend(bytes(_aligned(len(out), number.itemsize) - len(out)) + number.tobytes())
    elif base == "string":
        text = ("" if value is None else str(value)).encode() + b"\0"
        _put_one(kind, "uint32", len(text), out)
        out.extend(text)
    elif base == "wstring":
        raise CdrError("wide strings are not supported")
    else:
        _put_message(kind, base, {} if value is None else value, out)


def encode(template: Template, columns: Mapping[str, ArrayLike], n: int) -> Bytes:
    """(n, length) payloads: the template with the columns' values, each (n,), (n, k) or a constant."""
    matrix = np.repeat(template.data[np.newaxis, :], n, axis=0)
    fill(matrix, template.layout, columns)
    return matrix


def fill(matrix: Bytes, layout: Layout, columns: Mapping[str, ArrayLike]) -> None:
    """Write columns into payloads that already have the layout, in place."""
    for path, values in columns.items():
        leaf = layout.leaf(path)
        if leaf.dtype == "S":
            raise CdrError(f"{layout.kind.name}: {path} is a string; put it into the template")
        target = _numbers(matrix, layout.order, leaf)
        if leaf.count is None:
            target[:, 0] = values
        else:
            target[...] = values


def stamp_columns(path: str, t_ns: Ints) -> dict[str, Ints]:
    """Columns `sec` and `nanosec` of a builtin_interfaces/Time from ns since the epoch.

    Raises CdrError beyond what its 32-bit seconds can hold (1901 to 2038).
    """
    seconds = t_ns // 1_000_000_000
    if t_ns.size and not (int(seconds.min()) >= -(2**31) and int(seconds.max()) < 2**31):
        raise CdrError(f"{path}: a time lies outside 1901 to 2038, which ROS 2 stamps can hold")
    return {path + ".sec": seconds, path + ".nanosec": t_ns - seconds * 1_000_000_000}
