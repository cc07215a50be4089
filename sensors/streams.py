"""Typed streams of one pass: what every raw format becomes and what the MCAP log holds.

All arrays are C-contiguous, time first, checked once at construction and then read-only. Vectors are in
the *sensor's* frame; `sensors.mounting` turns them into the body's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from .manifest import Manifest

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Warn:
    """One thing that was wrong with the input and what was done about it (`warnings` of metrics.json)."""

    what: str
    effect: str
    sensor: str | None = None
    file: str | None = None
    row: int | None = None


class StreamError(ValueError):
    """A stream that breaks its own contract: shape, order or finiteness."""


def _frozen(stream: Any, name: str, shape: tuple[int, ...], finite: bool) -> None:
    """Check one array field of a frozen stream and replace it by a read-only contiguous float64 copy."""
    array = np.array(getattr(stream, name), dtype=np.float64, order="C")
    if array.shape != shape:
        raise StreamError(f"{stream.name}: {name} has shape {array.shape}, expected {shape}")
    if finite and not np.isfinite(array).all():
        raise StreamError(f"{stream.name}: {name} holds a value that is not finite")
    array.flags.writeable = False
    object.__setattr__(stream, name, array)


def _check_time(stream: Any) -> int:
    t = np.asarray(stream.t, dtype=np.float64)
    if t.ndim != 1:
        raise StreamError(f"{stream.name}: t must be one-dimensional")
    if t.size > 1 and not (np.diff(t) > 0.0).all():
        row = int(np.flatnonzero(~(np.diff(t) > 0.0))[0]) + 1
        raise StreamError(f"{stream.name}: t does not increase at sample {row}")
    return t.size


@dataclass(frozen=True)
class ImuStream:
    """An inertial unit fixed to a body (IMD). Vectors in the sensor's frame.

    t, t_arrival : (N,) s, UTC; t strictly increasing
    specific_force : (N, 3) m/s²
    angular_velocity : (N, 3) rad/s
    magnetic_field : (N, 3) T, NaN where a sample has none; None when the unit has no magnetometer
    """

    name: str
    t: Floats
    t_arrival: Floats
    specific_force: Floats
    angular_velocity: Floats
    magnetic_field: Floats | None = None

    def __post_init__(self) -> None:
        n = _check_time(self)
        for name in ("t", "t_arrival"):
            _frozen(self, name, (n,), finite=True)
        for name in ("specific_force", "angular_velocity"):
            _frozen(self, name, (n, 3), finite=True)
        if self.magnetic_field is not None:
            _frozen(self, "magnetic_field", (n, 3), finite=False)


@dataclass(frozen=True)
class WheelStream(ImuStream):
    """An inertial unit that turns with a wheel (WDS): same quantities, frame turning about the axle."""


@dataclass(frozen=True)
class GnssStream:
    """Epochs of one GNSS receiver, one row an instant of validity.

    t, t_arrival : (N,) s, UTC
    lat, lon : (N,) degrees; alt : (N,) m above the ellipsoid; NaN where the epoch has no position
    quality : (N,) GGA fix quality as float (0 none, 1 single, 2 DGPS, 4 RTK fixed, 5 RTK float, 6 estimated)
    sd_east, sd_north, sd_up : (N,) m from GST, NaN where not stated
    speed : (N,) m/s over ground, NaN where absent
    course : (N,) rad counter-clockwise from East (world yaw convention), NaN where absent
    heading : (N,) rad counter-clockwise from East, of a dual-antenna receiver (HDT, THS), NaN where absent
    hdop, satellites : (N,) NaN where absent
    """

    name: str
    t: Floats
    t_arrival: Floats
    lat: Floats
    lon: Floats
    alt: Floats
    quality: Floats
    sd_east: Floats
    sd_north: Floats
    sd_up: Floats
    speed: Floats
    course: Floats
    heading: Floats
    hdop: Floats
    satellites: Floats

    ARRAYS: ClassVar[tuple[str, ...]] = (
        "lat", "lon", "alt", "quality", "sd_east", "sd_north", "sd_up",
        "speed", "course", "heading", "hdop", "satellites",
    )  # fmt: skip

    def __post_init__(self) -> None:
        n = _check_time(self)
        for name in ("t", "t_arrival"):
            _frozen(self, name, (n,), finite=True)
        for name in self.ARRAYS:
            _frozen(self, name, (n,), finite=False)


@dataclass(frozen=True)
class SteerStream:
    """Mean angle of the front wheels. t, t_arrival : (N,) s, UTC; angle : (N,) rad, positive to the left."""

    name: str
    t: Floats
    t_arrival: Floats
    angle: Floats

    def __post_init__(self) -> None:
        n = _check_time(self)
        for name in ("t", "t_arrival", "angle"):
            _frozen(self, name, (n,), finite=True)


@dataclass(frozen=True)
class SpeedStream:
    """Speed by the rotation of wheels. t, t_arrival : (N,) s, UTC; speed : (N,) m/s, negative backwards.

    Many vehicles tell no sign: a series that is never negative says nothing of the direction.
    """

    name: str
    t: Floats
    t_arrival: Floats
    speed: Floats

    def __post_init__(self) -> None:
        n = _check_time(self)
        for name in ("t", "t_arrival", "speed"):
            _frozen(self, name, (n,), finite=True)


Stream = ImuStream | WheelStream | GnssStream | SteerStream | SpeedStream
AnyStream = TypeVar("AnyStream", ImuStream, WheelStream, GnssStream, SteerStream, SpeedStream)


@dataclass(frozen=True)
class FieldLog:
    """One pass as measured: its manifest, its streams by sensor name, and what was wrong with them.

    manifest_text is the run.toml as it was read (it rides along in the MCAP log and is hashed).
    health holds, by sensor name, what `sensors.health` found; plain JSON values.
    sha256 is the digest of the source's bytes (the log file, or the raw files in name order).
    """

    manifest: Manifest
    manifest_text: str
    streams: Mapping[str, Stream]
    warnings: tuple[Warn, ...] = ()
    health: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""
    sha256: str = ""

    def of_type(self, kind: type[AnyStream]) -> dict[str, AnyStream]:
        """Streams of exactly one class, in the manifest's order."""
        return {name: s for name, s in self.streams.items() if type(s) is kind}
