"""Clock reconstruction against simulated truth: known counters, latencies, faults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial import ConvexHull
from smts_validate.sensors import clocks
from smts_validate.sensors.clock_line import early

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
LEAST = 1.0e-3
RATE = 100.0


@dataclass
class Logged:
    """A simulated unit: what the logger wrote, in order of arrival, and the truth of each row."""

    host: Floats
    counter: Ints
    seq: Ints
    true: Floats

    def take(self, rows: Ints) -> Logged:
        return Logged(self.host[rows], self.counter[rows], self.seq[rows], self.true[rows])


def a_unit(
    seed: int, seconds: float = 60.0, drift: float = 0.0, start: int = 0, first_seq: int = 0
) -> Logged:
    """A unit whose counter runs fast by `drift`; latency is 1 ms and a gamma-distributed rest."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    k = np.arange(n)
    true = 100.0 + k / (RATE * (1.0 + drift))
    counter = (start + np.rint((true - 100.0) * (1.0 + drift) * 1.0e6).astype(np.int64)) % 2**32
    latency = LEAST + np.minimum(rng.gamma(1.2, 3.0e-3, n), 19.0e-3)
    return Logged(true + latency, counter, (first_seq + k) % 2**16, true)


def error_of(unit: Logged) -> tuple[clocks.SampleTimes, Floats]:
    """Reconstructed times and their error against truth + least latency, s."""
    times = clocks.sample_times(unit.host, unit.counter, unit.seq, RATE)
    return times, times.t - (unit.true[times.index] + LEAST)


@pytest.mark.parametrize("drift", [-200e-6, -37e-6, 0.0, 150e-6, 200e-6])
def test_a_drifting_counter_gives_the_instants_to_a_tenth_of_a_millisecond(drift: float) -> None:
    times, error = error_of(a_unit(seed=1, drift=drift))
    assert np.abs(error).max() < 1.0e-4
    assert times.drift == pytest.approx(drift, abs=3e-6)
    assert times.index.size == 6000


def test_a_counter_that_wraps_is_continued() -> None:
    times, error = error_of(a_unit(seed=2, start=2**32 - 20_000_000, first_seq=2**16 - 100))
    assert times.wraps == 1
    assert times.lost == 0
    assert np.abs(error).max() < 1.0e-4


def test_wraps_hidden_in_a_long_pause_are_settled_by_the_host() -> None:
    unit = a_unit(seed=3, seconds=3.0 * 4295.0)
    rows = np.concatenate([np.arange(3000), np.arange(unit.host.size - 3000, unit.host.size)])
    times, error = error_of(unit.take(rows))
    assert np.abs(error).max() < 1.0e-3
    assert times.t[-1] - times.t[0] == pytest.approx(unit.true[-1] - unit.true[0], abs=1e-3)


def test_lost_samples_are_counted_and_leave_gaps() -> None:
    unit = a_unit(seed=4, first_seq=65_000)
    keep = np.setdiff1d(np.arange(6000), [10, 700, 701, 702, 5000])
    times, error = error_of(unit.take(keep))
    assert times.lost == 5
    assert np.abs(error).max() < 1.0e-4
    assert np.diff(times.t).max() == pytest.approx(0.04, abs=1e-4)


def test_doubled_and_disordered_rows_are_sorted_out_with_their_rows() -> None:
    unit = a_unit(seed=5)
    order = np.arange(6000)
    order[[100, 104]] = order[[104, 100]]
    order = np.insert(order, 300, 299)
    arrived = unit.take(order)
    arrived.host = np.maximum.accumulate(arrived.host)  # a logger stamps rows as they come
    times, error = error_of(arrived)
    assert times.doubled.tolist() == [300]
    assert 101 in times.disordered
    assert times.index.size == 6000
    assert (np.diff(times.t) > 0.0).all()
    assert np.abs(error).max() < 1.0e-4


def test_a_reset_counter_is_fitted_anew() -> None:
    unit = a_unit(seed=6, drift=80e-6, start=123_456_789)
    unit.counter[4000:] = unit.counter[4000:] - unit.counter[4000] + 777
    times, error = error_of(unit)
    assert times.resets.tolist() == [4000]
    assert np.abs(error).max() < 3.0e-4


