"""Spectra of a pass, two that must not be mixed up.

`spatial`: density of the deviation from the line, m³ over cycles per metre: straightness.
`acceleration`: density of the CoM's lateral acceleration, (m/s²)²/Hz over Hz: the paper's Fig. 5. Each
peak is stated
with the displacement it stands for, in mm: 0.03 (m/s²)²/Hz at 5 Hz is a fraction of a millimetre.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.linear import linearise
from ..model.machine import Machine
from .bounds import DEVIATION1, DEVIATION2
from .compare import Comparison
from .fusion.motion import Motion
from .report_view import PlotSeries
from .welch import Cross, Density, Peak, cross, peaks, welch

Floats = NDArray[np.float64]

LOWEST_ACCELERATION = 0.3  # Hz: below, drift of the smoothed motion rules the displacement equivalent
LEAST_SEGMENTS = 4  # for a coherence to mean anything
LEAST_EXCITATION = 10.0  # steering density over that of its own error
LEAST_COHERENCE = 0.5
BODIES = {1: DEVIATION1, 2: DEVIATION2}
NAMES = {1: "tractor", 2: "seeder"}


@dataclass(frozen=True)
class Spectra:
    """Everything spectral of a pass: `values` for metrics.json, `plots` the curves for the report."""

    values: Mapping[str, Any]
    plots: Mapping[str, Mapping[str, PlotSeries]]


def spectra_of(motion: Motion, comparison: Comparison, machine: Machine) -> Spectra:
    """Spatial and acceleration densities of both bodies, replay coherence, and steering → yaw rate."""
    if not comparison.rows:
        return Spectra({}, {})
    values: dict[str, Any] = {"spatial": {}, "acceleration": {}, "coherence": {}}
    plots: dict[str, dict[str, PlotSeries]] = {"spatial": {}, "acceleration": {}, "coherence": {}}
    for b, name in BODIES.items():
        if name in comparison.responses:
            _spatial(comparison, b, values, plots)
    for b in range(1, len(motion.bodies) + 1):
        _acceleration(motion, comparison, b, values, plots)
    values["steering"], plots["steering"] = _steering(motion, comparison, machine)
    return Spectra(values, plots)


def _spatial(
    comparison: Comparison, b: int, values: dict[str, Any], plots: dict[str, dict[str, PlotSeries]]
) -> None:
    """Density of measured and simulated deviation over the grid, and their coherence and gain."""
    name, step = BODIES[b], comparison.settings.grid_step
    measured = [r.measured[name] for r in comparison.rows]
    simulated = [r.measured[name] + r.residual[name] for r in comparison.rows]
    density = welch(measured, step)
    segment = round(density.segment_length / step)
    model = welch(simulated, step, segment)
    values["spatial"][NAMES[b]] = _density_values(density, "m3", "1/m") | {
        "peaks": [spatial_peak(p) for p in peaks(density)],
        "peaks_simulated": [spatial_peak(p) for p in peaks(model)],
    }
    plots["spatial"] |= {f"{NAMES[b]} measured": _series(density), f"{NAMES[b]} simulated": _series(model)}
    joint = cross(measured, simulated, step, segment)
    values["coherence"][NAMES[b]] = coherence_values(joint, density)
    plots["coherence"][f"{NAMES[b]} coherence"] = PlotSeries(joint.frequency[1:], joint.coherence[1:])
    plots["coherence"][f"{NAMES[b]} gain"] = PlotSeries(joint.frequency[1:], joint.gain[1:])


def _density_values(density: Density, unit: str, frequency_unit: str) -> dict[str, Any]:
    return {
        "unit": unit,
        "frequency_unit": frequency_unit,
        "segments": density.segments,
        "segment_length": density.segment_length,
        "dof": density.dof,
    }


def _series(density: Density) -> PlotSeries:
    return PlotSeries(density.frequency[1:], density.density[1:], density.low[1:], density.high[1:])


def spatial_peak(peak: Peak) -> dict[str, float]:
    """A peak of the deviation with its wavelength and the rms displacement of its band, mm."""
    return {
        "frequency": peak.frequency,
        "wavelength": 1.0 / peak.frequency,
        "density": peak.density,
        "displacement_mm": 1000.0 * peak.band_rms,
    }


def coherence_values(joint: Cross, density: Density) -> dict[str, Any]:
    """Coherence and gain of the replay at the measured peak; null with under four segments."""
    place = 1 + int(np.argmax(density.density[1:]))
    enough = joint.segments >= LEAST_SEGMENTS
    return {
        "segments": joint.segments,
        "bias": joint.bias,
        "frequency": float(joint.frequency[place]),
        "coherence": float(joint.coherence[place]) if enough else None,
        "gain": float(joint.gain[place]) if enough else None,
    }


def _acceleration(
    motion: Motion,
    comparison: Comparison,
    b: int,
    values: dict[str, Any],
    plots: dict[str, dict[str, PlotSeries]],
) -> None:
    """Density of the CoM's lateral acceleration over time, measured and simulated."""
    step = float(np.median(np.diff(motion.t)))
    source, whole = lateral_acceleration(motion, b)
    measured = [whole[r.row.samples] for r in comparison.rows]
    density = welch(measured, step, acceleration_segment(measured, step))
    simulated = _simulated_acceleration(comparison, b, step)
    values["acceleration"][NAMES[b]] = _density_values(density, "(m/s2)2/Hz", "Hz") | {
        "source": source,
        "peaks": [acceleration_peak(p) for p in _above(density)],
    }
    plots["acceleration"][f"{NAMES[b]} measured"] = _series(density)
    if simulated:
        segment = min(round(density.segment_length / step), min(s.size for s in simulated))
        model = welch(simulated, step, segment)
        values["acceleration"][NAMES[b]]["peaks_simulated"] = [acceleration_peak(p) for p in _above(model)]
        plots["acceleration"][f"{NAMES[b]} simulated"] = _series(model)


