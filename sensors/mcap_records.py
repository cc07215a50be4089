"""MCAP at the level of bytes: framing, the records' contents, and nothing that trusts a length.

Every record is `opcode (1 byte), length (8 bytes), content`. `walk` finds them in a buffer and stops, saying
where, at the first that does not fit; nothing is allocated for what a length claims. Source: the MCAP
specification, version 0.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

MAGIC = b"\x89MCAP0\r\n"
FRAME = 9  # bytes of opcode and length in front of a record's content
MESSAGE_HEAD = 22  # bytes of a message's content in front of its payload
LONGEST_LINE = 600  # characters of a message to a person
MAX_RECORDS = 20_000_000  # of one walk: six hours of nine 100 Hz sensors, in 0.3 GB of tables


def one_line(text: str) -> str:
    """Text that may hold names out of a file, fit for one line: control characters escaped, long ones cut."""
    shown = "".join(
        c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[:LONGEST_LINE]
    )
    return shown + "..." if len(text) > LONGEST_LINE else shown


class McapError(ValueError):
    """A file or record that is not MCAP; one line: what, where."""

    def __init__(self, text: str) -> None:
        super().__init__(one_line(text))


class Op(IntEnum):
    """Opcodes of MCAP version 0."""

    HEADER = 0x01
    FOOTER = 0x02
    SCHEMA = 0x03
    CHANNEL = 0x04
    MESSAGE = 0x05
    CHUNK = 0x06
    MESSAGE_INDEX = 0x07
    CHUNK_INDEX = 0x08
    ATTACHMENT = 0x09
    ATTACHMENT_INDEX = 0x0A
    STATISTICS = 0x0B
    METADATA = 0x0C
    METADATA_INDEX = 0x0D
    SUMMARY_OFFSET = 0x0E
    DATA_END = 0x0F


MESSAGE_DTYPE = np.dtype(
    [("channel_id", "<u2"), ("sequence", "<u4"), ("log_time", "<u8"), ("publish_time", "<u8")]
)


@dataclass(frozen=True)
class Table:
    """Records found in a buffer: opcode, where the content starts and how long it is; where the walk ended.

    complete is False when the bytes at `end` are not a whole record.
    """

    opcode: Bytes
    start: Ints
    length: Ints
    end: int
    complete: bool

    def of(self, opcode: Op) -> Ints:
        """Places in the table of one kind of record."""
        return np.flatnonzero(self.opcode == opcode)

    def at(self, rows: Ints) -> Table:
        """The table's rows at these places."""
        return Table(self.opcode[rows], self.start[rows], self.length[rows], self.end, self.complete)


_FRAME = struct.Struct("<BQ")
SAME = 16  # records of one size in a row before a longer run of them is looked for
RUN = 1 << 16  # records of a run that are checked at once


def walk(data: Bytes, start: int, stop: int) -> Table:
    """The records in data[start:stop], up to the first that does not fit.

    Records of one size in a row (one topic's messages) are found by comparing their frames as columns, others
    one by one. Raises McapError when there are more than MAX_RECORDS.
    """
    first, step, count = array("q"), array("q"), array("q")  # runs: where, bytes a record, how many
    at, total, same, last = start, 0, 0, -1
    view = data.data
    while (size := _whole(view, at, stop)) > 0:
        same = same + 1 if size == last else 0
        n = _run(data, at, stop, size) if same >= SAME else 1
        first.append(at)
        step.append(size)
        count.append(n)
        at, total, last = at + n * size, total + n, size
        if total > MAX_RECORDS:
            raise McapError(f"holds more than {MAX_RECORDS} records in a row; split it into smaller logs")
    return _table(data, np.array(first), np.array(step), np.array(count), at, at == stop)


def _whole(data: memoryview, at: int, stop: int) -> int:
    """Bytes of the record at a place with its frame; 0 where no whole record is."""
    if at + FRAME > stop:
        return 0
    opcode, length = _FRAME.unpack_from(data, at)
    # opcode 0 is never valid: zeros of a hole or of a preallocated file
    return 0 if opcode == 0 or length > stop - at - FRAME else FRAME + length


