"""Straightness of simulated runs along the x axis: one row of indices a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..model.simulate import BatchRun

Floats = NDArray[np.float64]
SEGMENT_SECONDS = 5.12  # of Welch's method: 0.2 Hz apart, 13 wavelengths of the paper's 2.5 Hz

# A row's columns; 1 the tractor's CoM, 2 the seeder's. m, degrees, (m/s²)²/Hz, Hz.
INDICES = (
    "max_deviation1", "max_deviation2", "range1", "range2", "r95_1", "r95_2", "rms1", "rms2",
    "yaw_range1_deg", "yaw_range2_deg", "peak1", "peak2", "peak_frequency1", "peak_frequency2",
)  # fmt: skip


@dataclass(frozen=True)
class Spectrum:
    """Density of lateral acceleration, (m/s²)²/Hz, at frequencies in Hz."""

    frequency: Floats
    density: Floats


def acceleration_spectrum(series: Floats, spacing: float) -> Spectrum:
    """Welch density along the last axis: Hann windows of 5.12 s, half overlapped, mean removed.

    All segments in one transform: a sweep takes tens of thousands of these.
    """
    samples = min(round(SEGMENT_SECONDS / spacing), series.shape[-1])
    window = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(samples) / samples)
    segments = sliding_window_view(series, samples, axis=-1)[..., :: samples - samples // 2, :]
    centred = segments - segments.mean(axis=-1, keepdims=True)
    power = np.abs(np.fft.rfft(centred * window, axis=-1)) ** 2 * spacing / np.sum(window**2)
    power[..., 1 : (samples + 1) // 2] *= 2.0  # one-sided: all but the mean and, of an even count, the last
    return Spectrum(np.asarray(np.fft.rfftfreq(samples, spacing), dtype=np.float64), power.mean(axis=-2))


def _lateral(deviation: Floats) -> tuple[float, float, float, float]:
    low, high = np.percentile(deviation, (2.5, 97.5))
    return (
        float(np.abs(deviation).max()),
        float(np.ptp(deviation)),
        float(high - low),
        float(np.sqrt(np.mean(deviation**2))),
    )


def run_indices(
    y1: Floats, y2: Floats, yaw1: Floats, yaw2: Floats, ay1: Floats, ay2: Floats, spacing: float
) -> Floats:
    """INDICES of one run, from deviations (m), headings (rad) and lateral accelerations (m/s²), each (n,)."""
    first, second = _lateral(y1), _lateral(y2)
    spectrum = acceleration_spectrum(np.stack([ay1, ay2]), spacing)
    top = spectrum.density.argmax(axis=1)
    lateral = [value for pair in zip(first, second, strict=True) for value in pair]
    yaws = [float(np.degrees(np.ptp(yaw))) for yaw in (yaw1, yaw2)]
    peaks = [float(spectrum.density[body, top[body]]) for body in (0, 1)]
    places = [float(spectrum.frequency[top[body]]) for body in (0, 1)]
    return np.array([*lateral, *yaws, *peaks, *places])


def batch_indices(
    batch: BatchRun, first: NDArray[np.int64], last: NDArray[np.int64], spacing: float
) -> Floats:
    """INDICES of every run of a batch over its samples first..last, (runs, indices); NaN where it
    diverged."""
    rows = np.full((len(batch.y1), len(INDICES)), np.nan)
    second = (batch.y2, batch.yaw2, batch.ay2)
    if second[0] is None or second[1] is None or second[2] is None:
        raise ValueError("straightness of both bodies is asked for; this machine has no seeder")
    y2, yaw2, ay2 = second[0], second[1], second[2]
    for i in range(len(rows)):
        part = slice(int(first[i]), int(last[i]))
        if np.isnan(batch.diverged_at[i]):
            rows[i] = run_indices(
                batch.y1[i, part], y2[i, part], batch.yaw1[i, part], yaw2[i, part],
                batch.ay1[i, part], ay2[i, part], spacing,
            )  # fmt: skip
    return rows