def acceleration_segment(signals: list[Floats], step: float) -> int:
    """Samples a segment: 2.5 periods of the lowest frequency of interest, at most the shortest record."""
    return min(round(2.5 / (LOWEST_ACCELERATION * step)), min(s.size for s in signals))


def lateral_acceleration(motion: Motion, b: int) -> tuple[str, Floats]:
    """The CoM's lateral acceleration, m/s², and what it was made of.

    From the body's IMD with lever arm moved and g·sin(roll) removed where fusion could; else from the
    smoothed
    motion, a = dv_lateral/dt + v·yaw rate, which holds nothing faster than the smoother follows.
    """
    body = motion.bodies[b - 1]
    if body.lateral_acceleration is not None:
        return "IMD at the centre of mass", np.nan_to_num(body.lateral_acceleration)
    return "smoothed motion", np.gradient(body.v_lateral, motion.t) + body.v * body.yaw_rate


def _simulated_acceleration(comparison: Comparison, b: int, step: float) -> list[Floats]:
    """The model's lateral acceleration, a record a window: joins between windows would be steps."""
    records = []
    for row in comparison.rows:
        for fit in row.fits:
            series = fit.run.ay1 if b == 1 else fit.run.ay2
            if series is None or (b == 1 and comparison.trailed):
                return []
            seconds = row.context.motion.t[fit.window.stop - 1] - row.context.motion.t[fit.window.start]
            own = fit.run.t[fit.index] - fit.run.t[fit.index][0]
            grid = np.arange(0.0, seconds, step)
            records.append(np.interp(grid, own, series[fit.index]))
    return records


def _above(density: Density) -> list[Peak]:
    return [p for p in peaks(density, most=5) if p.frequency >= LOWEST_ACCELERATION][:3]


def acceleration_peak(peak: Peak) -> dict[str, float]:
    """A peak of the acceleration with the displacement that its band stands for, mm rms: a/(2πf)² at the peak.

    Not ∫ S_a/(2πf)⁴ over the band: where the band reaches down to slow motion, that would state the slow motion.
    """
    return {
        "frequency": peak.frequency,
        "density": peak.density,
        "acceleration_rms": peak.band_rms,
        "displacement_mm": 1000.0 * peak.band_rms / (2.0 * np.pi * peak.frequency) ** 2,
    }


def _steering(
    motion: Motion, comparison: Comparison, machine: Machine
) -> tuple[dict[str, Any], dict[str, PlotSeries]]:
    """Gain from steering to the tractor's yaw rate where excitation suffices, beside the linear model's.

    Excitation: the steering's density over that of its stated error. A series made from the wheels' yaw
    rate less
    the body's own gyro shares that gyro's noise with the yaw rate, which the coherence then overstates.
    """
    steer = motion.steer_input
    if steer is None or comparison.trailed:
        return {"reason": "no independent steering series"}, {}
    step = float(np.median(np.diff(motion.t)))
    inputs = [steer.angle[r.row.samples] for r in comparison.rows]
    outputs = [motion.tractor.yaw_rate[r.row.samples] for r in comparison.rows]
    segment = acceleration_segment(inputs, step)
    joint = cross(inputs, outputs, step, segment)
    noise = error_density(float(np.mean(steer.sd)), steer.correlation_time, joint.frequency, step)
    excitation = joint.input_density / noise
    enough = (excitation >= LEAST_EXCITATION) & (joint.coherence >= LEAST_COHERENCE)
    enough &= (joint.segments >= LEAST_SEGMENTS) & (joint.frequency > 0.0)
    speed = float(np.mean([motion.tractor.v[r.row.samples].mean() for r in comparison.rows]))
    model = linearise(machine, speed, comparison.settings.simulation).frequency_response(joint.frequency)
    gain = np.where(enough, joint.gain, np.nan)
    values: dict[str, Any] = {
        "segments": joint.segments,
        "source": steer.source,
        "shares_gyro": steer.source == "wheels",
        "points": [
            {
                "frequency": float(f),
                "excitation": float(x),
                "coherence": float(c),
                "gain": float(g),
                "gain_model": float(np.abs(m)),
            }
            for f, x, c, g, m in zip(
                joint.frequency[enough],
                excitation[enough],
                joint.coherence[enough],
                gain[enough],
                model[enough, 0, 0],
                strict=True,
            )
        ],
    }
    if not enough.any():
        values["reason"] = "the steering moves too little beside its own error, or too few segments"
    return values, {
        "measured": PlotSeries(joint.frequency[1:], gain[1:]),
        "linear model": PlotSeries(joint.frequency[1:], np.abs(model[1:, 0, 0])),
    }


def error_density(sd: float, correlation: float, frequency: Floats, step: float) -> Floats:
    """One-sided density of the steering's stated error: 4σ²τ/(1 + (2πfτ)²), white (2σ²·step) without τ."""
    if not correlation > 0.0:
        return np.full(frequency.size, max(2.0 * sd**2 * step, 1e-30))
    density = 4.0 * sd**2 * correlation / (1.0 + (2.0 * np.pi * frequency * correlation) ** 2)
    return np.maximum(density, 1e-30)
