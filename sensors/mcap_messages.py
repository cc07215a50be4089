"""Messages of a recording, chunk by chunk: decompressed in threads, checked, and bounded in time and memory.

What is damaged is left out and said (`Fault`), never guessed; sizes are claims until the bytes are there.
"""

from __future__ import annotations

import datetime as dt
import os
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import lz4.frame
import numpy as np
import zstandard
from numpy.typing import NDArray

from .cdr import Payloads
from .mcap_records import (
    MESSAGE_DTYPE,
    MESSAGE_HEAD,
    Bytes,
    Channel,
    Chunk,
    Ints,
    McapError,
    Op,
    Schema,
    Table,
    walk,
)
from .mcap_scan import Fault, Recording, Registry, let_go, records_of

MAX_CHUNK = 256 * 2**20  # bytes, uncompressed; usual chunks are 1 to 4 MiB
MAX_TOTAL = 64 * 2**30  # bytes, uncompressed, of all chunks
MAX_RATIO = 2000  # and at most this many times the file's size: recordings shrink by 2 to 50
AHEAD = 8 * 2**20  # bytes of chunks that are decompressed ahead of their use
WORKERS = min(4, os.cpu_count() or 1)
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class Batch:
    """Messages of one channel from one chunk, in file order."""

    channel: Channel
    schema: Schema | None
    log_time: NDArray[np.uint64]
    publish_time: NDArray[np.uint64]
    payloads: Payloads


@dataclass(frozen=True)
class Block:
    """Decompressed records, taken apart as far as threads can do it.

    definitions: schemas and channels; start, length: (n,) of the messages' payloads; heads: (n,).
    """

    data: Bytes
    definitions: Table
    start: Ints
    length: Ints
    heads: NDArray[np.void]
    faults: tuple[Fault, ...] = ()


def make_block(data: Bytes, table: Table, faults: tuple[Fault, ...] = ()) -> Block:
    """Take a walked buffer apart. Raises McapError for a message shorter than its head."""
    defining = np.flatnonzero((table.opcode == Op.SCHEMA) | (table.opcode == Op.CHANNEL))
    rows: Ints | slice = table.of(Op.MESSAGE)
    start, length = table.start[rows], table.length[rows]
    if start.size and int(length.min()) < MESSAGE_HEAD:
        raise McapError(f"a message record is shorter than its {MESSAGE_HEAD} bytes of head")
    heads = np.empty(0, MESSAGE_DTYPE)
    if start.size:
        all_heads = Payloads(data, start, np.full(start.size, MESSAGE_HEAD))
        heads = all_heads.matrix(np.arange(start.size)).view(MESSAGE_DTYPE)[:, 0]
    return Block(data, table.at(defining), start + MESSAGE_HEAD, length - MESSAGE_HEAD, heads, faults)


def read_messages(recording: Recording, wanted: Callable[[Channel], bool]) -> Iterator[Batch | Fault]:
    """Messages of the wanted channels in file order, a batch for each chunk and channel, and what is lost.

    Chunks that by their message indexes hold nothing wanted stay closed.
    Raises McapError for an unknown compression, for sizes that no recording has (a decompression bomb), or
    for a message without its channel.
    """
    registry = Registry(dict(recording.schemas), dict(recording.channels))
    chunks = [
        chunk
        for chunk, inside in zip(recording.chunks, recording.inside, strict=True)
        if _may_hold(inside, recording.channels, wanted)
    ]
    _refuse_bombs(chunks, recording.data.size)
    if recording.loose.opcode.size:
        yield from _batches(make_block(recording.data, recording.loose), registry, wanted)
    with ThreadPoolExecutor(WORKERS) as pool:
        for block in _ahead(pool, recording.data, chunks):
            yield from block.faults
            yield from _batches(block, registry, wanted)


def _may_hold(
    inside: frozenset[int], known: Mapping[int, Channel], wanted: Callable[[Channel], bool]
) -> bool:
    """Whether a chunk can hold something wanted: no index tells, or it lists a wanted or unknown channel."""
    return not inside or any(key not in known or wanted(known[key]) for key in inside)


def _refuse_bombs(chunks: Sequence[Chunk], file_size: int) -> None:
    total = sum(chunk.uncompressed_size for chunk in chunks)
    if total > min(MAX_TOTAL, MAX_RATIO * file_size):
        raise McapError(f"its chunks claim {total} bytes uncompressed, the file has {file_size}; refused")


def _ahead(pool: ThreadPoolExecutor, data: Bytes, chunks: Sequence[Chunk]) -> Iterator[Block]:
    """Opened chunks in order; others are opened in threads meanwhile, AHEAD bytes of them at most."""
    waiting: deque[tuple[Chunk, Future[Block]]] = deque()
    size = 0
    for chunk in chunks:
        while waiting and size + chunk.uncompressed_size > AHEAD:
            done, block = waiting.popleft()
            size -= done.uncompressed_size
            yield block.result()
            let_go(data, done.start, done.size)
        waiting.append((chunk, pool.submit(open_chunk, data, chunk)))
        size += chunk.uncompressed_size
    for _, block in waiting:
        yield block.result()


