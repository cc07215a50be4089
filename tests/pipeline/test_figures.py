"""Charts drawn by matplotlib: vectors with the page's colours, faithful to the data."""

from __future__ import annotations

import datetime as dt
import io
import re
from pathlib import Path
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
import pypdf
import pytest
from fpdf import FPDF
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Annotation
from smts_validate.pipeline import figures, figures_pdf, figures_svg
from smts_validate.pipeline import figures_style as style
from smts_validate.pipeline.figures_marks import Drawing, Ink, Pen, Trace, Words
from smts_validate.pipeline.report_blocks import Chart, Curve, Equation, Panel

SVG = "{http://www.w3.org/2000/svg}"
DEJAVU = Path(mpl.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"


def _chart(key: str = "k", points: int = 50, **options: bool) -> Chart:
    x = np.linspace(0.0, 100.0, points)
    y = np.sin(x / 7.0)
    curves = (
        Curve("measured", "measured", x, y, y - 0.1, y + 0.1, band_name="± 2 sd"),
        Curve("simulated", "simulated", x, 1.1 * y, style="dash"),
    )
    panels = (Panel("tractor, cm", curves, levels=((0.5, "threshold"),)), Panel("seeder, cm", curves[:1]))
    return Chart(key, "Title", "Caption", "Alt", "distance, m", panels, **options)


def _svg(chart: Chart) -> str:
    return figures_svg.svg(figures.record(figures.draw(chart)), chart.key)


def _pdf(*drawings: Drawing) -> bytes:
    """A page a drawing."""
    sheet = FPDF("P", "mm", "A4")
    sheet.set_creation_date(dt.datetime(2026, 5, 4, tzinfo=dt.UTC))
    sheet.add_font("Sans", "", DEJAVU)
    for drawing in drawings:
        sheet.add_page()
        figures_pdf.place(sheet, drawing, 18.0, 20.0, "Sans")
    return bytes(sheet.output())


def test_svg_is_well_formed_and_keeps_its_words_as_text() -> None:
    root = ElementTree.fromstring(_svg(_chart()))
    words = {(e.text or "").strip() for e in root.iter(f"{SVG}text")}
    assert {
        "measured",
        "simulated",
        "± 2 sd",
        "threshold",
        "tractor, cm",
        "seeder, cm",
        "distance, m",
    } <= words


def test_svg_takes_every_colour_from_the_page() -> None:
    text = _svg(_chart())
    without = re.sub(r"var\(--[\w-]+,#[0-9a-f]{6}\)", "", text)
    assert not re.search(r"#[0-9a-f]{6}\b(?!\w)", re.sub(r'(href|id)="[^"]*"|url\([^)]*\)', "", without))


def test_no_two_colours_of_the_page_are_one_in_the_drawing() -> None:
    colours = list(figures_svg.page_colours().values())
    assert len(colours) == len(set(colours))


def test_ids_of_two_charts_in_one_page_do_not_meet() -> None:
    first, second = (set(re.findall(r'id="([^"]+)"', _svg(_chart(key)))) for key in ("one", "two"))
    assert first
    assert not first & second


def test_page_shows_what_matplotlib_itself_would_draw(tmp_path: Path) -> None:
    chart = _chart()
    own, theirs = tmp_path / "own.svg", tmp_path / "theirs.svg"
    own.write_text(_svg(chart), encoding="utf-8")
    with mpl.rc_context({**figures.RC, "svg.hashsalt": "k"}):
        figures.draw(chart).savefig(theirs, metadata={"Date": None})
    words, expected = (_placed_words(path) for path in (own, theirs))
    assert sorted(words) == sorted(expected)
    for text, places in expected.items():
        np.testing.assert_allclose(np.sort(words[text], axis=0), np.sort(places, axis=0), atol=0.5)
    curves, expected_curves = (_curves(path) for path in (own, theirs))
    assert len(curves) == len(expected_curves) == 3
    for curve, theirs_curve in zip(curves, expected_curves, strict=True):
        np.testing.assert_allclose(curve[[0, -1]], theirs_curve[[0, -1]], atol=0.11)
        np.testing.assert_allclose(np.ptp(curve, axis=0), np.ptp(theirs_curve, axis=0), atol=0.11)


def _placed_words(path: Path) -> dict[str, list[tuple[float, float]]]:
    """Where each text stands, pt."""
    found: dict[str, list[tuple[float, float]]] = {}
    for element in ElementTree.parse(path).getroot().iter(f"{SVG}text"):
        x, y = element.attrib["x"], element.attrib["y"]
        found.setdefault(element.text or "", []).append((float(x), float(y)))
    return found


def _curves(path: Path) -> list[np.ndarray]:
    """Corners of every long open line, absolute."""
    found = []
    for element in ElementTree.parse(path).getroot().iter(f"{SVG}path"):
        steps = re.findall(r"([MLl]) ?(\S+?) (-?[\d.]+)", element.attrib["d"])
        starts = sum(letter == "M" for letter, _, _ in steps)
        if (
            len(steps) > 10
            and starts == 1
            and "fill:none" in element.attrib.get("style", "").replace(" ", "")
        ):
            points = np.array([(float(x), float(y)) for _, x, y in steps])
            relative = np.array([letter == "l" for letter, _, _ in steps])
            found.append(np.cumsum(points, axis=0) if relative[1:].all() else points)
    return found


def test_shortened_paths_stay_within_a_tenth_of_a_point() -> None:
    points = np.random.default_rng(1).uniform(0.0, 480.0, (300, 2))
    path = figures_svg._path(Trace(points, "M" + "L" * 299), 500.0)
    steps = np.array([float(v) for v in re.findall(r"-?[\d.]+", path)]).reshape(-1, 2)
    np.testing.assert_allclose(np.cumsum(steps, axis=0), points * [1, -1] + [0, 500.0], atol=0.051)
    assert path.count("l") == 299


def test_closed_and_curved_paths_are_written_as_svg_spells_them() -> None:
    corners = np.array([[0, 0], [10, 0], [10, 10], [20, 20], [30, 20]], dtype=float)
    assert figures_svg._path(Trace(corners, "MLLZML"), 0.0) == "M0 0l10 0l0 -10zM20 -20l10 0"
    curve = np.array([[0, 0], [1, 1], [2, 2], [3, 3]], dtype=float)
    assert figures_svg._path(Trace(curve, "MC"), 10.0) == "M0 10C1 9 2 8 3 7"


def test_quadratic_curves_are_the_same_as_cubic_ones() -> None:
    path = mpl.path.Path([(0, 0), (3, 6), (9, 0)], [1, 3, 3])
    (trace,) = [figures._curved(path, None, None, None)]
    assert trace.letters == "MC"
    t = np.linspace(0.0, 1.0, 11)[:, None]
    start, control, end = np.array(path.vertices)
    quadratic = (1 - t) ** 2 * start + 2 * t * (1 - t) * control + t**2 * end
    a, b, c, d = trace.points
    cubic = (1 - t) ** 3 * a + 3 * t * (1 - t) ** 2 * b + 3 * t**2 * (1 - t) * c + t**3 * d
    np.testing.assert_allclose(cubic, quadratic, atol=1e-12)


def test_words_stay_where_they_are_aligned_in_another_font() -> None:
    words = Words(100.0, 50.0, "a < b", 8.0, "#123456", width=40.0, anchor=1.0)
    upright = Words(100.0, 50.0, "up", 8.0, "#123456", angle=90.0, width=40.0, anchor=0.5)
    root = ElementTree.fromstring(figures_svg.svg(Drawing(200.0, 80.0, (words, upright)), "k"))
    flat, turned = root.iter(f"{SVG}text")
    assert (flat.text, flat.attrib["x"], flat.attrib["y"]) == ("a < b", "140.0", "30.0")
    assert "text-anchor:end" in flat.attrib["style"]
    assert (turned.attrib["x"], turned.attrib["y"]) == ("100.0", "10.0")
    assert turned.attrib["transform"] == "rotate(-90 100.0 10.0)"


def test_round_marks_are_dots_as_wide_as_matplotlib_draws_them() -> None:
    x = np.arange(5.0)
    panel = Panel("y", (Curve("c", "measured", x, x, style="points"),))
    drawing = figures.record(figures.draw(Chart("k", "t", "c", "a", "x", (panel,))))
    (dots, _) = [m for m in drawing.marks if isinstance(m, Trace) and m.pen and m.pen.cap == "round"]
    assert dots.letters == "ML" * 5
    np.testing.assert_array_equal(dots.points[::2], dots.points[1::2])
    assert dots.pen is not None
    assert np.isclose(dots.pen.width, 3.0 + 1.0)  # size, and its edge half in and half out


def test_same_chart_gives_the_same_bytes() -> None:
    assert _svg(_chart()) == _svg(_chart())
    pages = [_pdf(figures.record(figures.draw(_chart()))) for _ in range(2)]
    assert pages[0] == pages[1]


def test_pdf_holds_the_words_of_a_figure_at_their_places() -> None:
    drawing = figures.record(figures.draw(_chart()))
    (page,) = pypdf.PdfReader(io.BytesIO(_pdf(drawing))).pages
    found: dict[str, tuple[float, float]] = {}
    page.extract_text(visitor_text=lambda text, cm, tm, *_: found.setdefault(text.strip(), (tm[4], tm[5])))
    (words,) = [m for m in drawing.marks if isinstance(m, Words) and m.text == "distance, m"]
    left, bottom = 18.0 / 25.4 * 72.0, (297.0 - 20.0) / 25.4 * 72.0 - drawing.height
    np.testing.assert_allclose(found["distance, m"], (left + words.x, bottom + words.y), atol=0.02)
    assert {"tractor, cm", "seeder, cm", "simulated", "± 2 sd", "threshold"} <= set(found)


def test_pdf_strokes_and_fills_as_asked() -> None:
    line = np.array([[1.0, 2.0], [3.0, 4.0], [3.0, 5.0]])
    pen = Pen(Ink("#ff0000"), 2.0, (3.0, 1.0), "round")
    marks = (
        Trace(line, "MLL", pen, clip=(0.0, 0.0, 9.0, 9.0)),
        Trace(line, "MLLZ", fill=Ink("#00ff00", 0.2)),
    )
    page = pypdf.PdfReader(io.BytesIO(_pdf(Drawing(10.0, 10.0, marks)))).pages[0]
    content = page["/Contents"].get_object().get_data().decode("latin1")
    x, y = 18.0 / 25.4 * 72.0, (297.0 - 20.0) / 25.4 * 72.0 - 10.0
    path = f"{x + 1:.2f} {y + 2:.2f} m\n{x + 3:.2f} {y + 4:.2f} l\n{x + 3:.2f} {y + 5:.2f} l\n"
    assert f"{path}S" in content
    assert f"{path}h\nf" in content
    assert "1.000 0.000 0.000 RG 2 w [3 1] 0 d 1 J" in content
    assert f"{x:.2f} {y:.2f} 9.00 9.00 re W n" in content
    states = page["/Resources"]["/ExtGState"].values()
    assert [float(state.get_object()["/ca"]) for state in states if "/ca" in state.get_object()] == [0.2]


def test_equation_is_drawn_as_outlines_inside_its_strip() -> None:
    equation = Equation("<math></math>", r"D = \dfrac{\sqrt{M}}{R_{95}}", "D is root M over R95")
    drawing = figures.draw_equation(equation)
    (outline,) = drawing.marks
    assert isinstance(outline, Trace)
    assert outline.letters.count("M") >= 9  # D, =, the bar, the root's two, M, R, 9, 5
    low, high = outline.points.min(axis=0), outline.points.max(axis=0)
    assert low.min() > 0.0
    assert high[0] < drawing.width
    assert high[1] < drawing.height
    assert np.isclose(low[1] + high[1], drawing.height, atol=1.0)


def test_map_is_drawn_to_scale() -> None:
    x, y = np.array([0.0, 120.0, 120.0, 0.0]), np.array([0.0, 0.0, 30.0, 30.0])
    panel = Panel("North, m", (Curve("tractor", "tractor", x, y),))
    figure = figures.draw(Chart("map", "t", "c", "a", "East, m", (panel,), to_scale=True))
    (axes,) = figure.axes
    figures.record(figure)  # the aspect is settled when drawing
    corner, unit = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)])
    assert np.isclose(*(unit - corner), rtol=1e-3)


