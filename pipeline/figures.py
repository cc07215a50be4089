"""Charts drawn: data in, Figure out. The only module that imports matplotlib."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_pdf import FigureCanvasPdf, PdfPages
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from . import figures_style as style
from .report_blocks import Chart, Curve, Equation, Panel

WIDTH_MM = 174.0
PANEL_MM = (46.0, 38.0, 32.0, 27.0)  # height of a panel in a chart of one, two, three, four and more
FRAME_MM = 17.0  # room for the x label and ticks
LEGEND_MM = 6.0
MM = 1.0 / 25.4

DECADES = 1e-6  # of the greatest value: a logarithmic axis shows no less
DASHES: dict[str, Any] = {"dash": (0, (4, 1.6)), "dots": (0, (1, 1.4))}
RC: dict[str, Any] = {
    "font.family": ["DejaVu Sans"], "font.size": 8.0, "axes.labelsize": 8.0, "axes.linewidth": 0.6,
    "axes.edgecolor": style.MUTED, "axes.labelcolor": style.INK, "text.color": style.INK,
    "xtick.color": style.MUTED, "ytick.color": style.MUTED, "xtick.labelsize": 7.5, "ytick.labelsize": 7.5,
    "xtick.major.width": 0.6, "ytick.major.width": 0.6, "axes.spines.top": False, "axes.spines.right": False,
    "axes.grid": True, "grid.color": style.GRID, "grid.linewidth": 0.5, "axes.axisbelow": True,
    "lines.linewidth": 1.3, "legend.frameon": False, "legend.fontsize": 7.5, "svg.fonttype": "none",
    "pdf.fonttype": 42, "axes.unicode_minus": True, "path.simplify": True, "figure.dpi": 100.0,
}  # fmt: skip


def _rc(more: Mapping[str, Any] | None = None) -> Any:
    """matplotlib's settings for our drawings; it types their names, which a mapping cannot tell it."""
    return {**RC, **(more or {})}


def height_mm(chart: Chart) -> float:
    """Height of the drawn chart, mm."""
    if chart.to_scale:
        return _map_height(chart)
    panels = len(chart.panels)
    return PANEL_MM[min(panels, len(PANEL_MM)) - 1] * panels + FRAME_MM - LEGEND_MM


def draw(chart: Chart) -> Figure:
    """The chart as a matplotlib figure, `WIDTH_MM` wide, long series thinned."""
    chart = style.thin(chart, style.STILL_POINTS).chart
    with mpl.rc_context(_rc()):
        height = height_mm(chart)
        figure = Figure(figsize=(WIDTH_MM * MM, height * MM))
        for index, panel in enumerate(chart.panels):
            axes = figure.add_axes(_frame(index, len(chart.panels), height))
            _draw_panel(axes, chart, panel)
            if index == len(chart.panels) - 1:
                axes.set_xlabel(chart.x_label)
            else:
                axes.tick_params(labelbottom=False)
        if not chart.to_scale:
            _share_x(figure)
    return figure


def _frame(index: int, panels: int, height: float) -> tuple[float, float, float, float]:
    """Axes rectangle (left, bottom, width, height), in figure fractions, of panel `index` from the top."""
    left, right, bottom = 17.0, 3.0, 11.0
    each = (height - bottom) / panels
    low = height - (index + 1) * each
    return left / WIDTH_MM, low / height, 1.0 - (left + right) / WIDTH_MM, (each - LEGEND_MM) / height


def _share_x(figure: Figure) -> None:
    limits = [axes.get_xlim() for axes in figure.axes]
    for axes in figure.axes:
        axes.set_xlim(min(low for low, _ in limits), max(high for _, high in limits))


def _draw_panel(axes: Axes, chart: Chart, panel: Panel) -> None:
    handles = [handle for curve in panel.curves for handle in _draw_curve(axes, curve)]
    for value, label in panel.levels:
        level = axes.axhline(value, color=style.LIGHT["reference"], linewidth=0.9, linestyle=":", label=label)
        handles += [level] if label else []
    axes.set_ylabel(panel.y_label)
    if chart.log_x:
        axes.set_xscale("log")
        _plain_powers(axes.xaxis)
    if panel.log_y:
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        axes.set_ylim(max(low, DECADES * high), high)
        _plain_powers(axes.yaxis)
    if chart.to_scale:
        axes.set_aspect("equal", adjustable="datalim")
    if chart.discrete:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(x=0.01)
    axes.legend(
        handles=handles, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=6, borderaxespad=0.1,
        handlelength=1.8, columnspacing=1.2,
    )  # fmt: skip


def _plain_powers(axis: Axis) -> None:
    """Powers of ten in plain signs: ten times faster than matplotlib's mathematics, and text in the page."""
    axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: style.power(value)))