@pytest.mark.parametrize("size", [-3600.0, -5.0, 0.5, 3.0, 7200.0])
def test_a_jump_of_the_loggers_clock_is_taken_out(size: float) -> None:
    unit = a_unit(seed=7)
    unit.host[2500:] += size
    times, error = error_of(unit)
    assert [row for row, _ in times.host_jumps][-1:] == [2500]
    assert sum(jump for _, jump in times.host_jumps) == pytest.approx(size, abs=2e-3)
    assert np.abs(error).max() < 2.0e-3


def test_a_sample_counter_that_begins_anew_is_no_loss() -> None:
    unit = a_unit(seed=22)
    unit.seq[3000:] = np.arange(3000)
    keep = np.setdiff1d(np.arange(6000), [1000, 1001, 4500])
    times, _ = error_of(unit.take(keep))
    assert times.lost == 3


def test_a_counter_that_is_none_is_refused() -> None:
    unit = a_unit(seed=23, seconds=10.0)
    unit.counter[:] = np.random.default_rng(0).integers(0, 2**32, unit.counter.size)
    with pytest.raises(clocks.ClockError, match="begins anew"):
        clocks.sample_times(unit.host, unit.counter, unit.seq, RATE)


def test_a_rate_that_warms_up_is_followed() -> None:
    rng = np.random.default_rng(20)
    true = np.arange(0.0, 1800.0, 0.01)
    rate = 1.0 + 150e-6 * (1.0 - np.exp(-true / 300.0))
    counter = np.rint(np.cumsum(rate * 0.01) * 1e6).astype(np.int64) % 2**32
    host = true + LEAST + np.minimum(rng.gamma(1.2, 3.0e-3, true.size), 19.0e-3)
    times = clocks.sample_times(host, counter, None, RATE)
    error = times.t - (true[times.index] + LEAST)
    assert np.abs(error).max() < 5.0e-4


def test_a_minute_in_which_the_logger_was_busy_is_no_wander() -> None:
    unit = a_unit(seed=21, seconds=900.0, drift=20e-6)
    unit.host[30_000:35_900] += 0.008
    _, error = error_of(unit)
    assert np.abs(error).max() < 3.0e-4


def test_a_stalled_logger_shifts_nothing() -> None:
    unit = a_unit(seed=8)
    stalled = slice(2000, 2400)
    unit.host[stalled] = np.maximum(unit.host[stalled], unit.true[2400])
    times, error = error_of(unit)
    assert times.host_jumps == ()
    assert times.resets.size == 0
    assert np.abs(error).max() < 1.0e-4


@pytest.mark.parametrize(("rows", "late"), [(22, 0.22), (16, 0.16), (450, 1.5)])
@pytest.mark.parametrize("at_the_end", [True, False])
def test_a_stall_at_either_end_is_no_jump(rows: int, late: float, at_the_end: bool) -> None:
    unit = a_unit(seed=31)
    unit.host[slice(-rows, None) if at_the_end else slice(rows)] += late
    times, error = error_of(unit)
    assert times.host_jumps == ()
    assert np.abs(error).max() < 1.0e-4


@pytest.mark.parametrize(("row", "size"), [(5400, 0.5), (5400, -0.5), (600, 0.5), (600, -0.5), (5950, -0.5)])
def test_a_jump_near_an_end_is_still_one(row: int, size: float) -> None:
    unit = a_unit(seed=32)
    unit.host[row:] += size
    times, error = error_of(unit)
    assert [at for at, _ in times.host_jumps] == [row]
    assert np.abs(error).max() < 2.0e-3


def test_a_receivers_late_last_epochs_are_no_jump() -> None:
    utc = np.arange(0.0, 60.0, 0.1)
    host = utc + 0.1
    host[-30:] += 0.4
    assert clocks.steady_host(host, utc, 10.0)[1] == []


def test_without_a_counter_the_hosts_time_is_the_time() -> None:
    unit = a_unit(seed=9)
    host = np.sort(unit.host)
    times = clocks.sample_times(host, None, unit.seq, RATE)
    assert np.array_equal(times.t, host)
    assert np.isnan(times.drift)


