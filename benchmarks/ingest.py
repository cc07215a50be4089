"""How long a raw pass takes to become a log, and how much memory: an hour of nine sensors at 100 Hz.

    python benchmarks/ingest.py [--minutes 60] [--sensors 9] [--folder KEEP]

Prints the time of each part, by the clock and of the processor (which a busy machine does not stretch), the peak of
memory, and NMEA sentences a second.
"""

from __future__ import annotations

import argparse
import datetime as dt
import multiprocessing
import resource
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from smts_validate.sensors.draft_text import HEAD, MACHINE
from smts_validate.sensors.formats import imu_csv, nmea
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.log import write_log
from smts_validate.sensors.manifest import Imd

START = dt.datetime(2025, 5, 14, 10, 0, 0, tzinfo=dt.UTC).timestamp()
IMD = """[sensors.imd{0}]
kind = "imd"
body = "tractor"
file = "imd{0}.csv"
position = [0.3, 0.0, -0.2]
rate = 100.0
"""
GPS = '[sensors.gps]\nkind = "gps"\nfile = "gps.nmea"\nposition = [0.0, 0.0, 2.1]\nrate = 10.0\n'


def write_unit(path: Path, seconds: int, seed: int) -> None:
    """One unit's CSV: counter with drift, gamma latencies, quantised noise."""
    rng = np.random.default_rng(seed)
    n = seconds * 100
    t = np.arange(n) / 100.0
    host = np.rint((START + 2.2 + t + 1e-3 + rng.gamma(1.2, 3e-3, n)) * 1e9).astype(np.int64)
    counter = (seed * 10**8 + np.rint(t * (1.0 + 1e-5 * seed) * 1e6).astype(np.int64)) % 2**32
    frame = pd.DataFrame({"t_host_ns": np.maximum.accumulate(host), "t_dev_us": counter})
    frame["seq"] = np.arange(n) % 2**16
    for axes, scale, digits in ((("ax", "ay", "az"), 0.3, 4), (("gx", "gy", "gz"), 0.05, 6)):
        for axis in axes:
            frame[axis] = np.round(rng.normal(9.81 if axis == "az" else 0.0, scale, n), digits)
    for axis in ("mx", "my", "mz"):
        frame[axis] = np.round(rng.normal(2e-5, 1e-6, n), 9)
    frame.to_csv(path, index=False)


def checked(body: str) -> str:
    """A sentence with `$` and checksum."""
    total = 0
    for letter in body:
        total ^= ord(letter)
    return f"${body}*{total:02X}"


def write_gps(path: Path, seconds: int) -> int:
    """GGA, RMC, VTG and GST ten times a second; returns the number of sentences."""
    rng = np.random.default_rng(99)
    delay = rng.gamma(2.0, 0.02, seconds * 10)
    lines = []
    for k in range(seconds * 10):
        moment = dt.datetime.fromtimestamp(START + k / 10, tz=dt.UTC)
        clock = f"{moment:%H%M%S}.{k % 10}0"
        place = f"5002.{k % 10**8:08d},N,03629.42457123,E"
        for order, body in enumerate(
            (
                f"GNGGA,{clock},{place},4,16,0.86,135.608,M,16.000,M,1.2,0001",
                f"GNRMC,{clock},A,{place},4.860,90.0,140525,,,R",
                "GNVTG,90.0,T,,M,4.860,N,9.001,K,R",
                f"GNGST,{clock},0.017,0.013,0.013,0.0,0.013,0.013,0.026",
            )
        ):
            stamp = round((START + 2.3 + k / 10 + delay[k] + 0.007 * order) * 1e9)
            lines.append(f"{stamp} {checked(body)}\r\n")
    path.write_text("".join(lines))
    return len(lines)


def write_pass(folder: Path, seconds: int, sensors: int) -> int:
    """The whole raw pass; returns the number of NMEA sentences."""
    units = "".join(IMD.format(k) for k in range(sensors))
    text = HEAD.format(id="long", date="2025-05-14") + MACHINE + units + GPS
    (folder / "run.toml").write_text(text)
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        pool.starmap(write_unit, [(folder / f"imd{k}.csv", seconds, k) for k in range(sensors)])
    return write_gps(folder / "gps.nmea", seconds)


def measure(folder: Path, sensors: int, sentences: int) -> None:
    """Print the time of one file of each kind, of the whole pass, and the peak of memory."""
    date = dt.date(2025, 5, 14)
    unit = Imd(kind="imd", body="tractor", file="imd0.csv", position=(0.0, 0.0, 0.0), rate=100.0)
    raw, _, busy = timed("one CSV", lambda: imu_csv.read(folder / "imd0.csv", unit, "imd0", date))
    print(f"  {raw.host_ns.size / busy / 1e6:5.2f} million rows a second of processor")
    _, _, busy = timed("gps.nmea", lambda: nmea.read(folder / "gps.nmea", unit, "gps", date))
    print(f"  {sentences / busy / 1e3:5.0f} thousand sentences a second of processor")
    log, read, _ = timed(f"files of {sensors} sensors to streams", lambda: read_pass(folder))
    print(f"  {sum(stream.t.size for stream in log.streams.values())} samples")
    _, written, _ = timed("streams to log", lambda: write_log(folder / "long.mcap", log))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"files to log {read + written:.1f} s (asked: under 25), peak {peak:.2f} GiB (asked: under 1.5)")


def timed(what: str, work: Callable[[], Any]) -> tuple[Any, float, float]:
    """What `work` gives, the seconds that passed, and those of the processor (all threads); printed."""
    start, begun = time.perf_counter(), time.process_time()
    result = work()
    spent, busy = time.perf_counter() - start, time.process_time() - begun
    print(f"{what:32s} {spent:6.2f} s, processor {busy:6.2f} s")
    return result, spent, busy


def main() -> None:
    """Write a pass, measure, remove it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=int, default=60)
    parser.add_argument("--sensors", type=int, default=9)
    parser.add_argument("--folder", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.folder or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        sentences = write_pass(folder, options.minutes * 60, options.sensors)
        measure(folder, options.sensors, sentences)


if __name__ == "__main__":
    main()