def _run(data: Bytes, at: int, stop: int, size: int) -> int:
    """How many records of one size follow each other, the one at `at` among them."""
    frames = as_strided(data[at:], (min((stop - at) // size, RUN), FRAME), (size, 1), writeable=False)
    alike = (frames[:, 1:] == frames[0, 1:]).all(axis=1) & (frames[:, 0] != 0)
    return int(alike.size if alike.all() else alike.argmin())


def _table(data: Bytes, first: Ints, step: Ints, count: Ints, end: int, complete: bool) -> Table:
    size = np.repeat(step, count)
    within = np.arange(size.size) - np.repeat(np.cumsum(count) - count, count)
    start = np.repeat(first, count) + within * size
    return Table(data[start], start + FRAME, size - FRAME, end, complete)


@dataclass(frozen=True)
class Header:
    profile: str
    library: str


@dataclass(frozen=True)
class Footer:
    summary_start: int
    summary_offset_start: int
    summary_crc: int


@dataclass(frozen=True)
class Schema:
    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True)
class Channel:
    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class Message:
    channel_id: int
    sequence: int
    log_time: int
    publish_time: int
    data: bytes


@dataclass(frozen=True)
class Chunk:
    """A chunk's head; its compressed bytes are data[start : start + size] of the file."""

    message_start_time: int
    message_end_time: int
    uncompressed_size: int
    uncompressed_crc: int
    compression: str
    size: int
    start: int


@dataclass(frozen=True)
class MessageIndex:
    channel_id: int
    records: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class ChunkIndex:
    message_start_time: int
    message_end_time: int
    chunk_start_offset: int
    chunk_length: int
    message_index_offsets: Mapping[int, int]
    message_index_length: int
    compression: str
    compressed_size: int
    uncompressed_size: int


@dataclass(frozen=True)
class Attachment:
    log_time: int
    create_time: int
    name: str
    media_type: str
    data: bytes
    crc: int


@dataclass(frozen=True)
class AttachmentIndex:
    offset: int
    length: int
    log_time: int
    create_time: int
    data_size: int
    name: str
    media_type: str


@dataclass(frozen=True)
class Metadata:
    name: str
    metadata: Mapping[str, str]


@dataclass(frozen=True)
class MetadataIndex:
    offset: int
    length: int
    name: str


@dataclass(frozen=True)
class Statistics:
    message_count: int
    schema_count: int
    channel_count: int
    attachment_count: int
    metadata_count: int
    chunk_count: int
    message_start_time: int
    message_end_time: int
    channel_message_counts: Mapping[int, int]


@dataclass(frozen=True)
class SummaryOffset:
    group_opcode: int
    group_start: int
    group_length: int


@dataclass(frozen=True)
class DataEnd:
    data_section_crc: int


Record = (
    Header | Footer | Schema | Channel | Message | Chunk | MessageIndex | ChunkIndex | Attachment
    | AttachmentIndex | Metadata | MetadataIndex | Statistics | SummaryOffset | DataEnd
)  # fmt: skip


class _Cursor:
    """Reads little-endian values from a record's content; raises McapError where it ends too early."""

    def __init__(self, data: Bytes, start: int, length: int, what: str) -> None:
        self.view = data.data[start : start + length]
        self.base, self.at, self.what = start, 0, what

    def fields(self, form: str) -> list[Any]:
        """Values by a string of letters: those of `struct` for numbers, and those of _READ."""
        return [_READ[letter](self) if letter in _READ else self.number(letter) for letter in form]

    def number(self, letter: str) -> int:
        (value,) = struct.unpack("<" + letter, self.take(struct.calcsize("<" + letter)))
        return int(value)

    def take(self, size: int) -> memoryview:
        part = self.view[self.at : self.at + size]
        if len(part) < size:
            raise McapError(f"{self.place()} ends inside a field")
        self.at += size
        return part

    def text(self) -> str:
        try:
            return bytes(self.take(self.number("I"))).decode()
        except UnicodeDecodeError:
            raise McapError(f"{self.place()} has text that is not UTF-8") from None

    def texts(self) -> dict[str, str]:
        inner = _Cursor.__new__(_Cursor)
        inner.view, inner.base, inner.at, inner.what = self.take(self.number("I")), self.base, 0, self.what
        found = {}
        while inner.at < len(inner.view):
            key = inner.text()
            found[key] = inner.text()
        return found

    def pairs(self, form: str) -> tuple[tuple[int, int], ...]:
        size = self.number("I")
        part = self.take(size - size % struct.calcsize(form))
        return tuple((a, b) for a, b in struct.iter_unpack(form, part))

    def place(self) -> str:
        return f"the {self.what} record at byte {self.base - FRAME}"


_READ: dict[str, Callable[[_Cursor], Any]] = {
    "t": _Cursor.text,
    "b": lambda c: bytes(c.take(c.number("I"))),
    "l": lambda c: bytes(c.take(c.number("Q"))),
    "r": lambda c: bytes(c.view[c.at :]),
    "m": _Cursor.texts,
    "p": lambda c: c.pairs("<QQ"),
    "d": lambda c: dict(c.pairs("<HQ")),
    "s": lambda c: c.base + c.at,  # where in the file the rest starts
}

_FORMS: dict[Op, tuple[Callable[..., Record], str]] = {
    Op.HEADER: (Header, "tt"),
    Op.FOOTER: (Footer, "QQI"),
    Op.SCHEMA: (Schema, "Httb"),
    Op.CHANNEL: (Channel, "HHttm"),
    Op.MESSAGE: (Message, "HIQQr"),
    Op.CHUNK: (Chunk, "QQQItQs"),
    Op.MESSAGE_INDEX: (MessageIndex, "Hp"),
    Op.CHUNK_INDEX: (ChunkIndex, "QQQQdQtQQ"),
    Op.ATTACHMENT: (Attachment, "QQttlI"),
    Op.ATTACHMENT_INDEX: (AttachmentIndex, "QQQQQtt"),
    Op.STATISTICS: (Statistics, "QHIIIIQQd"),
    Op.METADATA: (Metadata, "tm"),
    Op.METADATA_INDEX: (MetadataIndex, "QQt"),
    Op.SUMMARY_OFFSET: (SummaryOffset, "BQQ"),
    Op.DATA_END: (DataEnd, "I"),
}


def parse(data: Bytes, opcode: int, start: int, length: int) -> Record | None:
    """The record whose content is data[start : start + length]; None for an opcode that MCAP 0 lacks.

    Raises McapError when the content does not hold what the opcode promises.
    """
    if opcode not in _FORMS:
        return None
    op = Op(opcode)
    kind, form = _FORMS[op]
    return kind(*_Cursor(data, start, length, op.name.lower().replace("_", " ")).fields(form))