def open_chunk(data: Bytes, chunk: Chunk) -> Block:
    """A chunk's records, decompressed and checked.

    A chunk that the end of the file cuts gives what is there of it; one that is whole but does not
    decompress, or whose CRC is wrong, gives nothing: its values cannot be trusted.
    Raises McapError for an unknown compression and for a size that no chunk has.
    """
    if chunk.uncompressed_size > MAX_CHUNK:
        raise McapError(f"a chunk claims {chunk.uncompressed_size} bytes, more than {MAX_CHUNK}; refused")
    raw = _decompress(data.data[chunk.start : chunk.start + chunk.size], chunk)
    content = np.frombuffer(raw, np.uint8)
    if chunk.start + chunk.size > data.size:
        return _cut_block(content, chunk)
    right = content.size == chunk.uncompressed_size and chunk.uncompressed_crc in (0, zlib.crc32(raw))
    table = walk(content, 0, content.size if right else 0)
    if right and table.complete:
        return make_block(content, table)
    what = "its records do not fit" if right else "wrong CRC or damaged compression"
    fault = Fault(
        f"the chunk at byte {chunk.start} is damaged ({what})", f"all from {_span(chunk)} in it is lost"
    )
    return make_block(content, walk(content, 0, 0), (fault,))


def _cut_block(content: Bytes, chunk: Chunk) -> Block:
    table = walk(content, 0, content.size)
    count = table.of(Op.MESSAGE).size
    told = f"{content.size} of its {chunk.uncompressed_size} bytes could be read"
    fault = Fault(
        f"the chunk of {_span(chunk)} is cut: {told}",
        f"{count} whole messages were salvaged, the rest is lost",
    )
    return make_block(content, table, (fault,))


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
        if zstandard.frame_content_size(packed) <= size:  # -1: not stated, then the second limit holds
            return bytes(zstandard.ZstdDecompressor().decompress(packed, max_output_size=size))
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


def _batches(block: Block, registry: Registry, wanted: Callable[[Channel], bool]) -> Iterator[Batch | Fault]:
    if block.definitions.opcode.size:
        for record in records_of(block.data, block.definitions, ()):
            registry.add(record)
    ids = block.heads["channel_id"]
    for key, own in _by_channel(ids):
        channel = registry.channels.get(key)
        if channel is None:
            count = int(np.count_nonzero(ids == key))
            yield Fault(f"{count} messages are of channel {key}, which no record defines", "left out")
        elif wanted(channel):
            payloads = unpacked(Payloads(block.data, block.start[own], block.length[own]))
            times = block.heads["log_time"][own], block.heads["publish_time"][own]
            yield Batch(channel, registry.schemas.get(channel.schema_id), *times, payloads)


def _by_channel(ids: NDArray[np.uint16]) -> Iterator[tuple[int, Ints | slice]]:
    """Channels of a block and their rows; without a search where there is only one."""
    if ids.size and (ids == ids[0]).all():
        yield int(ids[0]), slice(None)
        return
    for key in np.unique(ids).tolist():
        yield key, np.flatnonzero(ids == key)


def unpacked(payloads: Payloads) -> Payloads:
    """Messages that rosbag2 compressed one by one (`compression_mode: message`), decompressed.

    Only metadata.yaml tells that a recording is; but no message of ROS begins as a zstd frame does, so
    the first one's bytes are asked: rosbag2 compresses all of a recording or nothing.

    Raises McapError for a frame that is damaged, and when they claim more than MAX_CHUNK bytes in all.
    """
    if len(payloads) == 0 or not payloads.at(0).startswith(ZSTD_MAGIC):
        return payloads
    engine, size, parts = zstandard.ZstdDecompressor(), 0, []
    for row in range(len(payloads)):
        parts.append(_frame(engine, payloads.at(row), row))
        size += len(parts[-1])
        if size > MAX_CHUNK:
            raise McapError(f"messages compressed one by one claim more than {MAX_CHUNK} bytes; refused")
    length = np.array([len(part) for part in parts], np.int64)
    return Payloads(np.frombuffer(b"".join(parts), np.uint8), np.cumsum(length) - length, length)


def _frame(engine: zstandard.ZstdDecompressor, part: bytes, row: int) -> bytes:
    try:
        if zstandard.frame_content_size(part) > MAX_CHUNK:
            raise McapError(f"message {row} claims more than {MAX_CHUNK} bytes uncompressed; refused")
        return bytes(engine.decompress(part, max_output_size=MAX_CHUNK))
    except zstandard.ZstdError:
        raise McapError(f"message {row} is compressed with zstd, but damaged") from None