@pytest.mark.parametrize("scale", [1.0, 123.0, 3e-8])
def test_ticks_stand_and_read_as_matplotlibs_own(scale: float) -> None:
    x = np.linspace(0.0, 97.0, 200)
    panel = Panel("y, m", (Curve("c", "measured", x, scale * np.sin(x)),))
    with mpl.rc_context(figures.RC):
        (axes,) = figures.draw(Chart("k", "t", "c", "a", "x, m", (panel,))).axes
        plain = Figure(figsize=axes.get_figure().get_size_inches())
        expected = plain.add_axes(axes.get_position())
        expected.set(xlim=axes.get_xlim(), ylim=axes.get_ylim())
        plain.draw_without_rendering()
        inside = [
            (label.get_text(), round(place / scale_of, 9))
            for axis, scale_of in ((expected.xaxis, 1.0), (expected.yaxis, scale))
            for label, place in zip(axis.get_ticklabels(), axis.get_ticklocs(), strict=True)
            if axis.get_view_interval()[0] <= place <= axis.get_view_interval()[1]
        ]
        offsets = {axis.get_offset_text().get_text() for axis in (expected.xaxis, expected.yaxis)} - {""}
    ours = [artist for artist in axes.texts if not isinstance(artist, Annotation)]
    drawn = [
        (text.get_text(), round(x, 9) if text.get_ha() == "center" else round(y / scale, 9))
        for text in ours
        for x, y in [text.get_position()]
    ]
    assert drawn == inside
    assert {artist.get_text() for artist in axes.texts if isinstance(artist, Annotation)} == offsets


