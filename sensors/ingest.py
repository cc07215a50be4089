"""A raw pass's folder -> FieldLog: manifest, every file, clocks reconciled, health."""

from __future__ import annotations

import datetime as dt
import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from . import clocks, manifest
from .checks import rows_of
from .clocks import ClockError, HostToUtc, SampleTimes
from .formats import FORMATS
from .health import health_of, hint_warnings
from .manifest import UNDATED, Machine, Manifest, Sensor, Speed
from .raw import Floats, Ints, Raw, RawError, RawGnss, RawImu, RawSpeed, RawSteer
from .streams import FieldLog, GnssStream, ImuStream, SpeedStream, SteerStream, Stream, Warn, WheelStream
from .tables import read_head
from .utc import steady_epochs, utc_map

MANIFEST = "run.toml"
YEAR_1980 = 315_532_800.0  # s since the epoch: before it there was no GPS


class IngestError(ValueError):
    """A raw pass that cannot be used; one line: what, where (file, row), how to mend it."""


def read_pass(folder: Path) -> FieldLog:
    """The pass in a folder: `run.toml` and the files that it names.

    Raises IngestError or ManifestError : one line, with file and row.
    """
    run, text = manifest.read(folder / MANIFEST)
    try:
        paths = {name: source_path(folder, name, sensor) for name, sensor in run.sensors.items()}
        raws = {name: _read(paths[name], run.sensors[name], name, run) for name in paths}
        return _assemble(_dated(run, paths, raws), text, folder, paths, raws)
    except RawError as error:
        raise IngestError(f"{folder.name}/{error}") from None


def source_path(folder: Path, name: str, sensor: Sensor) -> Path:
    """A sensor's file, which must be a file in the pass's folder, links followed.

    Raises RawError : it is missing, or leads out of the folder.
    """
    if sensor.file is None:
        raise RawError(f"{MANIFEST}: sensors.{name} has a `topic`, but a raw pass's folder needs its `file`")
    path = folder / sensor.file.replace("\\", "/")
    try:
        real = path.resolve(strict=True)
    except (OSError, RuntimeError):
        raise RawError(f"{sensor.file}: is not there; sensors.{name} of {MANIFEST} names it") from None
    if not real.is_relative_to(folder.resolve()):
        raise RawError(f"{sensor.file}: leads out of the pass's folder; copy the file into it")
    return path


def _read(path: Path, sensor: Sensor, name: str, run: Manifest) -> Raw:
    head = read_head(path)
    for candidate in FORMATS:
        if candidate.reads(sensor, path, head):
            raw: Raw = candidate.read(path, sensor, name, run.run.date)
            return raw
    raise RawError(f"{path.name}: no known format for a sensor of this kind; see docs/formats.md")


def _dated(run: Manifest, paths: Mapping[str, Path], raws: dict[str, Raw]) -> Manifest:
    """The manifest with the day that a receiver tells, where run.toml has none.

    Receivers that tell none themselves are read again with it. Raises RawError : none tells one.
    """
    if run.run.date != UNDATED:
        return run
    days = {name: _first_day(raw) for name, raw in raws.items() if isinstance(raw, RawGnss)}
    known = [day for day in days.values() if day > UNDATED]
    if not known:
        raise RawError(
            f"{MANIFEST}: run.date is missing, and {paths[next(iter(days))].name} tells no date (NMEA: in RMC "
            "or ZDA); enter date = YYYY-MM-DD, the UTC day of the pass's start"
        )
    run = run.dated(known[0])
    for name in (name for name, day in days.items() if day == UNDATED):
        raws[name] = _read(paths[name], run.sensors[name], name, run)
    return run


def _first_day(raw: RawGnss) -> dt.date:
    """UTC day of a receiver's first position; UNDATED where it only tells the time of day."""
    placed = raw.utc[np.isfinite(raw.values["lat"])]
    first = float(placed[0]) if placed.size else 0.0
    return dt.datetime.fromtimestamp(first, dt.UTC).date() if first > YEAR_1980 else UNDATED


def _assemble(
    run: Manifest, text: str, folder: Path, paths: Mapping[str, Path], raws: dict[str, Raw]
) -> FieldLog:
    base = _base_ns(raws.values())
    timed, warnings, facts = _host_times(run, raws, base)
    gnss_warnings = _steady(run, raws, base)
    to_utc, map_warnings, clock = utc_map(run, raws, timed, base)
    found = [warning for raw in raws.values() for warning in raw.warnings]
    streams: dict[str, Stream] = {}
    for name in tuple(raws):
        raw = raws.pop(name)  # an hour's raw samples and streams do not stand in memory together
        if isinstance(raw, RawGnss):
            streams[name] = _gnss(name, raw, to_utc, base)
        else:
            streams[name] = _stream(run, name, raw, timed.pop(name), to_utc, base)
    log = FieldLog(
        manifest=run,
        manifest_text=text,
        streams=streams,
        warnings=tuple(found + warnings + gnss_warnings + map_warnings),
        source=str(folder),
        sha256=_digest([folder / MANIFEST, *paths.values()]),
    )
    health = health_of(log, facts | {"clock": clock})
    files = {name: sensor.file for name, sensor in run.sensors.items()}
    return replace(log, health=health, warnings=log.warnings + hint_warnings(health, files))


def _steady(run: Manifest, raws: dict[str, Raw], base: int) -> list[Warn]:
    """Replace each receiver's epochs by those whose time can be true, arrivals without jumps."""
    warnings: list[Warn] = []
    for name, sensor in run.of_kind("gps").items():
        raw = raws[name]
        if isinstance(raw, RawGnss):
            raws[name], found = steady_epochs(name, sensor, raw, base)
            warnings += found
    return warnings


