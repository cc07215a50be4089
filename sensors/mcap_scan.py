"""Reading any MCAP file: with or without summary, index or chunks, whole or damaged.

`open_recording` walks the file's records one after the other and believes nothing but what it walks over: the
summary only confirms. Chunks stay closed (see mcap_messages). What is damaged is said (`Fault`).
"""

from __future__ import annotations

import itertools
import mmap
import os
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .mcap_records import (
    FRAME,
    MAGIC,
    Attachment,
    Bytes,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    McapError,
    Metadata,
    Op,
    Record,
    Schema,
    Statistics,
    Table,
    parse,
    walk,
)

MAX_ATTACHMENT = 64 * 2**20  # bytes
MESSAGE_INDEX_HEAD = 6  # bytes: channel, and how many bytes of entries follow
OTHERS = {
    b"#ROSBAG V2.0": "it is a bag of ROS 1; convert it with `rosbags-convert`",
    b"SQLite format 3": "it is a database of rosbag2; convert it with `ros2 bag convert`",
    b"\x28\xb5\x2f\xfd": "it is compressed as a whole; decompress it with `zstd -d`",
}
PIECE = 4 * 2**20  # bytes of a file that are looked at in one go


@dataclass(frozen=True)
class Fault:
    """Something damaged, and what it cost."""

    what: str
    effect: str


@dataclass(frozen=True)
class Recording:
    """A file's records outside chunks. data is the file's bytes (mapped, not read).

    inside: for each chunk the channels that its message indexes list; empty where there are none.
    """

    path: Path
    data: Bytes
    header: Header
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    chunks: tuple[Chunk, ...]
    inside: tuple[frozenset[int], ...]
    loose: Table
    attachments: tuple[Attachment, ...]
    metadata: tuple[Metadata, ...]
    statistics: Statistics | None
    faults: tuple[Fault, ...]

    def pieces(self) -> Iterator[memoryview]:
        """The file's bytes, in pieces."""
        return _pieces(self.data, 0, self.data.size)


@dataclass
class Registry:
    """Schemas and channels as they turn up; the same id may come again, but not with another meaning."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, record: Record | Fault) -> None:
        if isinstance(record, Schema) and self.schemas.setdefault(record.id, record) != record:
            raise McapError(f"schema {record.id} is defined twice, differently; the file is not valid MCAP")
        if isinstance(record, Channel) and self.channels.setdefault(record.id, record) != record:
            raise McapError(f"channel {record.id} is defined twice, differently; the file is not valid MCAP")


def open_recording(path: Path) -> Recording:
    """Walk over a file's records (chunks are not opened).

    Raises McapError, one line, when the file is not MCAP or holds a record that breaks the format.
    """
    return scan(path, _map(path))


def scan(path: Path, data: Bytes) -> Recording:
    """The same for a file's bytes; `path` is what messages call them."""
    begins = data[:16].tobytes()
    if not begins.startswith(MAGIC):
        other = [how for magic, how in OTHERS.items() if begins.startswith(magic)]
        what = (*other, "its first bytes are not those of one")[0]
        raise McapError(f"{path}: is not an MCAP file ({what})")
    try:
        return _scan(path, data)
    except McapError as error:
        raise McapError(f"{path}: {error}") from None


def _pieces(data: Bytes, start: int, stop: int) -> Iterator[memoryview]:
    """data[start:stop] in pieces; pages of a mapped file are let go behind each: none stay resident."""
    for at in range(start, stop, PIECE):
        yield data.data[at : min(at + PIECE, stop)]
        let_go(data, at, PIECE)


def let_go(data: Bytes, start: int, size: int) -> None:
    """Tell the system that pages of a mapped file are not needed for now."""
    mapped = data.base.obj if isinstance(data.base, memoryview) else None
    if isinstance(mapped, mmap.mmap) and hasattr(mmap, "MADV_DONTNEED"):
        first = start - start % mmap.PAGESIZE
        mapped.madvise(mmap.MADV_DONTNEED, first, min(start + size, data.size) - first)


def _crc(data: Bytes, start: int, stop: int) -> int:
    crc = 0
    for piece in _pieces(data, start, stop):
        crc = zlib.crc32(piece, crc)
    return crc


def _map(path: Path) -> Bytes:
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size == 0:
                raise McapError(f"{path}: is empty")
            return np.frombuffer(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ), np.uint8)
    except OSError as error:
        raise McapError(f"{path}: cannot be read: {error.strerror}") from None


def _scan(path: Path, data: Bytes) -> Recording:
    closed = data.size >= 2 * len(MAGIC) and data[-len(MAGIC) :].tobytes() == MAGIC
    table = walk(data, len(MAGIC), data.size - (len(MAGIC) if closed else 0))
    registry = Registry()
    chunks: list[Chunk] = []
    attachments: list[Attachment] = []
    metadata: list[Metadata] = []
    faults: list[Fault] = []
    header, statistics = Header("", ""), None
    for record in records_of(data, table, (Op.MESSAGE, Op.MESSAGE_INDEX, Op.CHUNK_INDEX)):
        registry.add(record)
        match record:
            case Header():
                header = record
            case Chunk():
                chunks.append(record)
            case Attachment():
                attachments.append(record)
            case Metadata():
                metadata.append(record)
            case Statistics():
                statistics = record
            case Fault():
                faults.append(record)
    cut = _cut_chunk(data, table)
    return Recording(
        path, data, header, registry.schemas, registry.channels, (*chunks, *cut),
        (*_inside(data, table), *(frozenset[int]() for _ in cut)), _loose(table),
        tuple(attachments), tuple(metadata), statistics,
        (*faults, *_damage(data, table, closed), *_sum_faults(data, table)),
    )  # fmt: skip


