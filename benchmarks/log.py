"""Reading and writing 1,000,000 sensor_msgs/Imu: ours, others', and the floor that zstd alone sets.

    python benchmarks/log.py [--count 1000000] [--quick]

Each contestant runs in a process of its own, so that memory is its own; times are the best of three (one for
those that loop over messages in Python). Reading means columns: stamp, log time, specific force, angular
velocity of every message. `--quick` leaves out the slow ones.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
import time
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

TOPIC = "/imd1/imu"
WANTED_BYTES = 8 * (1 + 1 + 3 + 3)  # stamp, log time, two vectors: what a message leaves in the arrays


def make_stream(count: int) -> Any:
    """A noisy unit at 100 Hz: noise in the last digits is what compression meets in the field."""
    from smts_validate.sensors.streams import ImuStream

    rng = np.random.default_rng(7)
    t = 1.7e9 + np.arange(count) / 100.0
    force = rng.normal((0.0, 0.0, 9.8), 0.5, (count, 3))
    return ImuStream("imd1", t, t + 0.004, force, rng.normal(0.0, 0.1, (count, 3)))


def channels(stream: Any) -> Any:
    from smts_validate.sensors.log_topics import imu_channels

    return imu_channels("imd1", stream)


def write_ours(path: Path, count: int) -> None:
    from smts_validate.sensors.log import write_channels

    chosen = channels(make_stream(count))
    yield_time(lambda: write_channels(path, chosen))


def read_ours(path: Path, count: int) -> None:
    from smts_validate.sensors.log_collect import Topic, collect, take_imu
    from smts_validate.sensors.mcap_scan import open_recording

    def read() -> None:
        topics = {("imd1", "imu"): Topic(TOPIC, ("sensor_msgs/Imu",), take_imu)}
        found, faults = collect([open_recording(path)], topics)
        assert not faults
        assert len(found["imd1", "imu"]) == count

    yield_time(read)


def read_mcap_raw(path: Path, count: int) -> None:
    from mcap.reader import make_reader

    def read() -> None:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            assert sum(1 for _ in reader.iter_messages(log_time_order=False)) == count

    yield_time(read, 1)


def read_rosbags(path: Path, count: int) -> None:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    folder = path.parent / "rosbag2"
    make_rosbag2(folder, path, count)

    def read() -> None:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            stamps = np.empty(count)
            force = np.empty((count, 3))
            for i, (connection, _, raw) in enumerate(reader.messages()):
                message: Any = reader.deserialize(raw, connection.msgtype)
                stamps[i] = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
                a = message.linear_acceleration
                force[i] = a.x, a.y, a.z

    yield_time(read, 1)


def make_rosbag2(folder: Path, path: Path, count: int) -> None:
    """A rosbag2 folder around the log, which rosbags needs."""
    folder.mkdir(exist_ok=True)
    link = folder / path.name
    if not link.exists():
        link.symlink_to(path)
    text = f"""rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  duration: {{nanoseconds: 1}}
  starting_time: {{nanoseconds_since_epoch: 0}}
  message_count: {count}
  compression_format: ''
  compression_mode: ''
  relative_file_paths: [{path.name}]
  files: [{{path: {path.name}, starting_time: {{nanoseconds_since_epoch: 0}}, duration: {{nanoseconds: 1}},
           message_count: {count}}}]
  topics_with_message_count:
    - message_count: {count}
      topic_metadata: {{name: {TOPIC}, type: sensor_msgs/msg/Imu, serialization_format: cdr,
                        offered_qos_profiles: ''}}
