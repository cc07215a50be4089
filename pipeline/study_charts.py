"""Charts and tables of the theoretical study, as plain values; `figures.write_files(charts, folder)` draws
them.

Figs 3, 4 and 5 of the paper with its axes, the table paper/ours/ratio, response surfaces, and the linear
analysis.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .report_blocks import Chart, Curve, Panel, Role, Table
from .study import Study, VersionStudy
from .study_linear import LinearMap, Response
from .study_plan import Version
from .study_response import BestDesign, Sensitivity, Surface

Floats = NDArray[np.float64]
HIGHEST = 10.0  # Hz, end of the paper's Fig. 5
ROLES: tuple[Role, ...] = ("tractor", "seeder", "third", "fourth", "residual")
NAMES = {
    "max_deviation1": "max deviation of O1, m",
    "max_deviation2": "max deviation of O2, m",
    "range1": "range of O1, m",
    "range2": "range of O2, m",
    "r95_1": "R95 of O1, m",
    "r95_2": "R95 of O2, m",
    "rms1": "rms deviation of O1, m",
    "rms2": "rms deviation of O2, m",
    "yaw_range1_deg": "range of the tractor's yaw, deg",
    "yaw_range2_deg": "range of the seeder's yaw, deg",
    "peak1": "peak of S(O1), (m/s²)²/Hz",
    "peak2": "peak of S(O2), (m/s²)²/Hz",
    "peak_frequency1": "frequency of S(O1)'s peak, Hz",
    "peak_frequency2": "frequency of S(O2)'s peak, Hz",
}
LABELS = {"speed": "v, m/s", "seeder.hitch_to_com": "l5, m", "tyre_pressure_mpa": "Pw, MPa"}


def version_title(version: Version) -> str:
    """The version with its three parameters."""
    return (
        f"{version.label}: v = {version.speed:g} m/s, l5 = {version.hitch_to_com:g} m, "
        f"Pw = {version.tyre_pressure_mpa:.2f} MPa"
    )


def _bodies(first: tuple[Floats, Floats], second: tuple[Floats | None, Floats | None]) -> tuple[Curve, ...]:
    curves = [Curve("tractor O1", "tractor", *first)]
    x, y = second
    if x is not None and y is not None:
        curves.append(Curve("seeder O2", "seeder", x, y))
    return tuple(curves)


def _titles(study: Study) -> str:
    return "; ".join(version_title(item.version) for item in study.versions)


def trajectories_chart(study: Study) -> Chart:
    """Fig. 3: deviation of both CoMs from the straight line over the distance."""
    panels = [
        Panel(
            f"{item.version.label}: deviation, m",
            _bodies((item.run.x1, item.run.y1), (item.run.x2, item.run.y2)),
        )
        for item in study.versions
    ]
    return Chart(
        key="study-fig3-trajectories",
        title="Trajectories of the centres of mass (the paper's Fig. 3)",
        caption=f"{_titles(study)}. Of {study.plan.seeds} soils the one whose range of O1 is the median.",
        alt="Both centres of mass swing about the line by a few centimetres.",
        x_label="distance, m",
        panels=tuple(panels),
    )


def yaw_chart(study: Study) -> Chart:
    """Fig. 4: yaw of both bodies over the distance."""
    panels = []
    for item in study.versions:
        run = item.run
        second = (run.x2, None if run.yaw2 is None else np.degrees(run.yaw2))
        panels.append(
            Panel(f"{item.version.label}: yaw, deg", _bodies((run.x1, np.degrees(run.yaw1)), second))
        )
    return Chart(
        key="study-fig4-yaw",
        title="Turning angles of tractor and seeder (the paper's Fig. 4)",
        caption=f"{_titles(study)}. The same runs as in the trajectories.",
        alt="Both yaw angles swing by one to three degrees.",
        x_label="distance, m",
        panels=tuple(panels),
    )


def _spectra(item: VersionStudy) -> tuple[Curve, ...]:
    curves = []
    for name, role, band in zip(("S(O1)", "S(O2)"), ROLES, item.spectra, strict=False):
        kept = band.frequency <= HIGHEST
        curves.append(
            Curve(name, role, band.frequency[kept], band.mean[kept], band.low[kept], band.high[kept],
                  band_name="5 to 95 % of single runs")
        )  # fmt: skip
    return tuple(curves)


def spectra_chart(study: Study) -> Chart:
    """Fig. 5: density of the lateral acceleration of both CoMs."""
    panels = [Panel(f"{item.version.label}: S, (m/s²)²/Hz", _spectra(item)) for item in study.versions]
    return Chart(
        key="study-fig5-spectra",
        title="Spectral densities of the lateral accelerations (the paper's Fig. 5)",
        caption=f"{_titles(study)}. Mean over {study.plan.seeds} soils; Welch, Hann windows of 5.12 s.",
        alt="Each density has one broad peak between 1 and 2 Hz.",
        x_label="frequency, Hz",
        panels=tuple(panels),
    )


def _number(value: float) -> str:
    return f"{value:.3f}" if abs(value) < 1.0 else f"{value:.2f}"


def comparison_block(study: Study) -> Table:
    """The paper's table beside ours: paper, ours (median), interval of runs, ratio."""
    rows = []
    for row in study.table:
        paper = _number(row.paper_low)
        if row.paper_high > row.paper_low:
            paper += f" to {_number(row.paper_high)}"
        interval = f"{_number(row.ours_low)} to {_number(row.ours_high)}"
        rows.append((NAMES[row.index], row.version, paper, _number(row.ours), interval, f"{row.ratio:.2f}"))
    return Table(
        key="study-table",
        caption="Paper and model; ours is the median over soils, the interval holds 90 % of single runs.",
        columns=("figure", "version", "paper", "ours", "5 to 95 %", "ratio"),
        rows=tuple(rows),
    )


