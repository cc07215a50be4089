"""What is fuzzed: one function a parser, from bytes to its answer or its named refusal."""

from __future__ import annotations

import datetime as dt
import os
import sys
import tempfile
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["smts_validate"]):
    import numpy as np
    from smts_validate.sensors import manifest
    from smts_validate.sensors.formats import FORMATS, imu_csv, nmea, speed_csv, steer_csv
    from smts_validate.sensors.manifest import Gps, Imd, ManifestError, Speed, Steer, Units
    from smts_validate.sensors.raw import RawError, RawGnss, RawImu

DATE = dt.date(2025, 5, 14)
IMD = Imd(kind="imd", body="tractor", file="x", position=(0.0, 0.0, 0.0), rate=100.0)
STEERS = tuple(
    Steer(kind="steer", file="x", rate=50.0, columns=columns, units=units)
    for columns, units in (
        ({}, Units()),
        ({"t_host_ns": "Time", "angle": "Angle"}, Units(host_time="s", angle="deg")),
    )
)
SPEEDS = tuple(
    Speed(kind="speed", file="x", rate=20.0, columns=columns, units=units)
    for columns, units in (
        ({}, Units()),
        ({"t_host_ns": "Time", "speed": "RL"}, Units(host_time="ms", speed="rpm")),
    )
)
GPS = Gps(kind="gps", file="x", position=(0.0, 0.0, 0.0), rate=10.0)
MEMORY = Path("/dev/shm") if Path("/dev/shm").is_dir() else Path(tempfile.gettempdir())
SCRATCH = Path(tempfile.mkdtemp(prefix="fuzz-", dir=MEMORY))


def one_line(error: Exception) -> None:
    """A refusal is one line that a person can read."""
    text = str(error)
    if "\n" in text or not text or len(text) > 2000:
        raise AssertionError(f"a refusal of {len(text)} characters, or of several lines")


def check_gnss(raw: RawGnss) -> None:
    """What every reader of GNSS promises."""
    lat, lon = raw.values["lat"], raw.values["lon"]
    known = np.isfinite(lat)
    assert np.isfinite(raw.utc).all()
    assert (np.diff(raw.utc) > 0.0).all()
    assert (np.abs(lat[known]) <= 90.0).all()
    assert (np.abs(lon[known]) <= 360.0).all()
    assert all(value.shape == raw.utc.shape for value in raw.values.values())


def fuzz_nmea(data: bytes) -> None:
    """The NMEA reader."""
    try:
        raw = nmea.parse(data, "gps.nmea", "gps", DATE)
    except RawError as error:
        one_line(error)
    else:
        check_gnss(raw)
        assert raw.rejected_count == sum(raw.reasons.values())


def fuzz_csv(data: bytes) -> None:
    """The inertial CSV reader, with all its dialects."""
    path = SCRATCH / "imd.csv"
    path.write_bytes(data)
    try:
        raw: RawImu = imu_csv.read(path, IMD, "imd1", DATE)
    except RawError as error:
        one_line(error)
    else:
        assert np.isfinite(raw.specific_force).all()
        assert np.isfinite(raw.angular_velocity).all()
        assert raw.host_ns.shape == raw.rows.shape


def fuzz_gnss(data: bytes) -> None:
    """Every other reader of receivers' files, and those of loggers with a layout of their own."""
    path = SCRATCH / "any.log"
    path.write_bytes(data)
    for sensor in (GPS, IMD):
        for form in FORMATS:
            if form in (nmea, imu_csv) or not form.reads(sensor, path, data[:4096]):
                continue
            try:
                raw = form.read(path, sensor, "name", DATE)
            except RawError as error:
                one_line(error)
            else:
                if isinstance(raw, RawGnss):
                    check_gnss(raw)


def fuzz_bus(data: bytes) -> None:
    """Steering and speed as a bus's export holds them, with standard columns and renamed ones."""
    path = SCRATCH / "bus.csv"
    path.write_bytes(data)
    for form, sensors, least in ((steer_csv, STEERS, np.pi / 2), (speed_csv, SPEEDS, 150.0)):
        for sensor in sensors:
            try:
                raw = form.read(path, sensor, "name", DATE)
            except RawError as error:
                one_line(error)
            else:
                values = raw.angle if form is steer_csv else raw.speed
                assert (np.abs(values) <= least).all()
                assert raw.host_ns.shape == raw.rows.shape == values.shape


def fuzz_manifest(data: bytes) -> None:
    """run.toml."""
    try:
        found = manifest.parse(data.decode("utf-8", "replace"))
    except ManifestError as error:
        one_line(error)
    else:
        for sensor in found.sensors.values():
            assert sensor.file is None or ".." not in Path(sensor.file).parts


TARGETS = {
    "nmea": fuzz_nmea,
    "csv": fuzz_csv,
    "gnss": fuzz_gnss,
    "bus": fuzz_bus,
    "manifest": fuzz_manifest,
}


def main() -> None:
    """`targets.py NAME CORPUS... [libFuzzer options]`."""
    name = sys.argv.pop(1)
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    atheris.Setup(sys.argv, TARGETS[name])
    atheris.Fuzz()


if __name__ == "__main__":
    main()
