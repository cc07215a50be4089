"""One map from the logger's clock to UTC for a whole pass."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
from scipy.ndimage import median_filter

from . import clocks
from .alignment import AlignmentError, Offset, motion_offset
from .checks import rows_of
from .clocks import ClockLine, HostToUtc, SampleTimes
from .geodesy import to_enu
from .manifest import Gps, Imd, Manifest
from .mounting import mounting_matrix, turned
from .raw import Floats, Raw, RawError, RawGnss, RawImu
from .streams import Warn

STRANGE = 30.0  # s: no latency lasts so long, so a time that is further from its arrival is wrong


def utc_map(
    run: Manifest, raws: Mapping[str, Raw], timed: Mapping[str, SampleTimes], base: int
) -> tuple[HostToUtc, list[Warn], dict[str, Any]]:
    """The logger's clock against UTC, both in seconds from `base` (ns); warnings; findings for the health.

    From the arrivals of the first GPS log that has host times; without one, from the motion.

    Raises RawError : there are no host times, and the motion does not tell the offset.
    """
    receivers: dict[str, Gps] = run.of_kind("gps")
    for name, sensor in receivers.items():
        raw = raws[name]
        if isinstance(raw, RawGnss) and raw.host_ns is not None:
            return _from_arrivals(name, sensor, raw, base)
    name, sensor = next(iter(receivers.items()))
    return _from_motion(run, name, sensor, raws, timed, base)


def steady_epochs(name: str, sensor: Gps, raw: RawGnss, base: int) -> tuple[RawGnss, list[Warn]]:
    """A receiver's epochs with jumps of the logger's clock taken out of their arrival.

    Epochs whose time is not that of their arrival are left out: a receiver without a fix may send any time,
    and a sound checksum does not make a time right.

    Raises RawError : no epoch has a position.
    """
    if raw.host_ns is None:
        return raw, []
    order = np.argsort(raw.rows, kind="stable")  # as they arrived
    host = np.asarray((raw.host_ns[order] - base) * 1.0e-9)
    offset = host - (raw.utc[order] - base * 1.0e-9)
    placed = np.isfinite(raw.values["lat"][order])
    if not placed.any():
        raise RawError(f"{sensor.file}: no epoch has a position")
    telling = np.flatnonzero(placed)
    telling = telling[np.abs(offset[telling] - median_filter(offset[telling], 9, mode="nearest")) < STRANGE]
    _, jumps = clocks.steady_host(host[telling], (host - offset)[telling], sensor.rate)
    steady = clocks.without_jumps(host, [(int(telling[row]), size) for row, size in jumps])
    usual = float(np.median((steady - host + offset)[telling]))
    agree = np.abs(steady - host + offset - usual) < STRANGE
    file = str(sensor.file)
    lines = raw.rows[order]
    warnings = [
        Warn(f"the logger's clock jumped by {size:.3f} s", "taken out", name, file, int(lines[telling[row]]))
        for row, size in jumps
    ]
    if not agree.all():
        what = f"{rows_of(int(np.count_nonzero(~agree)), 'epoch')} whose time is not that of their arrival"
        warnings.append(Warn(what, "dropped", name, file, int(lines[np.argmin(agree)])))
    kept = np.sort(order[agree])
    stamps = np.empty(order.size, dtype=np.int64)
    stamps[order] = np.rint(steady * 1.0e9).astype(np.int64) + base
    values = {key: value[kept] for key, value in raw.values.items()}
    return replace(raw, utc=raw.utc[kept], host_ns=stamps[kept], rows=raw.rows[kept], values=values), warnings


def _from_arrivals(
    name: str, sensor: Gps, raw: RawGnss, base: int
) -> tuple[HostToUtc, list[Warn], dict[str, Any]]:
    assert raw.host_ns is not None
    placed = np.isfinite(raw.values["lat"])
    host = np.asarray((raw.host_ns[placed] - base) * 1.0e-9)
    found = clocks.host_to_utc(host, raw.utc[placed] - base * 1.0e-9, sensor.latency)
    facts = {
        "source": f"arrival of {name}'s sentences",
        "host_minus_utc_s": float(found.line(np.array([host.mean()]))[0]) - found.latency,
        "host_minus_utc_sd_s": sensor.latency_sd,
        "host_drift_ppm": 1.0e6 * found.line.slope,
        "assumed_gnss_latency_s": sensor.latency,
        "assumed_imu_least_latency_s": clocks.IMU_LEAST_LATENCY,
    }
    return found, [], facts


def _from_motion(
    run: Manifest,
    name: str,
    sensor: Gps,
    raws: Mapping[str, Raw],
    timed: Mapping[str, SampleTimes],
    base: int,
) -> tuple[HostToUtc, list[Warn], dict[str, Any]]:
    gnss = raws[name]
    unit = next((key for key, imd in run.of_kind("imd").items() if imd.body == sensor.body), None)
    if unit is None or not isinstance(gnss, RawGnss):
        raise RawError(f"{sensor.file}: no logger's time in front of the sentences, and no IMD on its body")
    try:
        found = _offset(run, sensor, gnss, unit, raws[unit], timed[unit], base)
    except AlignmentError as error:
        raise RawError(
            f"{sensor.file}, row {gnss.rows[0]}: no logger's time in front of the sentences, and the motion "
            f"does not tell the offset ({error}); log the time with each sentence, or record some turning"
        ) from None
    line = ClockLine(0.0, found.value - clocks.IMU_LEAST_LATENCY, 0.0, 0.0)
    what = "no logger's time in front of the sentences"
    effect = f"offset {found.value:.3f} s found from the motion, to {found.sd:.3f} s"
    return (
        HostToUtc(line, 0.0),
        [Warn(what, effect, name, sensor.file)],
        {
            "source": f"turning of {unit} against the course of {name}",
            "host_minus_utc_s": found.value,
            "host_minus_utc_sd_s": found.sd,
            "explained_by_motion": found.explained,
            "host_drift_ppm": 0.0,
        },
    )


def _offset(
    run: Manifest, sensor: Gps, gnss: RawGnss, unit: str, raw: Raw, times: SampleTimes, base: int
) -> Offset:
    """The offset from one unit's angular velocity and the antenna's course."""
    assert isinstance(raw, RawImu)
    machine = run.machine
    axle = machine.tractor.rear_axle
    if sensor.body == "seeder" and machine.seeder is not None:
        axle = float(np.mean(machine.seeder.axles))
    imd: Imd = run.of_kind("imd")[unit]
    turning = turned(raw.angular_velocity[times.index], mounting_matrix(imd.rotation_deg))
    utc = gnss.utc - base * 1.0e-9
    course, speed = over_ground(gnss.utc, gnss.values)
    lever = (axle + sensor.position[0], sensor.position[2])
    return motion_offset(times.t, turning, utc, course, speed, lever)


def over_ground(utc: Floats, values: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    """Course (rad) and speed (m/s) as a receiver states them, or from its positions where it never does.

    utc : (N,) s; values : `course`, `speed`, `lat`, `lon`, `alt` of `GnssStream`, (N,) each
    """
    course, speed = values["course"], values["speed"]
    if np.isfinite(course).sum() > 1:
        return course, speed
    known = np.flatnonzero(np.isfinite(values["lat"]))
    east, north = np.full(course.shape, np.nan), np.full(course.shape, np.nan)
    if known.size < 3:
        return east, north
    lat, lon, alt = (values[key][known] for key in ("lat", "lon", "alt"))
    e, n, _ = to_enu(lat, lon, alt, SimpleNamespace(lat=lat[0], lon=lon[0], alt=alt[0]))
    east[known], north[known] = np.gradient(e, utc[known]), np.gradient(n, utc[known])
    return np.arctan2(north, east), np.hypot(east, north)
