"""Spectra, two that must not be mixed up: of the deviation over distance, of the acceleration over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..report_blocks import Block, Chart, Curve, Missing, Panel, Role, Section, Style, Table, Text
from ..report_view import PassView, PlotSeries
from ._common import deep, nothing_compared, number

Floats = NDArray[np.float64]

FINEST = 0.5  # 1/m: waves shorter than 2 m are the grid's and the smoother's, not the machine's
HIGHEST = 10.0  # Hz: above, nothing of the paper's Fig. 5 and mostly vibration
SPATIAL = (
    "Spatial density of the deviation from the line: at which wavelengths the run is crooked. The "
    "displacement beside each peak is the rms of its half-power band."
)
ACCELERATION = (
    "Density of the lateral acceleration of the centres of mass, the quantity of the paper's Fig. 5 "
    "(there 0.03 to 0.045 (m/s²)²/Hz between 2.5 and 7 Hz). The displacement that a peak stands for "
    "is printed beside it: at several hertz a large density moves the machine by a fraction of a "
    "millimetre."
)
SOURCE = "Measured acceleration of the {}: {}."
RESPONSE = (
    "Gain from the steering angle to the yaw rate of the tractor, at frequencies where the steering "
    "moves enough and the coherence is at least 0.5, beside the linear model's."
)


def build(view: PassView) -> Section:
    """The section."""
    if not view.plots.get("spatial") and not view.plots.get("acceleration"):
        return Section("spectra", "Spectra", (Missing(nothing_compared(view)),))
    blocks = [*_spatial(view), *_acceleration(view), *_coherence(view), *_response(view)]
    return Section("spectra", "Spectra", tuple(blocks))


def _spatial(view: PassView) -> list[Block]:
    panels = _panels(view, "spatial", "m³", FINEST)
    if not panels:
        return [Missing(nothing_compared(view))]
    chart = Chart(
        key="spectrum-deviation",
        title="Spatial density of the deviation",
        caption="Welch's method with a Hann window; bands are the 95 % bounds of χ².",
        alt=_peak_words(view, "spatial", "cycles per metre"),
        x_label="spatial frequency, 1/m",
        panels=panels,
        log_x=True,
    )
    return [Text(SPATIAL), chart, *_peaks(view, "spatial")]


def _acceleration(view: PassView) -> list[Block]:
    panels = _panels(view, "acceleration", "(m/s²)²/Hz", HIGHEST)
    if not panels:
        return [Missing("No lateral acceleration could be formed for this pass.")]
    sources = [
        SOURCE.format(body, entry["source"])
        for body, entry in (deep(view.metrics, "spectra", "acceleration") or {}).items()
    ]
    chart = Chart(
        key="spectrum-acceleration",
        title="Density of the lateral acceleration",
        caption="Compare the paper's Fig. 5. Bands are the 95 % bounds of χ². " + " ".join(sources),
        alt=_peak_words(view, "acceleration", "Hz"),
        x_label="frequency, Hz",
        panels=panels,
    )
    return [Text(ACCELERATION), chart, *_peaks(view, "acceleration")]


def _panels(view: PassView, plot: str, unit: str, high: float) -> tuple[Panel, ...]:
    """A panel a body: measured with its band, and simulated."""
    found = view.plots.get(plot) or {}
    panels = []
    for body in ("tractor", "seeder"):
        curves = [
            _curve(kind, role, found[f"{body} {kind}"], high, style)
            for kind, role, style in _KINDS
            if f"{body} {kind}" in found
        ]
        if curves:
            panels.append(Panel(f"{body}, {unit}", tuple(curves), log_y=True))
    return tuple(panels)


_KINDS: tuple[tuple[str, Role, Style], ...] = (
    ("measured", "measured", "line"),
    ("simulated", "simulated", "dash"),
)


def _curve(name: str, role: Role, series: PlotSeries, high: float, style: Style) -> Curve:
    inside = (series.x > 0.0) & (series.x <= high)

    def kept(values: Floats | None) -> Floats | None:
        # A logarithmic axis has no place for zero.
        return None if values is None else np.where(values[inside] > 0.0, values[inside], np.nan)

    y = kept(series.y)
    assert y is not None
    banded = name == "measured" and series.low is not None
    low, top = (kept(series.low), kept(series.high)) if banded else (None, None)
    return Curve(name, role, series.x[inside], y, low, top, style, "95 %" if banded else "")


def _peaks(view: PassView, kind: str) -> list[Block]:
    rows = []
    for body, entry in (deep(view.metrics, "spectra", kind) or {}).items():
        for key, what in (("peaks", "measured"), ("peaks_simulated", "simulated")):
            rows += [(f"{body}, {what}", *_peak_cells(peak, kind)) for peak in entry.get(key) or []]
    if not rows:
        return []
    columns = {
        "spatial": ("peak", "1/m", "wavelength, m", "density, m³", "displacement, mm"),
        "acceleration": ("peak", "Hz", "density, (m/s²)²/Hz", "rms, m/s²", "displacement, mm"),
    }[kind]
    caption = {
        "spatial": "Peaks of the deviation's spectrum",
        "acceleration": "Peaks of the acceleration's spectrum",
    }
    return [Table(f"peaks-{kind}", caption[kind], columns, tuple(rows))]


def _peak_cells(peak: Mapping[str, Any], kind: str) -> tuple[str, ...]:
    if kind == "spatial":
        first = (number(peak["frequency"], 4), number(peak["wavelength"], 1), _small(peak["density"]))
    else:
        first = (number(peak["frequency"], 2), _small(peak["density"]), number(peak["acceleration_rms"], 3))
    return (*first, _small(peak["displacement_mm"]))


def _small(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, int | float) else "–"


def _peak_words(view: PassView, kind: str, unit: str) -> str:
    parts = []
    for body, entry in (deep(view.metrics, "spectra", kind) or {}).items():
        if entry.get("peaks"):
            parts.append(f"{body} at {entry['peaks'][0]['frequency']:.3g} {unit}")
    return f"Highest measured peaks: {', '.join(parts) or 'none'}; the table below lists them."


def _coherence(view: PassView) -> list[Block]:
    found: Mapping[str, Mapping[str, Any]] = deep(view.metrics, "spectra", "coherence") or {}
    rows = tuple(
        (
            body,
            number(entry["frequency"], 4),
            number(entry["coherence"]),
            number(entry["gain"]),
            str(entry["segments"]),
        )
        for body, entry in found.items()
        if entry.get("coherence") is not None
    )
    if not rows:
        segments = max((int(entry.get("segments", 0)) for entry in found.values()), default=0)
        words = (
            "The coherence of simulated and measured deviation needs four segments or more; this "
            f"pass has {segments}."
        )
        return [Missing(words)] if found else []
    columns = ("body", "at the peak, 1/m", "coherence", "gain", "segments")
    return [Table("coherence", "Coherence and gain of the replay", columns, rows)]


def _response(view: PassView) -> list[Block]:
    values: Mapping[str, Any] = deep(view.metrics, "spectra", "steering") or {}
    curves = view.plots.get("steering") or {}
    if values.get("reason") or "measured" not in curves:
        reason = str(values.get("reason") or "it was not computed")
        return [Missing(f"The response of the yaw rate to the steering is not shown: {reason}.")]
    measured = _curve("measured", "measured", curves["measured"], HIGHEST, "points")
    model = _curve("linear model", "simulated", curves["linear model"], HIGHEST, "dash")
    points = values.get("points") or []
    chart = Chart(
        key="steering-response",
        title="Steering to yaw rate",
        caption=f"Gain over {len(points)} frequencies; excitation and coherence of each are in metrics.json.",
        alt=f"Measured gain at {len(points)} frequencies beside the linear model's curve.",
        x_label="frequency, Hz",
        panels=(Panel("gain, (rad/s)/rad", (measured, model)),),
        log_x=True,
    )
    return [Text(RESPONSE), chart]
