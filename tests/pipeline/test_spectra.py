"""Spectral densities against scipy, closed forms and χ² coverage; the paper's acceleration and what it
displaces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import signal as scipy_signal
from smts_validate.pipeline.compare import compare
from smts_validate.pipeline.spectra import (
    acceleration_peak,
    error_density,
    lateral_acceleration,
    spectra_of,
)
from smts_validate.pipeline.welch import (
    WAVELENGTHS,
    choose_segment,
    cross,
    half_power_band,
    overlap_dof,
    peaks,
    prepared,
    segment_starts,
    welch,
)
from synthetic_motion import Errors, Field, machine_of, manifest_of, motion_of, truth_of

Floats = NDArray[np.float64]


def rough(seed: int, size: int = 4000) -> Floats:
    """Second-order coloured noise with a broad peak at 0.1 of the sampling rate."""
    noise = np.random.default_rng(seed).standard_normal(size + 500)
    a = [1.0, -2.0 * 0.95 * np.cos(2.0 * np.pi * 0.1), 0.95**2]
    return np.asarray(scipy_signal.lfilter([1.0], a, noise)[500:])


@pytest.mark.parametrize("segment", [256, 255, 1000])
def test_welch_agrees_with_scipy_once_the_line_is_off(segment: int) -> None:
    x = rough(0)
    found = welch([x], 0.2, segment)
    frequency, density = scipy_signal.welch(
        prepared(x), 5.0, window="hann", nperseg=segment, noverlap=segment - segment // 2, detrend=False
    )
    assert found.frequency == pytest.approx(frequency)
    assert found.density == pytest.approx(density, rel=1e-9)


def test_coherence_and_transfer_agree_with_scipy() -> None:
    x = rough(1)
    y = 0.7 * np.roll(x, 3) + np.random.default_rng(2).standard_normal(x.size)
    found = cross([x], [y], 0.1, 256)
    f, coherence = scipy_signal.coherence(prepared(x), prepared(y), 10.0, nperseg=256, detrend=False)
    _, mixed = scipy_signal.csd(prepared(x), prepared(y), 10.0, nperseg=256, detrend=False)
    _, auto = scipy_signal.welch(prepared(x), 10.0, nperseg=256, detrend=False)
    assert found.frequency == pytest.approx(f)
    assert found.coherence[1:] == pytest.approx(coherence[1:], rel=1e-6)
    assert found.gain[1:-1] == pytest.approx(np.abs(mixed / auto)[1:-1], rel=1e-6)


def test_the_density_sums_to_the_variance() -> None:
    x = rough(3)
    found = welch([x], 0.5, 500)
    assert found.density.sum() * found.frequency[1] == pytest.approx(np.var(prepared(x)), rel=0.05)


def test_a_sine_s_peak_lies_at_its_frequency_and_holds_its_rms() -> None:
    s = 0.2 * np.arange(1500)
    wave = 0.05 * np.sin(2.0 * np.pi * s / 15.0) + 0.3 + 0.001 * s
    found = welch([wave], 0.2)
    (peak,) = peaks(found, most=1)
    assert peak.frequency == pytest.approx(1.0 / 15.0, abs=found.frequency[1])
    assert peak.band_rms == pytest.approx(0.05 / np.sqrt(2.0), rel=0.05)


@pytest.mark.parametrize("count", [1, 4, 9])
def test_the_chi_square_bands_cover_the_true_density(count: int) -> None:
    # White noise of variance 1 at step 1 has a one-sided density of 2 everywhere.
    inside = []
    for seed in range(40):
        x = np.random.default_rng(seed).standard_normal(128 * (count + 1) // 2)
        found = welch([x], 1.0, 128)
        part = slice(4, -4)
        inside.append(np.mean((found.low[part] < 2.0) & (found.high[part] > 2.0)))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)


def test_overlapping_segments_give_fewer_degrees_of_freedom_than_separate_ones() -> None:
    x = np.zeros(128 * 5)
    segments = len(segment_starts(x.size, 128))
    assert segments == 9
    # For Hann and half overlap ρ = (1/6)² (Welch 1967).
    expected = 2.0 * 9 / (1.0 + 2.0 * (1.0 - 1.0 / 9.0) / 36.0)
    assert overlap_dof([x], 128) == pytest.approx(expected, rel=1e-9)


@given(st.floats(3.0, 60.0))
def test_segments_hold_two_and_a_half_wavelengths_of_the_peak_or_the_whole_pass(wavelength: float) -> None:
    s = 0.2 * np.arange(600)
    wave = prepared(np.sin(2.0 * np.pi * s / wavelength))
    size = choose_segment([wave], 0.2)
    assert size == 600 or size * 0.2 >= WAVELENGTHS * wavelength * 0.8


def test_several_passes_are_averaged_into_one_density() -> None:
    records = [rough(seed, 600) for seed in range(6)]
    each = np.mean([welch([r], 1.0, 600).density for r in records], axis=0)
    together = welch(records, 1.0, 600)
    assert together.density == pytest.approx(each)
    assert together.segments == 6
    assert together.dof == pytest.approx(12.0)


def test_the_half_power_band_stops_where_half_is_left() -> None:
    values = np.array([0.0, 0.1, 0.2, 0.7, 0.6, 0.8, 1.0, 0.7, 0.6, 0.5, 0.4, 0.9])
    assert half_power_band(values, 6) == (3, 9)
    # A lone sine's line is three samples wide; its band is the window's main lobe.
    assert half_power_band(np.array([0.0, 0.0, 0.0, 0.25, 1.0, 0.25, 0.0, 0.0]), 4) == (2, 6)


def test_a_peak_of_the_paper_s_size_is_a_displacement_of_a_fraction_of_a_millimetre() -> None:
    # A sine of 0.2 mm rms at 5 Hz accelerates by (2π·5)²·0.2 mm = 0.197 m/s² rms.
    t = 0.02 * np.arange(3000)
    rms = 0.2e-3
    acceleration = rms * np.sqrt(2.0) * (2.0 * np.pi * 5.0) ** 2 * np.sin(2.0 * np.pi * 5.0 * t)
    found = welch([acceleration], 0.02, 400)
    (peak,) = peaks(found, most=1)
    values = acceleration_peak(peak)
    assert values["frequency"] == pytest.approx(5.0, abs=0.01)
    assert values["displacement_mm"] == pytest.approx(0.2, rel=0.03)


def test_the_steering_error_s_density_sums_to_its_variance() -> None:
    f = np.linspace(0.0, 500.0, 200_001)
    assert np.trapezoid(error_density(0.01, 0.5, f, 0.02), f) == pytest.approx(1e-4, rel=2e-3)
    white = error_density(0.01, 0.0, np.linspace(0.0, 25.0, 11), 0.02)
    assert white * 25.0 == pytest.approx(np.full(11, 1e-4))


def test_a_pass_gets_both_spectra_named_apart_with_their_displacements() -> None:
    manifest = manifest_of()
    machine = machine_of(manifest)
    motion = motion_of(truth_of(machine, Field(), 2.8, 0), machine, Errors(), 1)
    comparison = compare(motion, machine, manifest)
    found = spectra_of(motion, comparison, machine)
    spatial, acceleration = found.values["spatial"]["tractor"], found.values["acceleration"]["tractor"]
    assert (spatial["unit"], acceleration["unit"]) == ("m3", "(m/s2)2/Hz")
    strongest = spatial["peaks"][0]
    assert 10.0 < strongest["wavelength"] < 200.0
    assert 5.0 < strongest["displacement_mm"] < 100.0
    assert acceleration["source"] == "IMD at the centre of mass"
    assert all(p["displacement_mm"] > 0.0 for p in acceleration["peaks"])
    series = found.plots["spatial"]["tractor measured"]
    assert series.low is not None
    assert series.high is not None
    assert (series.low < series.y).all()
    assert (series.y < series.high).all()


def test_without_the_imd_s_acceleration_the_smoothed_motion_stands_in_and_says_so() -> None:
    machine = machine_of(manifest_of())
    run = truth_of(machine, Field(), 2.8, 0)
    motion = motion_of(run, machine, Errors(speed=1e-7, rate=1e-7), 1)
    bare = replace(motion, tractor=replace(motion.tractor, lateral_acceleration=None))
    source, values = lateral_acceleration(bare, 1)
    assert source == "smoothed motion"
    off = np.asarray(run.ay1)[50:-50] - values[50:-50]
    assert np.sqrt(np.mean(off**2)) < 0.01


def test_steering_response_follows_the_linear_model_where_excitation_suffices() -> None:
    manifest = manifest_of()
    machine = machine_of(manifest)
    motion = motion_of(truth_of(machine, Field(), 2.8, 0), machine, Errors(steer=1e-4, rate=1e-4), 1)
    steering = spectra_of(motion, compare(motion, machine, manifest), machine).values["steering"]
    good = [p for p in steering["points"] if p["coherence"] > 0.99]
    assert good
    for point in good:
        assert point["gain"] == pytest.approx(point["gain_model"], rel=0.15)
        assert point["excitation"] >= 10.0


def test_steering_that_does_not_move_gives_no_response() -> None:
    manifest = manifest_of()
    machine = machine_of(manifest)
    motion = motion_of(truth_of(machine, Field(), 2.8, 0), machine, Errors(), 1)
    assert motion.steer_input is not None
    blurred = replace(motion, steer_input=replace(motion.steer_input, sd=np.full(motion.t.size, 0.5)))
    steering = spectra_of(blurred, compare(motion, machine, manifest), machine).values["steering"]
    assert steering["points"] == []
    assert "too little" in steering["reason"]