def test_a_few_stray_rows_without_a_counter_are_sorted_in() -> None:
    host = np.arange(1000) * 0.01
    order = np.arange(1000)
    order[[500, 503]] = order[[503, 500]]
    times = clocks.sample_times(host[order], None, None, RATE)
    assert np.array_equal(times.t, host)
    assert 503 in times.disordered
    assert times.lost == 0


def test_rows_that_arrived_together_are_told_from_doubled_ones_and_spread() -> None:
    host = np.array([0.0, 0.01, 0.02, 0.05, 0.05, 0.05, 0.06, 0.06])
    same = np.array([False] * 7 + [True])
    times = clocks.sample_times(host, None, None, RATE, repeats=same)
    assert times.doubled.tolist() == [7]
    assert times.t == pytest.approx([0.0, 0.01, 0.02, 0.035, 0.0425, 0.05, 0.06])
    assert (np.diff(times.t) > 0.0).all()


def test_jitter_without_a_counter_is_no_lost_sample_but_a_long_gap_is() -> None:
    rng = np.random.default_rng(3)
    host = np.arange(3000) / 50.0 + rng.uniform(0.0, 0.009, 3000)
    assert clocks.sample_times(host, None, None, 50.0).lost == 0
    assert clocks.sample_times(np.delete(host, slice(100, 110)), None, None, 50.0).lost == 10


def test_time_that_falls_back_without_a_counter_is_refused_with_row_and_amount() -> None:
    host = np.array([0.0, 0.01, 0.02, 0.018, 0.03])
    with pytest.raises(clocks.ClockError, match=r"falls back by 2\.0 ms") as caught:
        clocks.sample_times(host, None, None, RATE)
    assert caught.value.row == 3


def test_reconstruction_shifts_with_the_clock() -> None:
    unit = a_unit(seed=10, drift=50e-6)
    plain = clocks.sample_times(unit.host, unit.counter, unit.seq, RATE)
    later = clocks.sample_times(unit.host + 1000.0, unit.counter, unit.seq, RATE)
    assert np.allclose(later.t - 1000.0, plain.t, atol=1e-9)


def test_rms_of_many_units_is_far_below_their_latency() -> None:
    units = [a_unit(seed=k, seconds=30.0, drift=1e-5 * (k - 10)) for k in range(20)]
    worst = [np.abs(error_of(unit)[1]).max() for unit in units]
    assert np.sqrt(np.mean(np.square(worst))) < 2.0e-4


@given(
    counts=st.lists(st.integers(0, 2**20), min_size=1, max_size=50),
    start=st.integers(0, 2**32 - 1),
    doubt=st.floats(-0.4, 0.4),
)
def test_unwrapping_undoes_wrapping(counts: list[int], start: int, doubt: float) -> None:
    whole = start + np.cumsum(np.array(counts, dtype=np.int64) * 1000)
    elapsed = (whole - whole[0]) + doubt * 2**32
    elapsed[0] = 0.0
    found = clocks.unwrap(whole % 2**32, 2**32, elapsed)
    assert np.array_equal(found - found[0], whole - whole[0])


point = st.tuples(st.integers(0, 1000), st.integers(-1000, 1000))
points = st.lists(point, min_size=3, max_size=60, unique_by=lambda p: p[0])


@given(points)
def test_the_hull_lies_below_all_points_and_is_convex(scatter: list[tuple[int, int]]) -> None:
    x, y = np.array(sorted(scatter), dtype=np.float64).T
    hull = clocks.lower_hull(x, y)
    assert (np.interp(x, x[hull], y[hull]) <= y + 1e-9).all()
    slopes = np.diff(y[hull]) / np.diff(x[hull])
    assert (np.diff(slopes) > 0.0).all()


def test_the_hull_is_qhulls_lower_half() -> None:
    rng = np.random.default_rng(0)
    x, y = np.sort(rng.uniform(0, 1, 300)), rng.normal(size=300)
    full = ConvexHull(np.column_stack([x, y]))
    below = full.simplices[full.equations[:, 1] < 0.0]
    lower = set(below.ravel().tolist())
    assert set(clocks.lower_hull(x, y).tolist()) == lower


