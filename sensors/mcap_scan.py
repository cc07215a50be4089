"""Reading any MCAP file: with or without summary, index or chunks, whole or damaged.

`open_recording` walks the file's records one after the other and believes nothing but what it walks over: the
summary only confirms. `read_messages` then yields the messages chunk by chunk, as tables of offsets into
the decompressed bytes. What is damaged is left out and said (`Fault`), never guessed.
"""

from __future__ import annotations

import datetime as dt
import mmap
import os
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray

from .cdr import Payloads
from .mcap_records import (
    FRAME,
    MAGIC,
    MESSAGE_DTYPE,
    MESSAGE_HEAD,
    Attachment,
    Bytes,
    Channel,
    Chunk,
    DataEnd,
    Footer,
    Header,
    Ints,
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

MAX_CHUNK = 256 * 2**20  # bytes, uncompressed; usual chunks are 1 to 4 MiB
MAX_TOTAL = 64 * 2**30  # bytes, uncompressed, of all chunks
MAX_RATIO = 2000  # and at most this many times the file's size: recordings shrink by 2 to 50
MAX_ATTACHMENT = 64 * 2**20  # bytes
BATCH = 32 * 2**20  # bytes of chunks that are decompressed at the same time
WORKERS = min(4, os.cpu_count() or 1)


@dataclass(frozen=True)
class Fault:
    """Something damaged, and what it cost."""

    what: str
    effect: str


@dataclass(frozen=True)
class Batch:
    """Messages of one channel from one chunk, in file order."""

    channel: Channel
    schema: Schema | None
    log_time: NDArray[np.uint64]
    publish_time: NDArray[np.uint64]
    payloads: Payloads


@dataclass(frozen=True)
class Recording:
    """A file's records outside chunks. data is the file's bytes (mapped, not read)."""

    path: Path
    data: Bytes
    header: Header
    schemas: Mapping[int, Schema]
    channels: Mapping[int, Channel]
    chunks: tuple[Chunk, ...]
    loose: Table
    attachments: tuple[Attachment, ...]
    metadata: tuple[Metadata, ...]
    statistics: Statistics | None
    faults: tuple[Fault, ...]


@dataclass
class _Registry:
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
    data = _map(path)
    if data[: len(MAGIC)].tobytes() != MAGIC:
        raise McapError(f"{path}: is not an MCAP file (it does not begin with its magic bytes)")
    try:
        return _scan(path, data)
    except McapError as error:
        raise McapError(f"{path}: {error}") from None


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
    registry = _Registry()
    chunks: list[Chunk] = []
    attachments: list[Attachment] = []
    metadata: list[Metadata] = []
    faults: list[Fault] = []
    header, statistics = Header("", ""), None
    for record in _records(data, table, (Op.MESSAGE, Op.MESSAGE_INDEX, Op.CHUNK_INDEX)):
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
        path, data, header, registry.schemas, registry.channels, (*chunks, *cut), _loose(table),
        tuple(attachments), tuple(metadata), statistics,
        (*faults, *_damage(data, table, closed), *_sum_faults(data, table)),
    )  # fmt: skip


def _records(data: Bytes, table: Table, leave: Sequence[Op]) -> Iterator[Record | Fault]:
    """Parse a table's records except those kinds; the same bytes (a repeated definition) only once."""
    wanted = np.flatnonzero(~np.isin(table.opcode, [int(op) for op in leave]))
    for i in wanted:
        opcode, start, length = int(table.opcode[i]), int(table.start[i]), int(table.length[i])
        if opcode == Op.ATTACHMENT and length > MAX_ATTACHMENT:
            yield Fault(f"an attachment of {length} bytes at byte {start - FRAME}", "it was passed over")
            continue
        record = parse(data, opcode, start, length)
        if record is not None:
            yield record


def _loose(table: Table) -> Table:
    """The messages that lie outside chunks."""
    rows = table.of(Op.MESSAGE)
    return Table(table.opcode[rows], table.start[rows], table.length[rows], table.end, True)


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
        return ()
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
            zlib.crc32(data[: at - FRAME].data),
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
    return footer.summary_crc != 0 and zlib.crc32(data[start : at + 16].data) != footer.summary_crc


# -- messages --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Block:
    """Decompressed records, or the fault that hides them."""

    data: Bytes
    table: Table
    faults: tuple[Fault, ...] = ()


def read_messages(recording: Recording, wanted: Callable[[Channel], bool]) -> Iterator[Batch | Fault]:
    """Messages of the wanted channels in file order, a batch for each chunk and channel, and what is lost.

    Raises McapError for an unknown compression, for sizes that no recording has (a decompression bomb), or
    for a message without its channel.
    """
    _refuse_bombs(recording)
    registry = _Registry(dict(recording.schemas), dict(recording.channels))
    if recording.loose.opcode.size:
        yield from _batches(_Block(recording.data, recording.loose), registry, wanted)
    with ThreadPoolExecutor(WORKERS) as pool:
        for group in _grouped(recording.chunks):
            for block in pool.map(lambda chunk: _open_chunk(recording.data, chunk), group):
                yield from block.faults
                yield from _batches(block, registry, wanted)


