"""Clocks of a twin: when a unit samples, what its counter shows, when the logger hears of it; and the
files' faults."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from .twin_plan import ClockPlan, FaultPlan

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

COUNTER = 1 << 32  # of t_dev_us
SEQUENCE = 1 << 16  # of seq
SAMPLE_JITTER = 8e-6  # s, of a unit's sampling
LATE_SHARE, LATE_MEAN = 0.01, 0.015  # now and then the logger is busy
BURST = 2.0  # samples lost together, mean
SILENCE = 1.5  # s that a unit needs to start anew


@dataclass(frozen=True)
class HostClock:
    """The logger's clock: reads UTC + offset + drift·(time in the pass). start_ns: UTC of t = 0, Unix ns."""

    start_ns: int
    offset: float
    drift: float

    def reading(self, t: Floats) -> Ints:
        """Unix ns that the logger writes for instants t (s in the pass)."""
        shifted = t * (1.0 + self.drift) + self.offset
        return self.start_ns + np.round(shifted * 1e9).astype(np.int64)


def host_clock(plan: ClockPlan, start_ns: int, rng: np.random.Generator) -> HostClock:
    """The planned logger's clock; an offset that is not planned lies within ±5 s."""
    drawn = float(rng.uniform(-5.0, 5.0))
    offset = drawn if plan.host_offset is None else plan.host_offset
    return HostClock(start_ns, offset, plan.host_drift_ppm * 1e-6)


@dataclass(frozen=True)
class Samples:
    """Instants of one unit's samples: t (s in the pass, true), its counter and sequence number; drift (1)."""

    t: Floats
    t_dev_us: Ints
    seq: Ints
    drift: float


def sample_times(plan: ClockPlan, rate: float, duration: float, rng: np.random.Generator) -> Samples:
    """A unit that samples every 1/rate of its own clock, from a start of its own on.

    counter = start + (1 + drift)·t in µs, wrapped at 2^32; seq counts from anywhere, wrapped at 2^16.
    """
    drift = plan.drift_ppm * 1e-6 * float(np.clip(rng.standard_normal(), -3.0, 3.0))
    begin = float(rng.uniform(0.0, 0.3))
    n = int((duration - begin - 1e-3) * rate * (1.0 + drift))
    t = begin + (np.arange(n) / rate + SAMPLE_JITTER * np.abs(rng.standard_normal(n))) / (1.0 + drift)
    first, seq = int(rng.integers(COUNTER)), int(rng.integers(SEQUENCE))
    if plan.wrap:
        first, seq = COUNTER - round(duration / 3 * 1e6), SEQUENCE - n // 2
    counter = first + np.round(t * (1.0 + drift) * 1e6).astype(np.int64)
    return Samples(t, counter % COUNTER, (seq + np.arange(n)) % SEQUENCE, drift)


def arrivals(plan: ClockPlan, t: Floats, rng: np.random.Generator) -> Floats:
    """When the logger hears of samples taken at t, s in the pass: never early, in order, jittering."""
    late = np.where(rng.random(t.size) < LATE_SHARE, rng.exponential(LATE_MEAN, t.size), 0.0)
    arrival = t + plan.latency + rng.exponential(plan.latency_jitter, t.size) + late
    return np.maximum.accumulate(arrival)


@dataclass(frozen=True)
class ImuRecord:
    """Rows of one unit's file, in the file's order. values : (N, 6 or 9) SI; t : (N,) true instant, s in
    the pass (not written); empty : (N, 6 or 9) cells left empty."""

    t: Floats
    t_host_ns: Ints
    t_dev_us: Ints
    seq: Ints
    values: Floats
    empty: NDArray[np.bool_]


@dataclass(frozen=True)
class SteerRecord:
    """Rows of steer.csv; t : (N,) true instant, s in the pass (not written); angle : (N,) rad."""

    t: Floats
    t_host_ns: Ints
    angle: Floats


Record = TypeVar("Record", ImuRecord, SteerRecord)


def _rows(record: Record, index: NDArray[np.intp]) -> Record:
    return replace(record, **{item.name: getattr(record, item.name)[index] for item in fields(record)})


def faulty(plan: FaultPlan, name: str, record: Record, rng: np.random.Generator) -> Record:
    """The record with rows lost (singly and in bursts, and in planned gaps), doubled and out of order."""
    keep = ~_lost(plan.lost, record.t.size, rng)
    for sensor, at in plan.restarts:
        if sensor == name:
            keep &= ~((record.t >= at) & (record.t < at + SILENCE))
    for sensor, start, length in plan.gaps:
        if sensor == name:
            keep &= ~((record.t >= start) & (record.t < start + length))
    index = np.flatnonzero(keep)
    index = np.repeat(index, 1 + (rng.random(index.size) < plan.doubled))
    for k in np.flatnonzero(rng.random(max(index.size - 1, 0)) < plan.disordered):
        index[[k, k + 1]] = index[[k + 1, k]]
    return _rows(record, index)


def _lost(share: float, n: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which samples are lost: bursts of geometric length, so that the share of all is `share`."""
    lost = np.zeros(n, dtype=bool)
    for start in np.flatnonzero(rng.random(n) < share / BURST):
        lost[start : start + rng.geometric(1.0 / BURST)] = True
    return lost


def restarted(plan: FaultPlan, name: str, record: ImuRecord) -> ImuRecord:
    """The record with the unit's counters at zero `SILENCE` after each of its planned restarts."""
    counter, seq = record.t_dev_us.copy(), record.seq.copy()
    for sensor, at in plan.restarts:
        after = record.t >= at + SILENCE
        if sensor == name and after.any():
            counter[after] = (counter[after] - counter[after][0]) % COUNTER
            seq[after] = (seq[after] - seq[after][0]) % SEQUENCE
    return replace(record, t_dev_us=counter, seq=seq)


def with_empty_cells(plan: FaultPlan, record: ImuRecord, rng: np.random.Generator) -> ImuRecord:
    """Cells of the record that the file leaves empty."""
    return replace(record, empty=rng.random(record.values.shape) < plan.empty)
