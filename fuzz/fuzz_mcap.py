"""Fuzz the reading of MCAP logs: whatever the bytes, a pass or a refusal in one line, in bounded time.

    python fuzz/fuzz_mcap.py [libFuzzer options] [corpus folder ...]

Without a corpus folder the seeds in fuzz/corpus/mcap are used, and what is found goes into a temporary one;
`--seeds` writes the seeds again.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["smts_validate.sensors"]):
    import numpy as np
    from smts_validate.sensors import manifest
    from smts_validate.sensors.cdr import message_type, serialise
    from smts_validate.sensors.draft_text import MACHINE
    from smts_validate.sensors.log import Attachment, Channel, LogError, messages, write_channels
    from smts_validate.sensors.log_read import streams_of
    from smts_validate.sensors.mcap_records import McapError
    from smts_validate.sensors.mcap_scan import scan
    from smts_validate.sensors.ros_messages import definition

CORPUS = Path(__file__).resolve().parent / "corpus" / "mcap"
NAME = Path("fuzzed.mcap")
MANIFEST = (
    """schema = 1
[run]
id = "f"
date = 2025-05-14
[operating]
speed = 2.8
tyre_pressure_mpa = 0.12
"""
    + MACHINE
    + """[sensors.i]
kind = "imd"
body = "tractor"
topic = "/i/imu"
position = [0.0, 0.0, 0.0]
rate = 10.0
[sensors.g]
kind = "gps"
topic = "/g/fix"
position = [0.0, 0.0, 0.5]
rate = 10.0
[sensors.s]
kind = "steer"
topic = "/s"
rate = 10.0
[sensors.o]
kind = "speed"
topic = "/o"
rate = 10.0
"""
)
GIVEN = (manifest.parse(MANIFEST), MANIFEST)


def read(data: bytes) -> None:
    """Read a log with a manifest given and with its own; anything but a refusal in one line is a finding."""
    for given in (GIVEN, None):
        try:
            recording = scan(NAME, np.frombuffer(data, np.uint8))
            streams_of(NAME, [recording], given)
        except (LogError, McapError) as error:
            if len(str(error).splitlines()) != 1:
                raise AssertionError(f"not one line: {error}") from None


def _plain(path: Path, chunked: bool, endings: bool) -> bytes:
    """A small log without compression and checksums, which a fuzzer could not get past."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        writer = Writer(
            file,
            compression=CompressionType.NONE,
            use_chunking=chunked,
            enable_crcs=False,
            use_statistics=endings,
            use_summary_offsets=endings,
            repeat_channels=endings,
            repeat_schemas=endings,
        )
        writer.start("ros2", "f")
        for topic, name, values in _topics():
            schema = writer.register_schema(name, "ros2msg", definition(name).encode())
            channel = writer.register_channel(topic, "cdr", schema)
            for i, payload in enumerate(values):
                writer.add_message(channel, i, payload, i)
        if endings:
            writer.add_attachment(0, 0, "run.toml", "", MANIFEST.encode())
        writer.finish()
    return path.read_bytes()


def _topics() -> list[tuple[str, str, list[bytes]]]:
    def two(name: str, first: dict[str, object], second: dict[str, object]) -> list[bytes]:
        kind = message_type(name, definition(name))
        return [
            serialise(kind, {"header": {"stamp": {"sec": i}}, **v}) for i, v in enumerate((first, second), 1)
        ]

    names: dict[str, object] = {"name": ["steering", "b"], "position": [0.1, 0.2]}
    return [
        ("/i/imu", "sensor_msgs/msg/Imu", two("sensor_msgs/msg/Imu", {}, {})),
        ("/g/fix", "sensor_msgs/msg/NavSatFix", two("sensor_msgs/msg/NavSatFix", {}, {"latitude": 5.0})),
        ("/o", "nav_msgs/msg/Odometry", two("nav_msgs/msg/Odometry", {}, {"child_frame_id": "base"})),
        ("/s", "sensor_msgs/msg/JointState", two("sensor_msgs/msg/JointState", names, {"name": []})),
    ]


def write_seeds(folder: Path) -> None:
    """Seeds: with and without chunks and summary, and one of ours with checksums and zstd."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "a.mcap"
        for chunked in (True, False):
            for endings in (True, False):
                data = _plain(path, chunked, endings)
                (folder / f"plain-{chunked:d}{endings:d}.mcap").write_bytes(data)
        column = messages("std_msgs/msg/Float64", {}, {"data": np.arange(3.0)})
        channel = Channel("/x", "std_msgs/msg/Float64", np.arange(3), column)
        write_channels(
            path, [channel], [Attachment("run.toml", "", MANIFEST.encode())], {"smts.run": {"id": "f"}}
        )
        (folder / "ours.mcap").write_bytes(path.read_bytes())


def main() -> None:
    if "--seeds" in sys.argv:
        write_seeds(CORPUS)
        return
    with tempfile.TemporaryDirectory() as found:
        folders = [] if any(not each.startswith("-") for each in sys.argv[1:]) else [found, str(CORPUS)]
        atheris.Setup([*sys.argv, *folders], read)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
