"""Device, host and UTC time: wraps, resets, drift and one-sided latency -> the instant of measurement.

Three clocks meet in a raw pass. A unit's own counter is regular, but its rate is off, it wraps and resets.
The logger's (host) clock stamps arrival, late by a jittering latency that is never negative. GNSS sentences
carry UTC. Since latency is one-sided, the line that best relates two clocks is not a least-squares line but
the highest one below all points: it touches the samples that came through fastest (the lower convex hull).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, minimum_filter1d

from .clock_line import DEVICE_DRIFT_SD, ClockLine, lower_hull, one_sided_line

__all__ = [
    "ClockError",
    "ClockLine",
    "HostToUtc",
    "SampleTimes",
    "host_to_utc",
    "lower_hull",
    "one_sided_line",
    "sample_times",
    "steady_host",
    "without_jumps",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

COUNTER_SPAN = 2**32
SEQ_SPAN = 2**16
HOST_DRIFT_SD = 2.0e-5  # rate of a computer's clock against UTC
IMU_LEAST_LATENCY = (
    1.0e-3  # s: the smallest credible delay from sampling to arrival; it cannot be seen in the clocks
)
STEP_WINDOW = 15.0  # s: a latency burst ends sooner, a reset or a clock jump lasts
STALL = 5.0  # s: so long rows may be late at the start or the end of a recording without a jump
DEVICE_STEP = 0.1  # s: smaller changes of offset are latency
GNSS_STEP = 0.25  # s
NEIGHBOURS = 1.0  # s: a counter that advances less than this between rows has not been reset
RESET_STEP = 0.25  # s: by which a counter's advance differs from the host's when it was reset
HUGE_STEP = 600.0  # s: no latency lasts so long
MIN_SEGMENT = 5  # samples: fewer between two resets are a corrupt counter
WANDER_WINDOW = 60.0  # s: short against the warming of an oscillator, long against bursts of latency
WANDER_LEAST = 1.0e-3  # s
LEAST_WINDOWS = 5
LOW_PERCENT = 10.0
TOO_EARLY = 1.0e-3  # s: no sample arrives before it is taken
HALF_SAMPLE = 0.5
STRAY_SHARE = 0.01  # of the rows may stand out of order where only the host's time tells
STRAY_LIMIT = 1.0  # s, by which they may be late
SURE_GAP = 2.5  # nominal periods: a longer gap is a lost sample, without a counter
MIN_EPOCHS = 20  # epochs of a slow receiver on each side of a jump
SHARED_RATE_SD = 2.0e-6  # rate of one crystal before and after a reset


class ClockError(ValueError):
    """Clocks that cannot be reconciled; the text names what, and `row` where (index of the sample)."""

    def __init__(self, text: str, row: int | None = None) -> None:
        super().__init__(text)
        self.row = row


@dataclass(frozen=True)
class SampleTimes:
    """Which samples of a stream stay, in the order of their instants, and when they were taken.

    index : (M,) rows of the input, each distinct sample once, ordered in time
    t : (M,) s on the host's clock, true instant + the least latency
    host : (M,) s on the host's clock, arrival, jumps of that clock taken out
    drift : of the device's counter against the host, 1 (positive: counter runs fast); NaN without counter
    doubled, disordered, strange, resets : rows of the input that repeat a sample, come after a later one, whose
        clocks contradict each other (these are left out), that begin a new count
    lost : samples missing in between; wraps : of the counter
    host_jumps : (row, size in s) where the host's clock was set
    """

    index: Ints
    t: Floats
    host: Floats
    drift: float
    doubled: Ints
    disordered: Ints
    strange: Ints
    lost: int
    wraps: int
    resets: Ints
    host_jumps: tuple[tuple[int, float], ...]


def unwrap(counter: Ints, span: int, elapsed: Floats) -> Ints:
    """A counter that wraps at `span` made continuous, settled by another clock.

    elapsed : (N,) what the counter should have advanced since the first sample, in its own unit, to
        within half a span.
    """
    advance = counter - counter[0]
    return np.asarray(counter + span * np.rint((elapsed - advance) / span).astype(np.int64), dtype=np.int64)


def find_steps(offset: Floats, window: int, threshold: float, stall: int = 0) -> list[tuple[int, float]]:
    """Lasting changes of a one-sided offset: (index of the first sample after it, size).

    The least offset of the `window` samples before is held against that of the `window` samples from there
    on: latency comes and goes, a reset or a jump of a clock stays. Up to `stall` late samples at either end
    are latency too, for nothing there shows whether it would have gone.
    """
    n = offset.size
    offset = median_filter(offset, 7, mode="nearest")  # a few broken stamps are no step
    half = min(max(1, window // 2), n)
    width = 2 * half + 1
    edge = np.full(width, np.inf)
    least = minimum_filter1d(np.concatenate([edge, offset, edge]), width, mode="nearest")
    rows = np.arange(1, n)
    change = np.zeros(n)
    change[1:] = least[rows + width + half] - least[rows + width - 1 - half]
    steps = _edges(change, threshold)
    return [(row, size) for row, size in steps if (n - row if size > 0.0 else row) > stall]


def _edges(change: Floats, threshold: float) -> list[tuple[int, float]]:
    """One edge a run of flagged samples: a rise shows from its edge on, a fall up to its edge."""
    steps: list[tuple[int, float]] = []
    for sign in (1.0, -1.0):
        flagged = np.flatnonzero(sign * change > threshold)
        if flagged.size == 0:
            continue
        for run in np.split(flagged, np.flatnonzero(np.diff(flagged) > 1) + 1):
            edge = int(run[0] if sign > 0.0 else run[-1])
            steps.append((edge, float(change[edge])))
    return sorted(steps)


def without_jumps(host: Floats, jumps: list[tuple[int, float]]) -> Floats:
    """The host's times as if its clock had gone on as before each (first row after, size in s)."""
    repaired = host.copy()
    for row, size in jumps:
        repaired[row:] -= size
    return repaired


