"""Charts drawn: data in, Figure out. The only module that imports matplotlib."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.text import Text
from matplotlib.textpath import TextPath
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator
from matplotlib.transforms import Affine2D, Transform

from . import figures_style as style
from .figures_marks import CLOSE, CURVE, LINE, MOVE, Box, Drawing, Ink, Pen, Trace, Words
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
    "lines.linewidth": 1.3, "legend.frameon": False, "legend.fontsize": 7.5, "svg.fonttype": "none",
    "pdf.fonttype": 42, "axes.unicode_minus": True, "path.simplify": True, "figure.dpi": 72.0,
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
        if not chart.to_scale:
            _share_x(figure)
        for axes in figure.axes:
            axes.apply_aspect()
            _rule(axes, height, labelled=axes is figure.axes[-1])
        figure.axes[-1].set_xlabel(chart.x_label)
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


def _rule(axes: Axes, height: float, labelled: bool) -> None:
    """Grid, ticks and their labels, at the places that matplotlib chooses for them.

    A tick of its own is three lines and two texts; here all of an axis are two lines and a text each, which
    halves the time of a figure.

    height : of the figure, mm; labelled : whether the x axis bears its labels
    """
    box = axes.get_position()
    across, up = WIDTH_MM * box.width, box.height * height  # mm
    for axis, length in ((axes.xaxis, up), (axes.yaxis, across)):
        upright = axis is axes.xaxis
        low, high = axis.get_view_interval()
        room = 1e-9 * (high - low)
        at = [float(v) for v in axis.get_majorticklocs() if low - room <= v <= high + room]
        formatter = axis.get_major_formatter()
        words = formatter.format_ticks(at) if labelled or not upright else []
        axis.set_major_locator(NullLocator())
        _line_up(axes, at, (0.0, 1.0), upright, color=style.GRID, linewidth=0.5, zorder=0.6)
        _line_up(axes, at, (0.0, -TICK_MM / length), upright, color=style.MUTED, linewidth=0.6, clip_on=False)
        _label(axes, at, words, -2.0 * TICK_MM / length, upright)
        if words and formatter.get_offset():
            axes.annotate(
                formatter.get_offset(), (1.0, 0.0) if upright else (0.0, 1.0), xycoords="axes fraction"
            )
    axes.xaxis.set_label_coords(0.5, -X_LABEL_MM / up)
    axes.yaxis.set_label_coords(-Y_LABEL_MM / across, 0.5)


TICK_MM, X_LABEL_MM, Y_LABEL_MM = 1.24, 6.5, 13.0  # length of a tick; where axes have their labels


def _across(axes: Axes, upright: bool) -> Transform:
    """Data along one axis, the other in fractions of the axes."""
    return axes.get_xaxis_transform() if upright else axes.get_yaxis_transform()


def _line_up(axes: Axes, at: Sequence[float], ends: tuple[float, float], upright: bool, **look: Any) -> None:
    """A stroke at each place of an axis, as one broken line."""
    along, over = np.repeat(at, 3), np.tile([*ends, np.nan], len(at))
    x, y = (along, over) if upright else (over, along)
    axes.add_artist(Line2D(x, y, transform=_across(axes, upright), solid_capstyle="butt", **look))


def _label(axes: Axes, at: Sequence[float], words: Sequence[str], off: float, upright: bool) -> None:
    ha, va = ("center", "top") if upright else ("right", "center_baseline")
    look: dict[str, Any] = {"size": 7.5, "color": style.MUTED, "clip_on": False}
    for value, text in zip(at, words, strict=False):
        x, y = (value, off) if upright else (off, value)
        axes.add_artist(Text(x, y, text, transform=_across(axes, upright), ha=ha, va=va, **look))


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


def record(figure: Figure) -> Drawing:
    """A figure as the marks that it is made of: laid out once, for the page and the PDF to write alike."""
    recorder = _Recorder(float(figure.bbox.width), float(figure.bbox.height))
    with mpl.rc_context(_rc()):
        figure.draw(recorder)
    return Drawing(recorder.width, recorder.height, tuple(recorder.marks))


class _Recorder(RendererBase):
    """What matplotlib draws on, at 72 dots an inch, so that its pixels are points."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__()
        self.width, self.height = width, height
        self.marks: list[Trace | Words] = []

    def flipy(self) -> bool:
        """Words are placed from below, as everything else is."""
        return False

    def get_canvas_width_height(self) -> tuple[float, float]:
        """Size of the figure."""
        return self.width, self.height

    def get_text_width_height_descent(
        self, s: str, prop: FontProperties, ismath: Any
    ) -> tuple[float, float, float]:
        """Extent of a line of words; reports use the same ones over and over."""
        return _extent_of(s, float(prop.get_size_in_points()), ismath)

    def draw_path(
        self, gc: GraphicsContextBase, path: Path, transform: Transform, rgbFace: Any = None
    ) -> None:
        """Keep a path; a line without what could not be told from it at this size."""
        pen, fill = _pen(gc), _ink(gc, rgbFace)
        if pen is None and fill is None:
            return
        line = fill is None
        clean = path.cleaned(
            transform, remove_nans=True, clip=(0.0, 0.0, self.width, self.height) if line else None,
            simplify=line and path.should_simplify, curves=True,
        )  # fmt: skip
        self.marks.append(_trace(clean, pen, fill, _clip(gc)))

    def draw_markers(
        self, gc: GraphicsContextBase, marker_path: Path, marker_trans: Transform, path: Path,
        trans: Transform, rgbFace: Any = None,
    ) -> None:  # fmt: skip
        """Keep marks; round ones as dots, which are lines of no length with round ends."""
        ink, codes = _ink(gc, rgbFace), marker_path.codes
        if ink is None or codes is None or not np.equal(codes, Path.CURVE4).any():
            super().draw_markers(gc, marker_path, marker_trans, path, trans, rgbFace)
            return
        at = trans.transform(path.vertices)
        at = at[np.isfinite(at).all(axis=1)]
        width = float(marker_path.get_extents(marker_trans).width) + gc.get_linewidth()
        pen = Pen(ink, width, cap="round")
        self.marks.append(Trace(np.repeat(at, 2, axis=0), (MOVE + LINE) * len(at), pen, clip=_clip(gc)))

    def draw_text(
        self, gc: GraphicsContextBase, x: float, y: float, s: str, prop: FontProperties, angle: float,
        ismath: Any = False, mtext: Text | None = None,
    ) -> None:  # fmt: skip
        """Keep a line of words."""
        size = float(prop.get_size_in_points())
        width = float(self.get_text_width_height_descent(s, prop, ismath)[0])
        anchor = ANCHORS[mtext.get_horizontalalignment()] if mtext is not None and not angle else 0.5
        self.marks.append(Words(float(x), float(y), s, size, to_hex(gc.get_rgb()), angle, width, anchor))