def records_of(data: Bytes, table: Table, leave: Sequence[Op]) -> Iterator[Record | Fault]:
    """Parse a table's records except those kinds; a definition that comes again as it was only once."""
    seen: set[bytes] = set()
    for i in np.flatnonzero(~np.isin(table.opcode, [int(op) for op in leave])):
        opcode, start, length = int(table.opcode[i]), int(table.start[i]), int(table.length[i])
        if opcode in (Op.SCHEMA, Op.CHANNEL):
            content = data[start - FRAME : start + length].tobytes()
            if content in seen:
                continue
            seen.add(content)
        if opcode == Op.ATTACHMENT and length > MAX_ATTACHMENT:
            yield Fault(f"an attachment of {length} bytes at byte {start - FRAME}", "it was passed over")
            continue
        record = parse(data, opcode, start, length)
        if isinstance(record, Attachment) and not _is_sound(data, start, record):
            yield Fault(f"the attachment {record.name} has a wrong CRC", "it was passed over")
        elif record is not None:
            yield record


def _is_sound(data: Bytes, start: int, record: Attachment) -> bool:
    """Whether an attachment's CRC is right (0: there is none)."""
    return record.crc in (0, _crc(data, start, start + _summed(record)))


def _summed(record: Attachment) -> int:
    """Bytes of an attachment's content in front of its CRC (behind it there may be padding)."""
    return 8 + 8 + 4 + len(record.name.encode()) + 4 + len(record.media_type.encode()) + 8 + len(record.data)


def _inside(data: Bytes, table: Table) -> list[frozenset[int]]:
    """The channels that are in each chunk, by the message indexes behind it."""
    indexes = table.of(Op.MESSAGE_INDEX)
    indexes = indexes[table.length[indexes] >= MESSAGE_INDEX_HEAD]
    at = table.start[indexes]
    channels = data[at].astype(np.int64) | data[at + 1].astype(np.int64) << 8
    listed = data[at[:, np.newaxis] + np.arange(2, MESSAGE_INDEX_HEAD)].any(
        axis=1
    )  # of more than no messages
    chunks = table.of(Op.CHUNK)
    edges = np.searchsorted(indexes[listed], np.append(chunks, table.opcode.size))
    channels = channels[listed]
    return [frozenset(channels[a:b].tolist()) for a, b in itertools.pairwise(edges.tolist())]


def _loose(table: Table) -> Table:
    """The messages that lie outside chunks."""
    rows = table.of(Op.MESSAGE)
    return table.at(rows)


def _cut_chunk(data: Bytes, table: Table) -> tuple[Chunk, ...]:
    """The chunk that the end of a truncated file runs through, as far as it is there."""
    at = table.end
    if table.complete or at + FRAME >= data.size or data[at] != Op.CHUNK:
        return ()
    try:
        record = parse(data, Op.CHUNK, at + FRAME, data.size - at - FRAME)
    except McapError:
        return ()
    return (record,) if isinstance(record, Chunk) else ()


def _damage(data: Bytes, table: Table, closed: bool) -> tuple[Fault, ...]:
    if table.complete and closed:
        ends = np.isin([int(Op.DATA_END), int(Op.FOOTER)], table.opcode)
        return () if ends.all() else (Fault("the file lacks its data end or footer", "read all the same"),)
    if table.complete:
        return (Fault("the file ends without its closing magic bytes", "read up to its end"),)
    lost = data.size - table.end
    return (
        Fault(
            f"the file is cut or damaged at byte {table.end} of {data.size}",
            f"messages before that were salvaged; the last {lost} bytes are lost, or used as far as they go",
        ),
    )


def _sum_faults(data: Bytes, table: Table) -> Iterator[Fault]:
    """Faults told by the checksums over the data section and the summary."""
    ends = table.of(Op.DATA_END)
    if ends.size:
        at = int(table.start[ends[0]])
        record = parse(data, Op.DATA_END, at, int(table.length[ends[0]]))
        if isinstance(record, DataEnd) and record.data_section_crc not in (
            0,
            _crc(data, 0, at - FRAME),
        ):
            yield Fault("the data section's CRC is wrong", "chunks are checked one by one by their own CRC")
    feet = table.of(Op.FOOTER)
    if feet.size:
        at = int(table.start[feet[0]])
        record = parse(data, Op.FOOTER, at, int(table.length[feet[0]]))
        if isinstance(record, Footer) and _wrong_summary(data, record, at):
            yield Fault("the summary's CRC is wrong", "the summary was not relied on")


def _wrong_summary(data: Bytes, footer: Footer, at: int) -> bool:
    """Whether the CRC over the summary and the footer (without the CRC itself) disagrees."""
    start = footer.summary_start or at - FRAME
    return footer.summary_crc != 0 and _crc(data, start, at + 16) != footer.summary_crc
