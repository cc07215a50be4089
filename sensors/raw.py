"""Samples as a logger wrote them: SI units, but times still on the clocks of logger, unit and receiver."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .streams import Warn

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class RawError(ValueError):
    """A raw file that cannot be used; the text is one line: file, row, what, how to mend it."""


@dataclass(frozen=True)
class Rejected:
    """A line that was not taken: its number in the file (from 1), why, and how it begins."""

    row: int
    reason: str
    text: str


@dataclass(frozen=True)
class RawImu:
    """Rows of an inertial unit, in file order; rows that hold no usable sample are already left out.

    host_ns : (N,) Unix ns by the logger's clock, arrival
    counter : (N,) the unit's own counter, `tick` seconds each, wrapping at `span` (None: never); None: absent
    seq : (N,) sample counter that wraps at 2^16; None: absent
    rows : (N,) line numbers in the file
    specific_force, angular_velocity, magnetic_field : (N, 3), m/s², rad/s, T, in the sensor's frame
    """

    host_ns: Ints
    counter: Ints | None
    tick: float
    span: int | None
    seq: Ints | None
    rows: Ints
    specific_force: Floats
    angular_velocity: Floats
    magnetic_field: Floats | None
    warnings: tuple[Warn, ...] = ()


@dataclass(frozen=True)
class RawSteer:
    """Rows of a steering sensor: host_ns (N,), rows (N,), angle (N,) rad, left positive."""

    host_ns: Ints
    rows: Ints
    angle: Floats
    warnings: tuple[Warn, ...] = ()


@dataclass(frozen=True)
class RawSpeed:
    """Rows of a speed sensor: host_ns (N,), rows (N,), speed (N,) m/s, or rad/s of the wheel where it is `turning`."""

    host_ns: Ints
    rows: Ints
    speed: Floats
    turning: bool = False
    warnings: tuple[Warn, ...] = ()


@dataclass(frozen=True)
class RawGnss:
    """Epochs of a receiver, in order of UTC.

    utc : (N,) s since the epoch, of validity
    host_ns : (N,) Unix ns by the logger's clock when an epoch's first sentence arrived; None: not recorded
    rows : (N,) line where each epoch begins
    values : the arrays of `GnssStream.ARRAYS`, (N,) each
    sentences, rejected_count : how many lines were understood, how many refused
    rejected : the refused lines (the first ones, where there are very many); reasons : their count by reason
    """

    utc: Floats
    host_ns: Ints | None
    rows: Ints
    values: Mapping[str, Floats]
    sentences: int = 0
    rejected_count: int = 0
    rejected: tuple[Rejected, ...] = ()
    warnings: tuple[Warn, ...] = ()
    reasons: Mapping[str, int] = field(default_factory=dict)


Raw = RawImu | RawSteer | RawSpeed | RawGnss
