"""The MCAP log of a pass: written and read whole, and a writer for any columns of ROS 2 messages.

`write_log(path, log)` and `read_log(path, manifest=None)` are exact inverses: streams, manifest, warnings and
health come back as they were. `write_channels(path, channels, attachments, metadata)` writes any channels
(see log_topics.Channel): one topic a chunk, zstd, CRCs, message indexes, summary; under a temporary
name until it is whole.
"""

from __future__ import annotations

import contextlib
import json
import os
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

import numpy as np
import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from numpy.typing import NDArray

from .log_collect import LogError
from .log_read import read_streams
from .log_topics import LIBRARY, Channel, Columns, channels_of, messages, to_ns
from .manifest import ManifestError
from .manifest import read as read_manifest
from .mcap_records import MAGIC, Bytes, Ints
from .streams import FieldLog

__all__ = ["Attachment", "Channel", "LogError", "messages", "read_log", "write_channels", "write_log"]

PROFILE = "ros2"
CHUNK_BYTES = 1 << 20  # uncompressed
CHUNK_NS = 30_000_000_000  # and at most this span: a log that is cut off loses the end, not whole sensors
LEVEL = 1  # zstd; higher ones cost twice the time and save under 1 % on inertial noise
WORKERS = min(4, os.cpu_count() or 1)
MANIFEST_NAME = "run.toml"
INGEST_NAME = "ingest.json"
RUN_METADATA = "smts.run"
Records = list[records.McapRecord]


@dataclass(frozen=True)
class Attachment:
    """A file that rides along in a log."""

    name: str
    media_type: str
    data: bytes
    time_ns: int = 0


def write_log(path: Path, log: FieldLog) -> None:
    """Write a pass as one MCAP file: its streams, run.toml, and what ingest found.

    Raises CdrError for a time that ROS 2 stamps cannot hold, OSError where the file cannot be written.
    """
    start = min(
        (int(to_ns(stream.t_arrival[:1])[0]) for stream in log.streams.values() if stream.t.size), default=0
    )
    ingest = {"warnings": [asdict(warn) for warn in log.warnings], "health": log.health, "sha256": log.sha256}
    attachments = (
        Attachment(MANIFEST_NAME, "application/toml", log.manifest_text.encode(), max(start, 0)),
        Attachment(INGEST_NAME, "application/json", json.dumps(ingest).encode(), max(start, 0)),
    )
    run = {key: str(value) for key, value in log.manifest.run.model_dump().items()}
    write_channels(path, channels_of(log), attachments, {RUN_METADATA: run})


def read_log(path: Path, manifest: Path | None = None) -> FieldLog:
    """The pass in an MCAP file or a rosbag2 folder.

    manifest overrides the run.toml in the log; a sensor's `topic` then names where its data are.
    Raises LogError, one line: what, where (file, topic), how to mend. Damage that leaves something to read is
    a warning of the FieldLog.
    """
    try:
        given = None if manifest is None else read_manifest(manifest)
    except ManifestError as error:
        raise LogError(str(error)) from None
    return read_streams(path, given)


def write_channels(
    path: Path,
    channels: Iterable[Channel],
    attachments: Sequence[Attachment] = (),
    metadata: Mapping[str, Mapping[str, str]] | None = None,
) -> None:
    """Write channels as one MCAP file; it appears under its name only when it is whole.

    Raises OSError where it cannot be written, CdrError or ValueError for columns that do not fit a type.
    """
    chosen = list(channels)
    for channel in chosen:
        _check_times(channel)
    with _whole_or_not(path) as stream:
        writer = _Writer(stream)
        writer.start(chosen)
        for name, pairs in (metadata or {}).items():
            writer.metadata(name, pairs)
        for attachment in attachments:
            writer.attachment(attachment)
        writer.messages()
        writer.finish()


def _check_times(channel: Channel) -> None:
    """Raises LogError for times that MCAP's unsigned ns cannot hold, or that are not one a message."""
    if len(channel.log_time_ns) != len(channel.messages):
        n, times = len(channel.messages), len(channel.log_time_ns)
        raise LogError(f"topic {channel.topic}: {n} messages with {times} log times")
    published = channel.log_time_ns if channel.publish_time_ns is None else channel.publish_time_ns
    if any(int(times.min()) < 0 for times in (channel.log_time_ns, published) if len(times)):
        raise LogError(f"topic {channel.topic}: a time lies before 1970, which MCAP cannot hold")


