"""Damaged and hostile logs: what is left is read, what is lost is said, no claim is believed."""

from __future__ import annotations

import contextlib
import re
import struct
import time
import tracemalloc
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from log_samples import BARE, a_log, arrays_of, assert_same, drive, topic_manifest, write_foreign
from mcap.exceptions import EndOfFile
from mcap.records import Message
from mcap.stream_reader import StreamReader
from smts_validate.sensors.log import LogError, read_log, write_log
from smts_validate.sensors.mcap_messages import Batch, read_messages
from smts_validate.sensors.mcap_records import MAGIC, McapError, Op, walk
from smts_validate.sensors.mcap_scan import open_recording
from smts_validate.sensors.streams import FieldLog, Stream


@pytest.fixture(scope="module")
def log() -> FieldLog:
    return a_log(seconds=70.0)  # three chunks a topic


@pytest.fixture(scope="module")
def whole(log: FieldLog, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    path = tmp_path_factory.mktemp("damage") / "whole.mcap"
    write_log(path, log)
    return path.read_bytes()


def read_bytes(data: bytes, folder: Path, manifest: Path | None = None) -> FieldLog:
    path = folder / "damaged.mcap"
    path.write_bytes(data)
    return read_log(path, manifest)


def assert_part_of(part: Stream, whole: Stream) -> None:
    """Every sample of `part` is one of `whole`, unchanged (a lost companion topic may leave holes, and a log whose
    damaged header no longer says that it is ours loses positions that no receiver would give, and takes a missing
    altitude for zero, as of any fix in two dimensions)."""
    rows = np.searchsorted(whole.t, part.t)
    assert (rows < whole.t.size).all()
    exact = arrays_of(whole)
    for name in ("t", "t_arrival", "specific_force", "angular_velocity", "lat", "lon", "alt", "angle"):
        if name in exact:
            found, expected = arrays_of(part)[name], exact[name][rows]
            if name in ("lat", "lon", "alt"):
                expected = np.where(np.isnan(found), np.nan, expected)
            if name == "alt":
                expected = np.where(np.isnan(expected) & (found == 0.0), 0.0, expected)
            np.testing.assert_array_equal(found, expected, err_msg=name)


def assert_one_line(error: Exception) -> None:
    assert len(str(error).splitlines()) == 1


def kinds_at(data: bytes) -> list[tuple[int, int, int]]:
    """(opcode, where the record starts, where it ends) of the records outside chunks."""
    table = walk(np.frombuffer(data, np.uint8), len(MAGIC), len(data) - len(MAGIC))
    return [
        (int(op), int(at) - 9, int(at + size))
        for op, at, size in zip(table.opcode, table.start, table.length, strict=True)
    ]


@given(share=st.floats(0.0, 1.0, exclude_max=True))
@settings(max_examples=40, deadline=None)
def test_a_log_cut_anywhere_is_salvaged_up_to_the_cut_and_says_so(
    share: float, log: FieldLog, whole: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    cut = int(share * len(whole))
    try:
        found = read_bytes(whole[:cut], tmp_path_factory.mktemp("cut"))
    except LogError as error:
        found = str(error)
    if isinstance(found, str):
        # too little of it left: no magic, no manifest, or nothing yet of a sensor that a pass needs
        assert re.search("not an MCAP|is empty|no run.toml|no messages for sensor", found)
        return
    assert found.warnings[-1] != log.warnings[-1]
    assert any("cut" in warn.what or "closing" in warn.what for warn in found.warnings)
    for name, stream in found.streams.items():
        assert_part_of(stream, log.streams[name])


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_no_message_that_the_mcap_package_salvages_is_missed(
    share: float, whole: bytes, tmp_path: Path
) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: int(share * len(whole))])
    theirs = 0
    with path.open("rb") as file, contextlib.suppress(EndOfFile):
        for each in StreamReader(file).records:
            theirs += isinstance(each, Message)
    batches = [
        each for each in read_messages(open_recording(path), lambda channel: True) if isinstance(each, Batch)
    ]
    assert theirs > 0
    assert sum(len(batch.payloads) for batch in batches) >= theirs