@settings(deadline=None, max_examples=30)
@given(seed=st.integers(0, 10_000), n=st.integers(2, 400))
def test_with_a_flat_prior_the_line_is_the_linear_programme_s(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(0.0, 100.0, n))
    y = 2e-4 * x + rng.gamma(1.0, 5e-3, n)
    line = clocks.one_sided_line(x, y, slope_sd=10.0)
    centred = x - x.mean()
    below = np.column_stack([np.ones(n), centred])
    best = linprog([-1.0, 0.0], A_ub=below, b_ub=y, bounds=[(None, None)] * 2)
    assert line(x).mean() == pytest.approx(best.x[0], abs=1e-6)
    assert (line(x) <= y + 1e-9).all()


@pytest.mark.parametrize("shape", [0.7, 1.0, 2.0, 5.0])
def test_early_stamps_are_told_from_quick_ones(shape: float) -> None:
    rng = np.random.default_rng(30)
    for trial in range(20):
        x = np.sort(rng.uniform(0.0, 60.0, 3000))
        y = 1e-4 * x + rng.gamma(shape, 4e-3, x.size)
        assert early(x, y).sum() <= 1, trial
        broken = rng.choice(x.size, 15, replace=False)
        y[broken] -= rng.uniform(0.05, 0.9, 15)
        found = set(np.flatnonzero(early(x, y)).tolist())
        assert set(broken.tolist()) <= found
        assert len(found) <= 16


def test_broken_digits_of_either_clock_shift_nothing_and_are_dropped() -> None:
    unit = a_unit(seed=31, drift=70e-6)
    rng = np.random.default_rng(31)
    broken = np.sort(rng.choice(np.arange(10, 5990), 60, replace=False))
    unit.host[broken[:20]] -= rng.uniform(0.02, 0.9, 20)
    unit.counter[broken[20:40]] += rng.integers(8_000, 900_000, 20)
    unit.counter[broken[40:]] -= rng.integers(8_000, 900_000, 20)
    times, error = error_of(unit)
    assert times.host_jumps == ()
    assert set(broken.tolist()) <= set(times.strange.tolist())
    assert times.strange.size < 75
    assert np.abs(error).max() < 2e-4


def test_thinning_a_long_scatter_changes_nothing_that_matters() -> None:
    unit = a_unit(seed=11, seconds=600.0, drift=120e-6)
    device = unit.counter * 1e-6
    offset = unit.host - device
    line = clocks.one_sided_line(device, offset)
    assert (line(device) <= offset + 2e-5).all()
    assert line.slope == pytest.approx(-120e-6, abs=5e-7)


def test_the_loggers_offset_from_utc_is_found_up_to_the_assumed_latency() -> None:
    rng = np.random.default_rng(12)
    utc = np.arange(0.0, 60.0, 0.1)
    host = utc + 2.2143 + 0.1 + rng.gamma(2.0, 0.02, utc.size)
    to_utc = clocks.host_to_utc(host, utc, 0.1)
    assert to_utc(np.array([30.0]))[0] == pytest.approx(30.0 - 2.2143, abs=4e-3)


def test_a_long_recording_shows_the_loggers_drift_against_utc() -> None:
    rng = np.random.default_rng(13)
    utc = np.arange(0.0, 3600.0, 0.1)
    host = utc * (1.0 + 35e-6) + 0.1 + rng.gamma(2.0, 0.02, utc.size)
    to_utc = clocks.host_to_utc(host, utc, 0.1)
    error = to_utc(utc * (1.0 + 35e-6)) - utc
    assert np.abs(error).max() < 5e-3


def test_a_short_recording_does_not_take_jitter_for_drift() -> None:
    rng = np.random.default_rng(14)
    utc = np.arange(0.0, 60.0, 0.1)
    slopes = [
        clocks.host_to_utc(utc + 0.1 + rng.gamma(2.0, 0.02, utc.size), utc, 0.1).line.slope for _ in range(30)
    ]
    assert np.abs(slopes).max() < 60e-6