@contextlib.contextmanager
def _whole_or_not(path: Path) -> Iterator[IO[bytes]]:
    """A file under a temporary name beside `path`, renamed to it at the end, or removed."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


@dataclass(frozen=True)
class _Packed:
    """One chunk, ready to be written: compressed records and their index."""

    channel_id: int
    data: bytes
    size: int
    crc: int
    index: bytes
    start_time: int
    end_time: int
    count: int


@dataclass
class _Writer:
    """Writes records in the order of the MCAP specification and remembers what the summary repeats."""

    stream: IO[bytes]
    at: int = 0
    crc: int = 0
    channels: list[Channel] = field(default_factory=list)
    definitions: Records = field(default_factory=list)
    start_time: int = 2**64
    end_time: int = 0
    chunk_index: Records = field(default_factory=list)
    attachment_index: Records = field(default_factory=list)
    metadata_index: Records = field(default_factory=list)

    def put(self, data: bytes) -> int:
        """Write bytes of the data section; their length."""
        self.stream.write(data)
        self.crc = zlib.crc32(data, self.crc)
        self.at += len(data)
        return len(data)

    def start(self, channels: list[Channel]) -> None:
        self.channels = channels
        self.put(MAGIC + _bytes_of(records.Header(library=LIBRARY, profile=PROFILE)))
        self.definitions = list(_definitions(channels))
        for record in self.definitions:
            self.put(_bytes_of(record))

    def metadata(self, name: str, pairs: Mapping[str, str]) -> None:
        at = self.at
        length = self.put(_bytes_of(records.Metadata(name=name, metadata=dict(pairs))))
        self.metadata_index.append(records.MetadataIndex(offset=at, length=length, name=name))

    def attachment(self, item: Attachment) -> None:
        at, common = self.at, (item.name, item.media_type)
        length = self.put(_bytes_of(records.Attachment(item.time_ns, item.time_ns, *common, item.data)))
        times = (item.time_ns, item.time_ns)
        self.attachment_index.append(records.AttachmentIndex(at, length, *times, len(item.data), *common))

    def messages(self) -> None:
        """Serialise and compress in threads, a few chunks ahead of the writing."""
        jobs = [(i, *span) for i, each in enumerate(self.channels, 1) for span in _spans(each)]
        jobs.sort(key=lambda job: int(self.channels[job[0] - 1].log_time_ns[job[1]]))
        with ThreadPoolExecutor(WORKERS) as pool:
            for first in range(0, len(jobs), 4 * WORKERS):
                some = jobs[first : first + 4 * WORKERS]
                for packed in pool.map(lambda job: _pack(self.channels[job[0] - 1], *job), some):
                    self.chunk(packed)

    def chunk(self, packed: _Packed) -> None:
        at = self.at
        span = {"message_start_time": packed.start_time, "message_end_time": packed.end_time}
        record = records.Chunk(
            compression="zstd",
            data=packed.data,
            uncompressed_crc=packed.crc,
            uncompressed_size=packed.size,
            **span,
        )
        length = self.put(_bytes_of(record))
        index_at = self.at
        index_length = self.put(packed.index)
        index = records.ChunkIndex(
            chunk_start_offset=at,
            chunk_length=length,
            message_index_offsets={packed.channel_id: index_at},
            message_index_length=index_length,
            compression="zstd",
            compressed_size=len(packed.data),
            uncompressed_size=packed.size,
            **span,
        )
        self.chunk_index.append(index)
        self.start_time = min(self.start_time, packed.start_time)
        self.end_time = max(self.end_time, packed.end_time)

    def finish(self) -> None:
        self.put(_bytes_of(records.DataEnd(self.crc)))
        summary_start, builder, offsets = self.at, RecordBuilder(), []
        for opcode, group in self.summary():
            start = builder.count
            for record in group:
                record.write(builder)
            if group:
                offsets.append(records.SummaryOffset(opcode, summary_start + start, builder.count - start))
        offset_start = summary_start + builder.count
        for offset in offsets:
            offset.write(builder)
        data = _taken(builder)
        footer = records.Footer(summary_start=summary_start, summary_offset_start=offset_start, summary_crc=0)
        footer.summary_crc = zlib.crc32(_bytes_of(footer)[:-4], zlib.crc32(data))
        self.stream.write(data + _bytes_of(footer) + MAGIC)

    def summary(self) -> list[tuple[Opcode, Records]]:
        """The groups that the summary repeats or indexes."""
        schemas: Records = [each for each in self.definitions if isinstance(each, records.Schema)]
        channels: Records = [each for each in self.definitions if isinstance(each, records.Channel)]
        return [
            (Opcode.SCHEMA, schemas),
            (Opcode.CHANNEL, channels),
            (Opcode.STATISTICS, [self.statistics(len(schemas))]),
            (Opcode.CHUNK_INDEX, self.chunk_index),
            (Opcode.ATTACHMENT_INDEX, self.attachment_index),
            (Opcode.METADATA_INDEX, self.metadata_index),
        ]

    def statistics(self, schema_count: int) -> records.Statistics:
        counts = {i: len(each.messages) for i, each in enumerate(self.channels, 1)}
        return records.Statistics(
            attachment_count=len(self.attachment_index),
            channel_count=len(self.channels),
            channel_message_counts=counts,
            chunk_count=len(self.chunk_index),
            message_count=sum(counts.values()),
            metadata_count=len(self.metadata_index),
            message_start_time=self.start_time if self.chunk_index else 0,
            message_end_time=self.end_time,
            schema_count=schema_count,
        )


def _bytes_of(record: records.McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _taken(builder)


def _taken(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]


def _definitions(channels: Sequence[Channel]) -> Iterator[records.McapRecord]:
    """A schema for each type, in front of its first channel."""
    ids: dict[tuple[str, str], int] = {}
    for i, channel in enumerate(channels, 1):
        key = (channel.schema_name, channel.text)
        if key not in ids:
            ids[key] = len(ids) + 1
            yield records.Schema(id=ids[key], data=key[1].encode(), encoding="ros2msg", name=key[0])
        yield records.Channel(
            id=i,
            topic=channel.topic,
            message_encoding="cdr",
            metadata=dict(channel.metadata),
            schema_id=ids[key],
        )


def _spans(channel: Channel) -> Iterator[tuple[int, int]]:
    """Row ranges of a channel's chunks."""
    n = len(channel.messages)
    if n == 0:
        return
    size = (
        len(channel.messages.rows(0, 1)[0])
        if isinstance(channel.messages, Columns)
        else (sum(map(len, channel.messages)) // n)
    )
    span = int(channel.log_time_ns[-1]) - int(channel.log_time_ns[0])
    in_time = n * CHUNK_NS // span if span > CHUNK_NS else n
    step = max(1, min(in_time, CHUNK_BYTES // (size + _HEAD.itemsize)))
    for start in range(0, n, step):
        yield start, min(start + step, n)


_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel_id", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)


def _heads(channel: Channel, channel_id: int, start: int, lengths: Ints) -> NDArray[np.void]:
    """Frame and head of each message record, for payloads of these lengths."""
    heads = np.empty(lengths.size, _HEAD)
    stop = start + lengths.size
    published = channel.log_time_ns if channel.publish_time_ns is None else channel.publish_time_ns
    heads["opcode"], heads["channel_id"] = Opcode.MESSAGE, channel_id
    heads["length"] = lengths + (_HEAD.itemsize - 9)
    heads["sequence"] = np.arange(start, stop)
    heads["log_time"] = channel.log_time_ns[start:stop]
    heads["publish_time"] = published[start:stop]
    return heads


def _pack(channel: Channel, channel_id: int, start: int, stop: int) -> _Packed:
    """Serialise, checksum, index and compress rows start..stop of a channel."""
    if isinstance(channel.messages, Columns):
        content, heads = _fixed(channel, channel_id, start, channel.messages.rows(start, stop))
    else:
        content, heads = _ragged(channel, channel_id, start, channel.messages[start:stop])
    lengths = heads["length"].astype(np.int64) + 9
    index = np.empty((heads.size, 2), "<u8")
    index[:, 0], index[:, 1] = heads["log_time"], np.cumsum(lengths) - lengths
    return _Packed(
        channel_id,
        zstandard.ZstdCompressor(level=LEVEL).compress(content),
        len(content),
        zlib.crc32(content),
        _index_record(channel_id, index),
        int(heads["log_time"].min()),
        int(heads["log_time"].max()),
        heads.size,
    )


def _fixed(channel: Channel, channel_id: int, start: int, payloads: Bytes) -> tuple[Any, NDArray[np.void]]:
    n, size = payloads.shape
    heads = _heads(channel, channel_id, start, np.full(n, size))
    content = np.empty((n, _HEAD.itemsize + size), np.uint8)
    content[:, : _HEAD.itemsize] = heads.view(np.uint8).reshape(n, _HEAD.itemsize)
    content[:, _HEAD.itemsize :] = payloads
    return content.data.cast("B"), heads


def _ragged(
    channel: Channel, channel_id: int, start: int, payloads: Sequence[bytes]
) -> tuple[bytes, NDArray[np.void]]:
    heads = _heads(channel, channel_id, start, np.array([len(each) for each in payloads], np.int64))
    return b"".join(head.tobytes() + each for head, each in zip(heads, payloads, strict=True)), heads


def _index_record(channel_id: int, index: NDArray[np.uint64]) -> bytes:
    """A MessageIndex record: (log time, offset in the chunk) of each message."""
    pairs = index.tobytes()
    head = np.array([(Opcode.MESSAGE_INDEX, 6 + len(pairs), channel_id, len(pairs))], "u1,<u8,<u2,<u4")
    return head.tobytes() + pairs