"""
    (folder / "metadata.yaml").write_text(text)


def read_mcap_ros2(path: Path, count: int) -> None:
    from mcap_ros2.reader import read_ros2_messages

    def read() -> None:
        stamps = np.empty(count)
        force = np.empty((count, 3))
        for i, message in enumerate(read_ros2_messages(str(path), log_time_order=False)):
            stamps[i] = message.ros_msg.header.stamp.sec + 1e-9 * message.ros_msg.header.stamp.nanosec
            a = message.ros_msg.linear_acceleration
            force[i] = a.x, a.y, a.z

    yield_time(read, 1)


def floor_read(path: Path, count: int) -> None:
    packed = [pack for pack, _ in chunks(path)]
    yield_time(lambda: [zstandard.ZstdDecompressor().decompress(pack) for pack in packed])


def floor_read_crc(path: Path, count: int) -> None:
    packed = [pack for pack, _ in chunks(path)]
    yield_time(lambda: [zlib.crc32(zstandard.ZstdDecompressor().decompress(pack)) for pack in packed])


def floor_write(path: Path, count: int) -> None:
    plain = [zstandard.ZstdDecompressor().decompress(pack) for pack, _ in chunks(path)]
    yield_time(lambda: [zstandard.ZstdCompressor(level=1).compress(each) for each in plain])


def chunks(path: Path) -> list[tuple[bytes, int]]:
    from smts_validate.sensors.mcap_scan import open_recording

    recording = open_recording(path)
    return [
        (recording.data[chunk.start : chunk.start + chunk.size].tobytes(), chunk.uncompressed_size)
        for chunk in recording.chunks
    ]


_RESULT: dict[str, float] = {}


def yield_time(work: Callable[[], object], repeats: int = 3) -> None:
    """Best time of a few, and how far the work raised the process's memory at its peak."""
    times = []
    Path("/proc/self/clear_refs").write_text("5")  # the peak (VmHWM) starts again from here
    before = peak_memory()
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    _RESULT.update(time=min(times), memory=peak_memory() - before)


def peak_memory() -> float:
    """Peak resident bytes of this process (Linux)."""
    text = Path("/proc/self/status").read_text()
    return 1024.0 * float(text.split("VmHWM:")[1].split()[0])


def _job(work: Callable[[Path, int], None], path: Path, count: int, pipe: Any) -> None:
    work(path, count)
    pipe.send(dict(_RESULT))


def measure(work: Callable[[Path, int], None], path: Path, count: int) -> dict[str, float]:
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_job, args=(work, path, count, there))
    process.start()
    there.close()  # so that a failure over there ends the waiting here
    process.join()
    result: dict[str, float] = here.recv()
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--quick", action="store_true", help="leave out those that loop in Python")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        report(Path(folder) / "log.mcap", options.count, options.quick)


def report(path: Path, count: int, quick: bool) -> None:
    ours = measure(write_ours, path, count)
    print(f"{count} sensor_msgs/Imu, {path.stat().st_size / 1e6:.1f} MB as MCAP with zstd and CRCs")
    write_floor = measure(floor_write, path, count)["time"]
    read_floor = measure(floor_read, path, count)["time"]
    arrays = WANTED_BYTES * count
    print(f"{'':34}{'s':>9}{'x floor':>10}{'x arrays':>10}")
    line("write: zstd alone, one thread", write_floor, write_floor)
    line("write: ours", ours["time"], write_floor, ours["memory"] / arrays)
    line("read: zstd alone, one thread", read_floor, read_floor)
    line("read: zstd and CRC, one thread", measure(floor_read_crc, path, count)["time"], read_floor)
    found = measure(read_ours, path, count)
    line("read: ours, CRCs checked", found["time"], read_floor, found["memory"] / arrays)
    if not quick:
        line("read: mcap, raw iteration", measure(read_mcap_raw, path, count)["time"], read_floor)
        line("read: rosbags, decoded", measure(read_rosbags, path, count)["time"], read_floor)
        line("read: mcap-ros2-support, decoded", measure(read_mcap_ros2, path, count)["time"], read_floor)


def line(name: str, seconds: float, floor: float, memory: float | None = None) -> None:
    print(f"{name:34}{seconds:9.3f}{seconds / floor:10.2f}" + ("" if memory is None else f"{memory:10.2f}"))


if __name__ == "__main__":
    main()