def test_panels_share_their_distance_axis() -> None:
    figure = figures.draw(_chart())
    first, second = (axes.get_xlim() for axes in figure.axes)
    assert first == second


def test_drawn_curve_keeps_the_extremes_of_a_long_series() -> None:
    x = np.arange(20_000.0)
    y = np.zeros(x.size)
    y[12_345] = 7.0
    panel = Panel("y, m", (Curve("c", "measured", x, y),))
    (axes,) = figures.draw(Chart("k", "t", "c", "a", "x, m", (panel,))).axes
    drawn = axes.lines[0].get_ydata()
    assert np.max(drawn) == 7.0
    assert np.size(drawn) <= style.STILL_POINTS + 2


def test_every_word_of_a_figure_leaves_ink_on_a_picture() -> None:
    with mpl.rc_context(figures.RC):
        figure = figures.draw(_chart())
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    ink = np.asarray(canvas.buffer_rgba())[::-1, :, :3].min(axis=2) < 160
    words = [text for axes in figure.axes for text in (*axes.texts, axes.yaxis.label)]
    words += [figure.axes[-1].xaxis.label]
    assert len(words) > 15
    for text in words:
        box = text.get_window_extent()
        part = ink[int(box.y0) : int(box.y1) + 1, int(box.x0) : int(box.x1) + 1]
        assert part.any(), text.get_text()


def test_files_are_written_in_three_formats(tmp_path: Path) -> None:
    files = figures.write_files([_chart("one"), _chart("two")], tmp_path / "figures")
    assert sorted(p.name for p in files) == [
        f"{k}.{e}" for k in ("one", "two") for e in ("pdf", "png", "svg")
    ]
    assert (tmp_path / "figures" / "one.png").read_bytes().startswith(b"\x89PNG")