def _draw_curve(axes: Axes, curve: Curve) -> list[Line2D | Patch]:
    colour = style.LIGHT[curve.role]
    handles: list[Line2D | Patch] = []
    if curve.style == "bars":
        width = 0.8 * float(np.diff(curve.x).min()) if curve.x.size > 1 else 0.5
        axes.bar(curve.x, curve.y, width, color=colour)
        return [Patch(color=colour, label=curve.name)]
    if curve.style != "none":
        line = (
            {"linestyle": "none"} if curve.style == "points" else {"linestyle": DASHES.get(curve.style, "-")}
        )
        mark: dict[str, Any] = (
            {"marker": "o", "markersize": 3.0} if curve.style in {"points", "marked"} else {}
        )
        (drawn,) = axes.plot(curve.x, curve.y, color=colour, label=curve.name, **line, **mark)
        handles += [drawn] if curve.name else []
    if curve.low is not None and curve.high is not None:
        if curve.style == "points":
            axes.vlines(curve.x, curve.low, curve.high, color=colour, linewidth=0.9)
        else:
            axes.fill_between(curve.x, curve.low, curve.high, color=colour, alpha=0.2, linewidth=0.0)
        if curve.band_name:
            handles.append(Patch(color=colour, alpha=0.2, linewidth=0.0, label=curve.band_name))
    return handles


def _map_height(chart: Chart) -> float:
    """A map is as high as its ground is, within 35 and 150 mm."""
    curves = [curve for panel in chart.panels for curve in panel.curves]
    wide = _extent([curve.x for curve in curves])
    high = _extent([curve.y for curve in curves])
    return float(np.clip((WIDTH_MM - 25.0) * high / wide if wide > 0.0 else 150.0, 35.0, 150.0)) + FRAME_MM


def _extent(values: Sequence[style.Floats]) -> float:
    finite = np.concatenate(values)
    finite = finite[np.isfinite(finite)]
    return float(np.ptp(finite)) if finite.size else 0.0


def svg(figure: Figure, key: str) -> str:
    """A drawn figure as inline SVG for a page: text stays text, the colours are the page's own."""
    with mpl.rc_context(_rc({"svg.hashsalt": key})):
        buffer = io.StringIO()
        canvas: Any = FigureCanvasSVG(figure)
        canvas.print_svg(buffer, metadata={"Date": None, "Creator": None})
    return _inline(buffer.getvalue(), key)


def _inline(text: str, key: str) -> str:
    """Strip what only a file needs, and hand colours over to the page's variables."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'<g id="[^"]*">', "<g>", text)
    text = re.sub(r' width="[\d.]+pt"| height="[\d.]+pt"', "", text, count=2)
    text = re.sub(r"<!--.*?-->|\n\s*", lambda found: "" if found[0][0] == "<" else " ", text, flags=re.S)
    text = re.sub(r' d="([^"]*)"', _compact, text)
    text = text.replace('style type="text/css">*{', f'style type="text/css">#{svg_id(key)} *{{')
    for name, colour in page_colours().items():
        text = text.replace(colour, f"var(--{name},{colour})")
    return text.replace("<svg ", f'<svg id="{svg_id(key)}" aria-hidden="true" ', 1)


def _compact(path: re.Match[str]) -> str:
    """A path of straight lines in relative tenths of a point: a third of the length, the same picture."""
    text = path[1]
    if re.search(r"[CQ]", text):
        return path[0]
    out, last = [], (0, 0)
    for letter, x, y in re.findall(r"z|([ML]) (\S+) (\S+)", text):
        if not letter:  # what follows a closed path is an absolute M, so the pen's place does not matter
            out.append("z")
            continue
        at = round(10.0 * float(x)), round(10.0 * float(y))
        step = at if letter == "M" else (at[0] - last[0], at[1] - last[1])
        out.append(f"{letter if letter == 'M' else 'l'}{step[0] / 10:g} {step[1] / 10:g}")
        last = at
    return f' d="{"".join(out)}"'


def svg_id(key: str) -> str:
    """Id of a chart's SVG in a page."""
    return f"svg-{key}"


def page_colours() -> dict[str, str]:
    """Names of the page's colour variables, and the colour each stands for in a drawn figure."""
    roles = {f"c-{role}": colour for role, colour in style.LIGHT.items()}
    return roles | {"ink": style.INK, "muted": style.MUTED, "grid": style.GRID, "paper": "#ffffff"}


def pdf_pages(figures: Sequence[Figure]) -> bytes:
    """The figures as one PDF, a page each, as vectors; the same bytes for the same figures."""
    buffer = io.BytesIO()
    with mpl.rc_context(_rc()), PdfPages(buffer, metadata={"CreationDate": None, "Creator": None}) as pages:
        for figure in figures:
            FigureCanvasPdf(figure)
            pages.savefig(figure)
    return buffer.getvalue()


def draw_equation(equation: Equation) -> Figure:
    """A displayed equation as a figure, by matplotlib's own mathematics."""
    with mpl.rc_context(_rc({"mathtext.fontset": "stix"})):
        figure = Figure(figsize=(WIDTH_MM * MM, 14.0 * MM))
        figure.text(0.04, 0.5, f"${equation.tex}$", fontsize=11.0, va="center")
    return figure


def write_files(charts: Sequence[Chart], folder: Path) -> list[Path]:
    """Each chart as SVG, PDF and PNG (300 dpi) in `folder`; the files written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for chart in charts:
        with mpl.rc_context(_rc({"svg.hashsalt": chart.key})):
            figure = draw(chart)
            for kind, metadata in (("svg", {"Date": None}), ("pdf", {"CreationDate": None}), ("png", {})):
                path = folder / f"{chart.key}.{kind}"
                figure.savefig(path, dpi=300, metadata=metadata)
                written.append(path)
    return written