def _counter_increments(counter: Ints, tick: float, span: int | None, host: Floats) -> tuple[Floats, Floats]:
    """Advance of the counter from row to row (s, within half a span), and what the host's exceeds it by."""
    ahead = np.diff(counter)
    if span is None:
        return ahead * tick, np.diff(host) - ahead * tick
    step = ((ahead + span // 2) % span - span // 2) * tick
    short = np.diff(host) - step
    period = span * tick
    settled = (short + period / 2) % period - period / 2
    return step, np.where(np.abs(step) < NEIGHBOURS, short, settled)


def _continuous_device(counter: Ints, tick: float, span: int | None, host: Floats) -> Floats:
    """A segment's counter in seconds since its first row, wraps taken out."""
    start = int(counter[0])
    if span is None:
        return np.asarray((counter - start) * tick)
    return np.asarray((unwrap(counter, span, (host - host[0]) / tick) - start) * tick)


def sample_times(
    host: Floats,
    counter: Ints | None,
    seq: Ints | None,
    rate: float,
    tick: float = 1.0e-6,
    span: int | None = COUNTER_SPAN,
    repeats: Bools | None = None,
) -> SampleTimes:
    """Instants of a unit's samples on the host's clock, up to the least latency.

    Parameters
    ----------
    host : (N,) s, arrival by the host's clock, in the order of arrival, N ≥ 1
    counter : (N,) the unit's own counter, in units of `tick` seconds, wrapping at `span` (None: never);
        without a counter the host's time is the time
    seq : (N,) counter of samples, wraps at 2^16; None: lost samples are counted from gaps
    rate : Hz, nominal
    repeats : (N,) where a row's readings are those of the row before: tells doubled rows without a counter

    Raises
    ------
    ClockError : a counter that begins anew all the time; without one, time that falls back by more than a
        few stray rows.
    """
    if counter is None:
        return _host_only(host, seq, rate, repeats)
    step, short = _counter_increments(counter, tick, span, host)
    near = np.abs(step) < NEIGHBOURS
    resets = np.flatnonzero(~near & (np.abs(short) > RESET_STEP)) + 1
    huge = [(int(i) + 1, float(short[i])) for i in np.flatnonzero(near & (np.abs(short) > HUGE_STEP))]
    bounds = np.concatenate([[0], resets, [host.size]])
    segments = [slice(int(a), int(b)) for a, b in pairwise(bounds)]
    window, stall = round(STEP_WINDOW * rate), round(STALL * rate)
    steady, jumps = without_jumps(host, huge), []
    for part in segments:
        device = _continuous_device(counter[part], tick, span, steady[part])
        rows = [row - part.start for row, _ in huge if part.start <= row < part.stop]
        rows += [row for row, _ in find_steps(steady[part] - device, window, DEVICE_STEP, stall)]
        sizes = _jump_sizes(host[part] - device, device, sorted(set(rows)), window)
        jumps += [(part.start + row, size) for row, size in sizes]
    steady = without_jumps(host, jumps)
    devices = [_continuous_device(counter[part], tick, span, steady[part]) for part in segments]
    return _fitted(steady, devices, segments, seq, rate, _wraps(counter, span), tuple(jumps))


def _jump_sizes(offset: Floats, device: Floats, rows: list[int], window: int) -> list[tuple[int, float]]:
    """Size of each jump of the host's clock: change of the low offsets there, less the drift."""
    if not rows:
        return []
    bounds = [0, *rows, offset.size]
    longest = max(pairwise(bounds), key=lambda pair: pair[1] - pair[0])
    calm = slice(*longest)
    level = offset - _device_line(device[calm], device[calm] + offset[calm]).slope * device
    return [
        (row, _low(level[row : min(row + window, after)]) - _low(level[max(row - window, before) : row]))
        for before, row, after in zip(bounds, rows, bounds[2:], strict=False)
    ]


def _low(level: Floats) -> float:
    """A low level that neither latency nor a few broken stamps move."""
    return float(np.percentile(level, LOW_PERCENT))


def _wraps(counter: Ints, span: int | None) -> int:
    """How often the counter fell from near its end to near its start."""
    return 0 if span is None else int(np.count_nonzero(np.diff(counter) < -span * 3 // 4))


def _fitted(
    host: Floats,
    devices: list[Floats],
    segments: list[slice],
    seq: Ints | None,
    rate: float,
    wraps: int,
    jumps: tuple[tuple[int, float], ...],
) -> SampleTimes:
    """Fit each segment's counter to the host's clock; one crystal: the longest segment's rate serves all."""
    longest = max(range(len(segments)), key=lambda k: devices[k].size)
    slope = _device_line(devices[longest], host[segments[longest]]).slope
    index, t, doubled, disordered, strange, lost = [], [], [], [], [], 0
    for part, device in zip(segments, devices, strict=True):
        if device.size < MIN_SEGMENT and len(segments) > 1:
            continue
        line = _device_line(device, host[part], slope, SHARED_RATE_SD) if len(segments) > 1 else None
        line = line or _device_line(device, host[part])
        sound = host[part] - device - line(device) > -TOO_EARLY
        if seq is not None:
            sound &= _in_step(device, seq[part], rate)
        strange.append(np.flatnonzero(~sound) + part.start)
        order = np.flatnonzero(sound)[np.argsort(device[sound], kind="stable")]
        fresh = np.diff(device[order], prepend=-np.inf) > 0.0
        arrived = np.flatnonzero(sound)
        disordered.append(arrived[1:][np.diff(device[arrived]) < 0.0] + part.start)
        doubled.append(order[~fresh] + part.start)
        kept = order[fresh]
        lost += _lost(device[kept], None if seq is None else seq[part][kept], rate)
        index.append(kept + part.start)
        t.append((device + line(device) + _wander(device, host[part], line))[kept])
    if 2 * sum(part.size for part in index) < host.size:
        row = segments[1].start
        raise ClockError(f"its counter begins anew {len(segments) - 1} times; is it the right column?", row)
    rows, times = np.concatenate(index), np.concatenate(t)
    rising = times > np.maximum.accumulate(np.concatenate([[-np.inf], times[:-1]]))
    resets = np.array([part.start for part in segments[1:]], dtype=np.int64)
    return SampleTimes(
        rows[rising],
        times[rising],
        host[rows[rising]],
        -slope,
        np.sort(np.concatenate(doubled)),
        np.concatenate(disordered),
        np.concatenate(strange),
        lost,
        wraps,
        resets,
        jumps,
    )


def _in_step(device: Floats, seq: Ints, rate: float) -> Bools:
    """Where counter and sample counter agree with the neighbours': a broken digit of either puts it out of step."""
    if device.size < 5:
        return np.ones(device.size, dtype=np.bool_)
    ahead = device * rate - unwrap(seq, SEQ_SPAN, (device - device[0]) * rate)
    return np.asarray(np.abs(ahead - median_filter(ahead, 5, mode="nearest")) < HALF_SAMPLE)


def _device_line(
    device: Floats, host: Floats, slope: float = 0.0, slope_sd: float = DEVICE_DRIFT_SD
) -> ClockLine:
    return one_sided_line(device, host - device, slope, slope_sd)


def _wander(device: Floats, host: Floats, line: ClockLine) -> Floats:
    """What a rate that changes (an oscillator that warms up) adds to the line, (N,) s; zero for a steady one.

    In windows of WANDER_WINDOW the quickest sample touches the true relation of the clocks. Where these touch the
    line within WANDER_LEAST everywhere it stands; else the way between them is followed. A single window in which
    all samples were late is no wander.
    """
    none = np.zeros(device.size)
    windows = int(np.ptp(device) // WANDER_WINDOW)
    if windows < LEAST_WINDOWS:
        return none
    order = np.argsort(device, kind="stable")
    edges = device[order[0]] + WANDER_WINDOW * np.arange(1, windows)
    height = host - device - line(device)
    parts = np.split(order, np.unique(np.searchsorted(device[order], edges)))
    lowest = np.array([part[np.argmin(height[part])] for part in parts if part.size])
    above = median_filter(height[lowest], 3, mode="nearest")
    if above.max() < WANDER_LEAST:
        return none
    return np.asarray(np.interp(device, device[lowest], above))


def _lost(t: Floats, seq: Ints | None, rate: float) -> int:
    """Samples missing in between: gaps of `seq`, or of time where there is none or it begins anew."""
    if t.size < 2:
        return 0
    if seq is None:
        return int(np.maximum(np.rint(np.diff(t) * rate) - 1, 0).sum())
    expected = np.rint(np.diff(t) * rate)
    ahead = np.diff(seq)
    ahead = ahead + SEQ_SPAN * np.rint((expected - ahead) / SEQ_SPAN)
    begun_anew = np.abs(ahead - expected) > 3.0 + 0.05 * expected
    return int(np.maximum(np.where(begun_anew, expected, ahead) - 1, 0).sum())


def _host_only(host: Floats, seq: Ints | None, rate: float, repeats: Bools | None) -> SampleTimes:
    """The host's time as the time: a few stray rows sorted in, rows that arrived together spread backward."""
    behind = np.maximum.accumulate(host) - host
    stray = np.flatnonzero(behind > 0.0)
    if stray.size > max(STRAY_SHARE * host.size, 0) or behind.max(initial=0.0) > STRAY_LIMIT:
        row = int(np.argmax(np.diff(host) < 0.0)) + 1
        amount = 1.0e3 * (host[row - 1] - host[row])
        raise ClockError(
            f"time falls back by {amount:.1f} ms; sort the log, or split it where the logger restarted", row
        )
    order = np.argsort(host, kind="stable")
    again = np.zeros(host.size, dtype=np.bool_) if repeats is None else repeats[order]
    again[1:] &= np.diff(order) == 1  # a repetition of the row before it in the file
    again[1:] &= np.diff(host[order]) == 0.0
    kept, doubled = order[~again], np.sort(order[again])
    t = _spread(host[kept], rate)
    lost = _lost_in_gaps(t, rate) if seq is None else _lost(t, seq[kept], rate)
    none = np.zeros(0, dtype=np.int64)
    return SampleTimes(kept, t, host[kept], float("nan"), doubled, stray, none, lost, 0, none, ())


def _spread(host: Floats, rate: float) -> Floats:
    """Rows that arrived at one instant, spread evenly back towards the one before, a period each at most."""
    first = np.flatnonzero(np.diff(host, prepend=-np.inf) > 0.0)
    count = np.diff(np.append(first, host.size))
    room = np.diff(host[first], prepend=host[0] - 1.0)
    step = np.minimum(1.0 / rate, room / (count + 1))
    last = np.repeat(first + count - 1, count)
    return np.asarray(host - (last - np.arange(host.size)) * np.repeat(step, count))


def _lost_in_gaps(t: Floats, rate: float) -> int:
    """Samples that gaps are too long to be without; shorter ones are latency."""
    periods = np.diff(t) * rate
    return int((np.rint(periods[periods > SURE_GAP]) - 1).sum())


@dataclass(frozen=True)
class HostToUtc:
    """UTC = host - offset(host): the logger's clock against UTC, GNSS's assumed least latency taken off."""

    line: ClockLine
    latency: float

    def __call__(self, host: Floats) -> Floats:
        return np.asarray(host - self.line(host) + self.latency)


def steady_host(host: Floats, utc: Floats, rate: float) -> tuple[Floats, list[tuple[int, float]]]:
    """The host's times of GNSS epochs with lasting jumps of that clock taken out, and the jumps."""
    window = max(MIN_EPOCHS, round(STEP_WINDOW * rate))
    offset = host - utc
    rows = [row for row, _ in find_steps(offset, window, GNSS_STEP, round(STALL * rate))]
    jumps = _jump_sizes(offset, utc, rows, window)
    return without_jumps(host, jumps), jumps


def host_to_utc(host: Floats, utc: Floats, latency: float) -> HostToUtc:
    """The map of the logger's clock to UTC from sentences' arrivals, host = UTC + offset + latency.

    The least latency cannot be told from the offset: `latency` (s) is its prior mean.
    """
    return HostToUtc(one_sided_line(host, host - utc, 0.0, HOST_DRIFT_SD), latency)
