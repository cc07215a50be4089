"""Spectral densities by Welch's method, with their χ² bands, coherence and transfer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend, find_peaks
from scipy.signal.windows import hann
from scipy.special import gammaincinv

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

WAVELENGTHS = 2.5  # of the peak that a segment holds at least
MOST_SEGMENTS = 8  # of a record: more would trade the long waves away
LEVEL = 0.95
LEAST_PROMINENCE = 0.05  # of the largest density, for a peak to be listed


@dataclass(frozen=True)
class Density:
    """One-sided density over frequency (cycles per unit of the step), with its χ² band.

    density·Δf sums to the variance; dof : of the χ² law, from the segments and their overlap
    """

    frequency: Floats
    density: Floats
    low: Floats
    high: Floats
    dof: float
    segments: int
    segment_length: float


@dataclass(frozen=True)
class Cross:
    """Coherence and transfer H₁ = S_xy/S_xx of two signals; bias : expected coherence of unrelated ones,
    1/K."""

    frequency: Floats
    coherence: Floats
    gain: Floats
    phase: Floats
    input_density: Floats
    segments: int
    bias: float


@dataclass(frozen=True)
class Peak:
    """A local maximum: where it lies, its density, and the rms of the signal in its half-power band."""

    frequency: float
    density: float
    band_rms: float
    band: tuple[float, float]


def prepared(signal: Floats) -> Floats:
    """The signal less its line over the whole pass (before cutting: a line per segment would eat long
    waves)."""
    return np.asarray(detrend(np.asarray(signal, dtype=np.float64), type="linear"))


def segment_starts(size: int, segment: int) -> list[int]:
    """Starts of segments that overlap by half."""
    return list(range(0, size - segment + 1, max(segment // 2, 1))) if segment <= size else []


def choose_segment(signals: Sequence[Floats], step: float) -> int:
    """Samples a segment: at least 2.5 wavelengths of the peak, at least an eighth of the shortest
    record; else whole.

    The peak is sought in the whole records; a segment beyond two thirds of the record leaves one segment
    a record.
    """
    shortest = min(s.size for s in signals)
    frequency, density = _average(signals, step, shortest)[:2]
    strongest = frequency[1 + int(np.argmax(density[1:]))]
    wanted = max(round(WAVELENGTHS / (strongest * step)), shortest // MOST_SEGMENTS, 8)
    return shortest if wanted > 2 * shortest // 3 else int(wanted)


def _average(signals: Sequence[Floats], step: float, segment: int) -> tuple[Floats, Floats, int]:
    window = hann(segment, sym=False)
    scale = 2.0 * step / float(window @ window)
    pieces = [s[i : i + segment] for s in signals for i in segment_starts(s.size, segment)]
    spectra = [np.abs(np.fft.rfft(window * piece)) ** 2 for piece in pieces]
    density = scale * np.mean(spectra, axis=0)
    density[0] /= 2.0
    if segment % 2 == 0:
        density[-1] /= 2.0
    return np.asarray(np.fft.rfftfreq(segment, step), np.float64), np.asarray(density), len(pieces)


def overlap_dof(signals: Sequence[Floats], segment: int) -> float:
    """ν = 2K / (1 + 2·Σ_j (1 − j/K)·ρ_j), ρ_1 = (Σ w(n)·w(n + D))² / (Σ w²)² (Welch 1967); summed over
    records."""
    window = hann(segment, sym=False)
    shift = max(segment // 2, 1)
    rho = (float(window[:-shift] @ window[shift:]) / float(window @ window)) ** 2
    total = 0.0
    for signal in signals:
        count = len(segment_starts(signal.size, segment))
        if count:
            total += 2.0 * count / (1.0 + 2.0 * (1.0 - 1.0 / count) * rho)
    return total


def welch(signals: Sequence[Floats], step: float, segment: int | None = None) -> Density:
    """Density of records (rows of a pass, or passes): line off, Hann, half-overlapping segments, all
    averaged.

    step : distance (m) or time (s) between samples; segment : samples, chosen by `choose_segment` when None.
    """
    records = [prepared(s) for s in signals]
    size = choose_segment(records, step) if segment is None else segment
    frequency, density, count = _average(records, step, size)
    dof = overlap_dof(records, size)
    low, high = band_of(dof)
    return Density(frequency, density, density * low, density * high, dof, count, size * step)


def band_of(dof: float) -> tuple[float, float]:
    """Factors ν/χ² that make a density's 95 % band of ν degrees of freedom."""
    chi2 = 2.0 * gammaincinv(dof / 2.0, [(1.0 + LEVEL) / 2.0, (1.0 - LEVEL) / 2.0])
    return float(dof / chi2[0]), float(dof / chi2[1])


def cross(inputs: Sequence[Floats], outputs: Sequence[Floats], step: float, segment: int) -> Cross:
    """Coherence and transfer from inputs to outputs, segments as in `welch`."""
    window = hann(segment, sym=False)
    scale = 2.0 * step / float(window @ window)
    auto_x, auto_y = np.zeros(segment // 2 + 1), np.zeros(segment // 2 + 1)
    mixed, count = np.zeros(segment // 2 + 1, np.complex128), 0
    for x, y in zip(inputs, outputs, strict=True):
        x, y = prepared(x), prepared(y)
        for i in segment_starts(x.size, segment):
            fx, fy = np.fft.rfft(window * x[i : i + segment]), np.fft.rfft(window * y[i : i + segment])
            auto_x, auto_y = auto_x + np.abs(fx) ** 2, auto_y + np.abs(fy) ** 2
            mixed = mixed + np.conj(fx) * fy
            count += 1
    tiny = np.finfo(np.float64).tiny
    response = mixed / np.maximum(auto_x, tiny)
    coherence = np.abs(mixed) ** 2 / np.maximum(auto_x * auto_y, tiny)
    density = scale * np.asarray(auto_x) / max(count, 1)
    return Cross(
        np.asarray(np.fft.rfftfreq(segment, step), np.float64),
        np.asarray(coherence),
        np.abs(response),
        np.angle(response),
        density,
        count,
        1.0 / max(count, 1),
    )


def peaks(density: Density, most: int = 3) -> tuple[Peak, ...]:
    """The strongest local maxima with the rms of the signal in each one's half-power band."""
    values = density.density
    found, _ = find_peaks(values, prominence=LEAST_PROMINENCE * float(values[1:].max()))
    ordered = sorted(found, key=lambda i: -values[i])[:most]
    return tuple(_peak(density, int(i)) for i in ordered)


def half_power_band(values: Floats, place: int) -> tuple[int, int]:
    """First and last sample about a peak where the density stays at half of it or more.

    No narrower than the Hann window's main lobe, two samples to each side: there a pure sine has all its
    power.
    """
    low, high = max(place - 2, 1), min(place + 2, values.size - 1)
    while low > 1 and values[low - 1] >= 0.5 * values[place]:
        low -= 1
    while high < values.size - 1 and values[high + 1] >= 0.5 * values[place]:
        high += 1
    return low, high


def _peak(density: Density, place: int) -> Peak:
    low, high = half_power_band(density.density, place)
    width = float(density.frequency[1])
    power = float(density.density[low : high + 1].sum()) * width
    band = (float(density.frequency[low]) - 0.5 * width, float(density.frequency[high]) + 0.5 * width)
    return Peak(float(density.frequency[place]), float(density.density[place]), float(np.sqrt(power)), band)