def _base_ns(raws: Iterable[Raw]) -> int:
    """A whole second near the start of the host's times, so that float64 seconds from it keep nanoseconds."""
    starts = [int(np.median(raw.host_ns)) for raw in raws if raw.host_ns is not None and raw.host_ns.size]
    if not starts:
        raise RawError(f"{MANIFEST}: no file holds a time of the logger")
    return min(starts) // 10**9 * 10**9


def _seconds(host_ns: Ints, base: int) -> Floats:
    return np.asarray((host_ns - base) * 1.0e-9)


def _host_times(
    run: Manifest, raws: Mapping[str, Raw], base: int
) -> tuple[dict[str, SampleTimes], list[Warn], dict[str, Any]]:
    timed: dict[str, SampleTimes] = {}
    warnings: list[Warn] = []
    facts: dict[str, Any] = {}
    for name, raw in raws.items():
        if isinstance(raw, RawGnss):
            continue
        file = str(run.sensors[name].file)
        times = _sample_times(raw, run.sensors[name].rate, base, file)
        timed[name] = times
        warnings += _clock_warnings(times, raw.rows, name, file)
        facts[name] = _clock_facts(times)
    return timed, warnings, facts


def _sample_times(raw: RawImu | RawSteer | RawSpeed, rate: float, base: int, file: str) -> SampleTimes:
    host = _seconds(raw.host_ns, base)
    try:
        if isinstance(raw, RawSteer | RawSpeed):
            values = raw.angle if isinstance(raw, RawSteer) else raw.speed
            again = np.diff(values, prepend=np.nan) == 0.0
            return clocks.sample_times(host, None, None, rate, repeats=again)
        readings = np.hstack([raw.specific_force, raw.angular_velocity])
        again = (np.diff(readings, axis=0, prepend=np.nan) == 0.0).all(axis=1)
        return clocks.sample_times(host, raw.counter, raw.seq, rate, raw.tick, raw.span, again)
    except ClockError as error:
        where = f"{file}, row {raw.rows[error.row]}" if error.row is not None else file
        raise RawError(f"{where}: {error}") from None


def _clock_warnings(times: SampleTimes, rows: Ints, name: str, file: str) -> list[Warn]:
    found = []
    for where, what, effect in (
        (times.doubled, "doubled", "the first of each is used"),
        (times.disordered, "out of order", "sorted by time"),
        (times.strange, "whose clocks contradict each other", "dropped"),
    ):
        if where.size:
            found.append(Warn(f"{rows_of(where.size)} {what}", effect, name, file, int(rows[where[0]])))
    step = np.diff(times.t)
    longest = int(np.argmax(step)) if step.size else 0
    after = int(rows[times.index[longest + 1]]) if step.size else None
    if times.lost:
        what = f"{rows_of(times.lost, 'sample')} lost"
        found.append(Warn(what, f"left as gaps, the longest {step[longest]:.3f} s", name, file, after))
    for row in times.resets.tolist():
        found.append(
            Warn("the unit's counter was reset", "fitted anew from there", name, file, int(rows[row]))
        )
    for row, size in times.host_jumps:
        what = f"the logger's clock jumped by {size:.3f} s"
        found.append(Warn(what, "taken out", name, file, int(rows[row])))
    return found


def _clock_facts(times: SampleTimes) -> dict[str, Any]:
    latency = times.host - times.t
    return {
        "drift_ppm": None if np.isnan(times.drift) else 1.0e6 * times.drift,
        "latency_ms": 1.0e3 * float(np.median(latency)),
        "latency_above_least_ms": {
            "median": 1.0e3 * float(np.median(latency)),
            "p99": 1.0e3 * float(np.percentile(latency, 99)),
        },
        "doubled": int(times.doubled.size),
        "disordered": int(times.disordered.size),
        "lost": times.lost,
        "counter_wraps": times.wraps,
        "counter_resets": int(times.resets.size),
        "host_jumps": len(times.host_jumps),
    }


def _stream(run: Manifest, name: str, raw: Raw, times: SampleTimes, to_utc: HostToUtc, base: int) -> Stream:
    epoch = base * 1.0e-9
    t = to_utc(times.t - clocks.IMU_LEAST_LATENCY) + epoch
    arrival = to_utc(times.host) + epoch
    at = times.index
    if isinstance(raw, RawSteer):
        return SteerStream(name, t, arrival, raw.angle[at])
    if isinstance(raw, RawSpeed):
        scale = _radius(run.machine, run.sensors[name]) if raw.turning else 1.0
        return SpeedStream(name, t, arrival, raw.speed[at] * scale)
    assert isinstance(raw, RawImu)
    made = WheelStream if run.sensors[name].kind == "wds" else ImuStream
    mag = None if raw.magnetic_field is None else raw.magnetic_field[at]
    return made(name, t, arrival, raw.specific_force[at], raw.angular_velocity[at], mag)


def _radius(machine: Machine, sensor: Sensor) -> float:
    """Rolling radius (m) of the wheel whose rotation a speed sensor tells; without a wheel a rear one's."""
    front = isinstance(sensor, Speed) and sensor.wheel is not None and sensor.wheel.startswith("front")
    return machine.tractor.front_wheel_radius if front else machine.tractor.rear_wheel_radius


def _gnss(name: str, raw: RawGnss, to_utc: HostToUtc, base: int) -> GnssStream:
    epoch = base * 1.0e-9
    arrival = raw.utc if raw.host_ns is None else to_utc(_seconds(raw.host_ns, base)) + epoch
    return GnssStream(name, raw.utc, arrival, **raw.values)


def _digest(paths: Iterable[Path]) -> str:
    total = hashlib.sha256()
    for path in sorted(set(paths)):
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()