@lru_cache(maxsize=4096)
def _extent_of(text: str, size: float, ismath: Any) -> tuple[float, float, float]:
    """Width, height and descent, pt, in the reports' font."""
    font = FontProperties(family=RC["font.family"], size=size)
    width, height, descent = RendererBase().get_text_width_height_descent(text, font, ismath)
    return float(width), float(height), float(descent)


ANCHORS = {"left": 0.0, "center": 0.5, "right": 1.0}
CAPS: dict[str, Any] = {"butt": "butt", "round": "round", "projecting": "square"}


def _pen(gc: GraphicsContextBase) -> Pen | None:
    ink = _ink(gc, gc.get_rgb())
    if ink is None or not gc.get_linewidth() > 0.0:
        return None
    dash = tuple(float(length) for length in np.ravel(gc.get_dashes()[1] or ()))
    return Pen(ink, float(gc.get_linewidth()), dash, CAPS[gc.get_capstyle()])


def _ink(gc: GraphicsContextBase, colour: Any) -> Ink | None:
    if colour is None:
        return None
    opacity = float(gc.get_alpha() if gc.get_forced_alpha() or len(colour) < 4 else colour[3])
    return Ink(to_hex(colour), opacity) if opacity > 0.0 else None


def _clip(gc: GraphicsContextBase) -> Box | None:
    box = gc.get_clip_rectangle()
    return None if box is None else (float(box.x0), float(box.y0), float(box.width), float(box.height))


LETTERS = bytes.maketrans(
    bytes([Path.MOVETO, Path.LINETO, Path.CLOSEPOLY]), f"{MOVE}{LINE}{CLOSE}".encode("ascii")
)


def _trace(path: Path, pen: Pen | None, fill: Ink | None, clip: Box | None) -> Trace:
    """A path without gaps as a trace."""
    codes = np.asarray(path.codes, dtype=np.uint8)
    if codes[codes != Path.CLOSEPOLY].max(initial=0) >= Path.CURVE3:
        return _curved(path, pen, fill, clip)
    codes = codes[codes != Path.STOP]
    points = np.asarray(path.vertices, dtype=np.float64)[: codes.size][codes != Path.CLOSEPOLY]
    return Trace(points, codes.tobytes().translate(LETTERS).decode("ascii"), pen, fill, clip)


def _curved(path: Path, pen: Pen | None, fill: Ink | None, clip: Box | None) -> Trace:
    """A path with curves as a trace; a quadratic curve is a cubic one with its control point shared out."""
    points: list[style.Floats] = []
    letters = ""
    for flat, code in path.iter_segments(simplify=False, curves=True):
        at = np.reshape(flat, (-1, 2))
        if code == Path.CURVE3:
            at = np.array([(points[-1] + 2.0 * at[0]) / 3.0, (at[1] + 2.0 * at[0]) / 3.0, at[1]])
        letter = {Path.MOVETO: MOVE, Path.LINETO: LINE, Path.CLOSEPOLY: CLOSE}.get(code, CURVE)
        points.extend(at if letter != CLOSE else ())
        letters += letter
    return Trace(np.array(points), letters, pen, fill, clip)


@lru_cache(maxsize=64)
def draw_equation(equation: Equation) -> Drawing:
    """A displayed equation, by matplotlib's own mathematics, as outlines."""
    width, height = WIDTH_MM * MM * 72.0, 14.0 * MM * 72.0
    with mpl.rc_context(_rc({"mathtext.fontset": "stix"})):
        outline = TextPath((0.0, 0.0), f"${equation.tex}$", size=11.0)
    box = outline.get_extents()
    place = Affine2D().translate(0.04 * width, 0.5 * (height - float(box.y0 + box.y1)))
    fill = Ink(style.INK)
    return Drawing(width, height, (_curved(outline.transformed(place), None, fill, None),))


def write_files(charts: Sequence[Chart], folder: FilePath) -> list[FilePath]:
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