def _refuse_bombs(recording: Recording) -> None:
    total = sum(chunk.uncompressed_size for chunk in recording.chunks)
    if total > min(MAX_TOTAL, MAX_RATIO * recording.data.size):
        raise McapError(
            f"its chunks claim {total} bytes uncompressed, the file has {recording.data.size}; refused"
        )


def _grouped(chunks: Sequence[Chunk]) -> Iterator[list[Chunk]]:
    group: list[Chunk] = []
    size = 0
    for chunk in chunks:
        if group and size + chunk.uncompressed_size > BATCH:
            yield group
            group, size = [], 0
        group.append(chunk)
        size += chunk.uncompressed_size
    if group:
        yield group


def _open_chunk(data: Bytes, chunk: Chunk) -> _Block:
    if chunk.uncompressed_size > MAX_CHUNK:
        raise McapError(f"a chunk claims {chunk.uncompressed_size} bytes, more than {MAX_CHUNK}; refused")
    raw = _decompress(data.data[chunk.start : chunk.start + chunk.size], chunk)
    span = _span(chunk)
    content = np.frombuffer(raw, np.uint8)
    if content.size == chunk.uncompressed_size and chunk.uncompressed_crc not in (0, zlib.crc32(raw)):
        fault = Fault(f"the chunk of {span} has a wrong CRC", f"its messages ({span}) are lost")
        return _Block(content[:0], walk(content, 0, 0), (fault,))
    table = walk(content, 0, content.size)
    if content.size == chunk.uncompressed_size and table.complete:
        return _Block(content, table)
    fault = Fault(
        f"the chunk of {span} is cut: {content.size} of {chunk.uncompressed_size} bytes could be read",
        f"its {table.of(Op.MESSAGE).size} whole messages were salvaged, the rest is lost",
    )
    return _Block(content, table, (fault,))


def _span(chunk: Chunk) -> str:
    return f"{_utc(chunk.message_start_time)} to {_utc(chunk.message_end_time)}"


def _utc(t_ns: int) -> str:
    moment = dt.datetime(1970, 1, 1, tzinfo=dt.UTC) + dt.timedelta(microseconds=t_ns // 1000)
    return moment.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def _decompress(packed: memoryview, chunk: Chunk) -> bytes | memoryview:
    """As much of the chunk's content as can be had, never more than it claims."""
    size = chunk.uncompressed_size
    match chunk.compression:
        case "":
            return packed[:size]
        case "zstd":
            return _zstd(packed, size)
        case "lz4":
            return _lz4(packed, size)
    raise McapError(f"a chunk is compressed with {chunk.compression!r}; zstd, lz4 and none are known")


def _zstd(packed: memoryview, size: int) -> bytes:
    try:
        if 0 <= zstandard.frame_content_size(packed) <= size:
            return zstandard.ZstdDecompressor().decompress(packed)[:size]
    except zstandard.ZstdError:
        pass  # cut or damaged: below, as far as it goes
    return _as_far_as_it_goes(zstandard.ZstdDecompressor().decompressobj(), packed, size, zstandard.ZstdError)


def _lz4(packed: memoryview, size: int) -> bytes:
    try:
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size))
    except RuntimeError:
        return _as_far_as_it_goes(lz4.frame.LZ4FrameDecompressor(), packed, size, RuntimeError)


def _as_far_as_it_goes(engine: object, packed: memoryview, size: int, error: type[Exception]) -> bytes:
    """Decompress in small steps until the input ends, breaks, or has given the size that was claimed."""
    out = bytearray()
    step = 256
    for at in range(0, len(packed), step):
        try:
            out += engine.decompress(packed[at : at + step])  # type: ignore[attr-defined]
        except (error, EOFError):
            break
        if len(out) >= size:
            break
    return bytes(out[:size])


def _batches(block: _Block, registry: _Registry, wanted: Callable[[Channel], bool]) -> Iterator[Batch]:
    for record in _records(block.data, _definitions(block.table), ()):
        registry.add(record)
    rows = block.table.of(Op.MESSAGE)
    if rows.size == 0:
        return
    start, length = block.table.start[rows], block.table.length[rows]
    if int(length.min()) < MESSAGE_HEAD:
        raise McapError(f"a message record is shorter than its {MESSAGE_HEAD} bytes of head")
    heads = _heads(block.data, start)
    ids = heads["channel_id"]
    for key in dict.fromkeys(ids.tolist()) if ids.size < 64 else np.unique(ids).tolist():
        channel = registry.channels.get(key)
        if channel is None:
            raise McapError(f"messages of channel {key}, which no record defines")
        if not wanted(channel):
            continue
        own = np.flatnonzero(ids == key)
        payloads = Payloads(block.data, start[own] + MESSAGE_HEAD, length[own] - MESSAGE_HEAD)
        yield Batch(
            channel,
            registry.schemas.get(channel.schema_id),
            heads["log_time"][own],
            heads["publish_time"][own],
            payloads,
        )


def _definitions(table: Table) -> Table:
    rows = np.flatnonzero((table.opcode == Op.SCHEMA) | (table.opcode == Op.CHANNEL))
    return Table(table.opcode[rows], table.start[rows], table.length[rows], table.end, True)


def _heads(data: Bytes, start: Ints) -> NDArray[np.void]:
    windows = np.lib.stride_tricks.sliding_window_view(data, MESSAGE_HEAD)
    return np.asarray(windows[start]).view(MESSAGE_DTYPE)[:, 0]