def surface_chart(surface: Surface) -> Chart:
    """A response surface as families of curves: over the second parameter, a curve a level of the first, a
    panel a level of the third where there is one; further parameters stay in the middle."""
    names, bounds = surface.names, surface.bounds
    across = 1 if len(names) > 1 else 0
    x = np.linspace(bounds[across, 0], bounds[across, 1], 41)
    levels = [np.linspace(low, high, 3) for low, high in bounds]
    panels = []
    for level in levels[2] if len(names) > 2 else [None]:
        curves = []
        for role, first in zip(ROLES, levels[0] if len(names) > 1 else [None], strict=False):
            designs = np.tile(bounds.mean(axis=1), (x.size, 1))
            designs[:, across] = x
            if first is not None:
                designs[:, 0] = first
            if level is not None:
                designs[:, 2] = level
            name = surface.index if first is None else _value(names[0], first)
            curves.append(Curve(name, role, x, surface(designs)))
        where = NAMES.get(surface.index, surface.index) if level is None else _value(names[2], level)
        panels.append(Panel(where, tuple(curves)))
    return Chart(
        key=f"study-surface-{surface.index}".replace("_", "-"),
        title=f"Response surface: {NAMES.get(surface.index, surface.index)}",
        caption=(
            f"{NAMES.get(surface.index, surface.index)}: full quadratic of its logarithm over the designs, "
            f"which explains {100 * surface.r2:.1f} %."
        ),
        alt=f"{surface.index} against {', '.join(_label(name) for name in names)}.",
        x_label=_label(names[across]),
        panels=tuple(panels),
    )


def _value(name: str, value: float) -> str:
    """A parameter's value as text: "l5 = 2 m"."""
    symbol, _, unit = _label(name).partition(", ")
    return f"{symbol} = {value:.3g} {unit}".rstrip()


def _label(name: str) -> str:
    return LABELS.get(name, name)


def sensitivity_block(found: Sensitivity) -> Table:
    """Sobol indices with their intervals."""
    rows = tuple(
        (
            _label(name),
            f"{found.first[i]:.2f}", f"{found.first_interval[i, 0]:.2f} to {found.first_interval[i, 1]:.2f}",
            f"{found.total[i]:.2f}", f"{found.total_interval[i, 0]:.2f} to {found.total_interval[i, 1]:.2f}",
        )
        for i, name in enumerate(found.names)
    )  # fmt: skip
    columns = ("parameter", "first order", "95 %", "total", "95 %")
    return Table("study-sobol", "Share of the variance of ln(index) by parameter (Sobol).", columns, rows)


def best_block(best: BestDesign, base: Version) -> Table:
    """The straightest design against the base: change of each index with its interval over soils."""
    rows = tuple(
        (
            NAMES.get(effect.index, effect.index), f"{100 * (effect.ratio - 1):+.1f} %",
            f"{100 * (effect.low - 1):+.1f} to {100 * (effect.high - 1):+.1f} %",
        )
        for effect in best.effects
    )  # fmt: skip
    design = ", ".join(_value(name, value) for name, value in best.values.items())
    edges = ", ".join(_label(name).partition(",")[0] for name in best.on_bound)
    edge = f" ({edges} at the bound)" if edges else ""
    against = f"against version {base.label}; {best.soils} fresh soils"
    caption = f"Straightest by {NAMES[best.index]}: {design}{edge}, {against}."
    return Table("study-best", caption, ("index", "change", "95 %"), rows)


def linear_chart(found: LinearMap) -> Chart:
    """Damping, frequency and critical speed along one parameter."""
    x = found.values
    panels = (
        Panel("least damping ratio", (Curve("damping", "tractor", x, found.damping),)),
        Panel("its frequency, Hz", (Curve("natural frequency", "seeder", x, found.frequency),)),
        Panel("critical speed, m/s", (Curve("critical speed", "third", x, found.critical_speed),)),
    )
    return Chart(
        key=f"study-linear-{found.name}".replace("_", "-").replace(".", "-"),
        title=f"Modes of straight running against {_label(found.name)}",
        caption=f"{version_title(found.version)}, but for the axis' parameter. No curve: none found.",
        alt="Damping, natural frequency and critical speed.",
        x_label=_label(found.name),
        panels=panels,
    )


def response_chart(responses: Sequence[Response]) -> Chart:
    """Amplitude of the frequency responses from steering, a panel an output, a curve a version."""
    short = {
        "yaw_rate1": "w1, 1/s", "yaw_rate2": "w2, 1/s", "lateral_acceleration1": "a1, m/s²",
        "lateral_acceleration2": "a2, m/s²", "hitch_angle": "hitch, rad",
    }  # fmt: skip
    panels = [
        Panel(
            short[name],
            tuple(
                Curve(r.version.label, role, r.frequency, np.abs(r.gain[:, i]))
                for role, r in zip(ROLES, responses, strict=False)
            ),
            log_y=True,
        )
        for i, name in enumerate(responses[0].outputs)
    ]
    return Chart(
        key="study-response",
        title="Frequency response from the steering angle, per radian",
        caption="; ".join(version_title(r.version) for r in responses) + ".",
        alt="Gains fall beyond about one hertz.",
        x_label="frequency, Hz",
        panels=tuple(panels),
        log_x=True,
    )