def test_a_chunk_that_the_cut_runs_through_gives_its_beginning(
    log: FieldLog, whole: bytes, tmp_path: Path
) -> None:
    # a zstd block holds 128 KiB and is all or nothing, so a long chunk is cut
    start, end = next(
        (start, end) for op, start, end in kinds_at(whole) if op == Op.CHUNK and end - start > 10**5
    )
    (tmp_path / "a.mcap").write_bytes(MAGIC + whole[len(MAGIC) : end - (end - start) // 4])
    recording = open_recording(tmp_path / "a.mcap")
    *_, last = [each for each in read_messages(recording, lambda channel: True) if isinstance(each, Batch)]
    n = len(last.payloads)
    assert 1000 < n < 3000
    arrival = np.rint(log.streams[last.channel.topic.split("/")[1]].t_arrival[:n] * 1e9)
    near = last.log_time.astype(np.float64) - arrival
    assert np.abs(near).max() < 1000.0  # ns, the resolution of the floats


@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
@settings(max_examples=60, deadline=None)
def test_a_bit_that_flips_anywhere_is_noticed_and_never_becomes_data(
    place: float, bit: int, log: FieldLog, whole: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    data = bytearray(whole)
    data[int(place * len(data))] ^= 1 << bit
    try:
        found = read_bytes(bytes(data), tmp_path_factory.mktemp("flip"))
    except LogError as error:
        assert_one_line(error)
        return
    assert set(found.warnings) - set(log.warnings)
    for name, stream in found.streams.items():
        assert_part_of(stream, log.streams[name])


def test_a_wrong_crc_is_told_with_the_span_that_is_lost(log: FieldLog, whole: bytes, tmp_path: Path) -> None:
    chunks = [(start, end) for op, start, end in kinds_at(whole) if op == Op.CHUNK]
    start, end = next((start, end) for start, end in chunks if end - start > 10**5)
    data = bytearray(whole)
    data[(start + end) // 2] ^= 1
    found = read_bytes(bytes(data), tmp_path)
    (told,) = [warn for warn in found.warnings if "chunk" in warn.what]
    first, last = struct.unpack_from("<QQ", whole, start + 9)
    span = re.findall(r"(\d\d:\d\d:\d\d\.\d{3})Z", told.effect)
    assert [np.datetime64(t // 10**6, "ms").astype(str).split("T")[1] for t in (first, last)] == span
    lost = [
        (name, log.streams[name].t.size - stream.t.size)
        for name, stream in found.streams.items()
        if stream.t.size < log.streams[name].t.size
    ]
    assert len(lost) == 1
    assert all("lost" in warn.effect for warn in [told])


def test_health_of_a_damaged_log_is_of_what_is_left(log: FieldLog, whole: bytes, tmp_path: Path) -> None:
    chunks = [(start, end) for op, start, end in kinds_at(whole) if op == Op.CHUNK]
    found = read_bytes(whole[: chunks[-3][0]], tmp_path)
    for name, stream in found.streams.items():
        assert found.health[name]["samples"] == stream.t.size
    assert found.health["clock"] == log.health["clock"]


@pytest.mark.parametrize("attachment", ["run.toml", "ingest.json"])
def test_a_damaged_attachment_is_not_believed(
    attachment: str, log: FieldLog, whole: bytes, tmp_path: Path
) -> None:
    data = bytearray(whole)
    at = data.index(attachment.encode()) + 60
    data[at] ^= 1
    if attachment == "run.toml":
        with pytest.raises(LogError, match=r"no run.toml attached.*wrong CRC"):
            read_bytes(bytes(data), tmp_path)
        return
    found = read_bytes(bytes(data), tmp_path)
    assert_same(log, found)
    assert "the attachment ingest.json has a wrong CRC" in {warn.what for warn in found.warnings}


def test_a_manifest_given_by_hand_reads_a_log_whose_own_is_damaged(
    log: FieldLog, whole: bytes, tmp_path: Path
) -> None:
    data = bytearray(whole)
    data[data.index(b"run.toml") + 60] ^= 1
    (tmp_path / "run.toml").write_text(log.manifest_text)
    assert_same(log, read_bytes(bytes(data), tmp_path, tmp_path / "run.toml"))


def test_a_lost_closing_is_told_though_nothing_is_lost(log: FieldLog, whole: bytes, tmp_path: Path) -> None:
    found = read_bytes(whole[: -len(MAGIC)], tmp_path)
    assert_same(log, found)
    assert len(found.warnings) == len(log.warnings) + 1


# -- hostile ---------------------------------------------------------------------------------------------


def record(op: int, content: bytes, length: int | None = None) -> bytes:
    return struct.pack("<BQ", op, len(content) if length is None else length) + content


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


HEADER = MAGIC + record(Op.HEADER, text("ros2") + text("tests"))
END = record(Op.DATA_END, bytes(4)) + record(Op.FOOTER, bytes(20)) + MAGIC


def chunk(
    packed: bytes, size: int, compression: str = "zstd", crc: int = 0, length: int | None = None
) -> bytes:
    head = struct.pack("<QQQI", 0, 10**9, size, crc) + text(compression)
    return record(Op.CHUNK, head + struct.pack("<Q", len(packed) if length is None else length) + packed)


def refusal(data: bytes, folder: Path) -> str:
    """The error of reading it, which must come soon and in little memory."""
    path = folder / "hostile.mcap"
    path.write_bytes(data)
    manifest = topic_manifest(folder)
    tracemalloc.start()
    start = time.process_time()
    try:
        with pytest.raises(LogError) as caught:
            read_log(path, manifest)
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    assert time.process_time() - start < 20.0
    assert peak < 150e6 + 4 * len(data)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_absurd_lengths_are_not_allocated(tmp_path: Path) -> None:
    for length in (2**63, 2**64 - 1, 2**40):
        told = refusal(HEADER + record(Op.SCHEMA, b"short", length) + END, tmp_path)
        assert "cut or damaged at byte" in told


@pytest.mark.parametrize(
    "content",
    [
        struct.pack("<HI", 1, 2**32 - 1),  # a schema's name of 4 GB
        struct.pack("<H", 1) + text("a") + text("ros2msg") + struct.pack("<I", 2**31),
    ],
)
def test_fields_that_claim_more_than_their_record_are_refused(content: bytes, tmp_path: Path) -> None:
    assert "ends inside a field" in refusal(HEADER + record(Op.SCHEMA, content) + END, tmp_path)


def test_a_chunk_that_claims_terabytes_is_refused(tmp_path: Path) -> None:
    packed = zstandard.compress(bytes(100))
    assert "claim" in refusal(HEADER + chunk(packed, 2**42) + END, tmp_path)


def test_a_decompression_bomb_is_bounded_by_what_the_chunk_claims(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor(level=19).compress(bytes(400 * 2**20))
    assert len(bomb) < 100_000
    told = refusal(HEADER + chunk(bomb, 1000) + END, tmp_path)
    assert "no messages for sensor imu" in told
    assert "damaged" in told


def test_a_bomb_that_admits_its_size_is_refused(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor(level=19).compress(bytes(400 * 2**20))
    assert "refused" in refusal(HEADER + chunk(bomb, 400 * 2**20) + END, tmp_path)


def test_many_small_bombs_are_refused_by_their_sum(tmp_path: Path) -> None:
    bomb = zstandard.compress(bytes(2**24))
    data = HEADER + chunk(bomb, 2**24) * 2000 + END
    assert "uncompressed" in refusal(data, tmp_path)


def test_a_summary_that_tells_of_other_numbers_is_told(tmp_path: Path) -> None:
    write_foreign(tmp_path / "a.mcap", drive(5), enable_crcs=False)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    (at,) = [start for op, start, _ in kinds_at(bytes(data)) if op == Op.STATISTICS]
    counts = at + 9 + 46 + 2  # behind the frame, the fixed fields with the map's length, and a channel's id
    assert struct.unpack_from("<Q", data, counts) == (5,)
    data[counts] = 9
    found = read_bytes(bytes(data), tmp_path, topic_manifest(tmp_path))
    assert "the summary tells of 9 messages on /imu/data, 5 are there" in {w.what for w in found.warnings}


def test_chunks_without_a_wanted_topic_stay_closed(tmp_path: Path) -> None:
    topics = drive(6)
    quiet = {"/fix": topics["/fix"], "/imu/data": topics["/imu/data"]}
    camera = {
        "/camera": [(t - 10**12, message) for t, message in topics["/imu/data"]]
    }  # earlier: its own chunk
    write_foreign(tmp_path / "a.mcap", {**camera, **quiet}, chunk_size=2000)
    data = (tmp_path / "a.mcap").read_bytes()
    end = next(end for op, _, end in kinds_at(data) if op == Op.CHUNK)
    broken = data[: end - 20] + bytes(20) + data[end:]  # cannot be decompressed: opening it would be told
    found = read_bytes(broken, tmp_path, topic_manifest(tmp_path))
    assert found.warnings == ()
    assert {name: stream.t.size for name, stream in found.streams.items()} == {"imu": 6, "gps": 6}


@pytest.mark.parametrize(
    ("data", "how"),
    [
        (b"#ROSBAG V2.0\n", "rosbags-convert"),
        (b"SQLite format 3\0", "ros2 bag convert"),
        (b"\x28\xb5\x2f\xfd", "zstd -d"),
    ],
)
def test_other_recordings_are_refused_with_the_way_to_convert_them(
    data: bytes, how: str, tmp_path: Path
) -> None:
    assert how in refusal(data + bytes(100), tmp_path)


def test_names_out_of_a_file_cannot_break_a_line_or_fill_the_screen(tmp_path: Path) -> None:
    wild = record(
        Op.CHANNEL, struct.pack("<HH", 1, 0) + text("/a\nb\x1b[31m\u2028c") + text("cdr") + bytes(4)
    )
    told = refusal(HEADER + wild + END, tmp_path)
    assert told.isprintable()
    assert r"/a\nb\x1b[31m\u2028c" in told
    long = record(Op.CHANNEL, struct.pack("<HH", 1, 0) + text("/" + "x" * 10**6) + text("cdr") + bytes(4))
    assert len(refusal(HEADER + long + END, tmp_path)) < 1000


@pytest.mark.slow
def test_a_million_topics_take_bounded_time(tmp_path: Path) -> None:
    schema = record(
        Op.SCHEMA, struct.pack("<H", 1) + text("sensor_msgs/msg/Imu") + text("ros2msg") + text("")
    )
    channels = b"".join(
        record(
            Op.CHANNEL, struct.pack("<HH", i % 65536, 1) + text(f"/t{i}") + text("cdr") + struct.pack("<I", 0)
        )
        for i in range(1_000_000)
    )
    assert "defined twice, differently" in refusal(HEADER + schema + channels + END, tmp_path)


@pytest.mark.slow
def test_one_definition_over_and_over_takes_bounded_time(tmp_path: Path) -> None:
    again = record(Op.CHANNEL, struct.pack("<HH", 1, 0) + text("/t") + text("cdr") + struct.pack("<I", 0))
    assert "did you mean /t" in refusal(HEADER + again * 200_000 + END, tmp_path)


def test_an_unknown_compression_is_refused_by_name(tmp_path: Path) -> None:
    assert "'brotli'" in refusal(HEADER + chunk(b"1234", 4, "brotli") + END, tmp_path)


def test_a_message_without_channel_is_told(tmp_path: Path) -> None:
    message = record(Op.MESSAGE, struct.pack("<HIQQ", 7, 0, 0, 0) + b"data")
    assert "1 messages are of channel 7" in refusal(HEADER + message + END, tmp_path)


def test_a_message_shorter_than_its_head_is_refused(tmp_path: Path) -> None:
    assert "shorter than its 22 bytes" in refusal(HEADER + record(Op.MESSAGE, b"short") + END, tmp_path)


def test_a_hole_of_zeros_ends_the_log(tmp_path: Path) -> None:
    path = tmp_path / "sparse.mcap"
    with path.open("wb") as file:
        file.write(HEADER)
        file.truncate(10 * 2**30)
    start = time.process_time()
    with pytest.raises(LogError, match=r"no run.toml attached.*cut or damaged"):
        read_log(path)
    assert time.process_time() - start < 5.0


def test_messages_that_inflate_one_by_one_are_bounded(tmp_path: Path) -> None:
    bomb = zstandard.ZstdCompressor(level=19).compress(bytes(300 * 2**20))
    write_foreign(tmp_path / "a.mcap", drive(2), pack=lambda data: bomb, chunk_size=100)
    assert "refused" in refusal((tmp_path / "a.mcap").read_bytes(), tmp_path)


@given(body=st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_any_bytes_behind_the_magic_are_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, body: bytes
) -> None:
    path = tmp_path_factory.mktemp("fuzz") / "a.mcap"
    path.write_bytes(MAGIC + body)
    try:
        for _ in read_messages(open_recording(path), lambda channel: True):
            pass
    except McapError as error:
        assert_one_line(error)


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_a_foreign_log_with_changed_bytes_is_read_or_refused_in_one_line(
    data: Any, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("fuzz")
    path = folder / "a.mcap"
    write_foreign(path, drive(3), **BARE, use_chunking=False, enable_crcs=False)
    changed = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bytes(changed))
    try:
        log = read_log(path, topic_manifest(folder))
    except LogError as error:
        assert_one_line(error)
        return
    assert set(log.streams) == {"imu", "gps"}


def test_records_of_private_and_unknown_kinds_are_passed_over(
    log: FieldLog, whole: bytes, tmp_path: Path
) -> None:
    first = kinds_at(whole)[1][1]
    extra = record(0x80, b"private") + record(0x42, b"from the future")
    data = whole[:first] + extra + whole[first:]
    found = read_bytes(data, tmp_path)
    assert_same(log, found)


def test_the_crc_of_the_suite_is_that_of_zlib() -> None:
    assert zlib.crc32(b"123456789") == 0xCBF43926  # the check value of CRC-32/ISO-HDLC, as MCAP prescribes
