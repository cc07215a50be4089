"""Charts drawn by matplotlib: vectors with the page's colours, faithful to the data."""

from __future__ import annotations

import io
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pypdf
from smts_validate.pipeline import figures
from smts_validate.pipeline import figures_style as style
from smts_validate.pipeline.report_blocks import Chart, Curve, Equation, Panel


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
    return figures.svg(figures.draw(chart), chart.key)


def test_svg_is_well_formed_and_keeps_its_words_as_text() -> None:
    root = ElementTree.fromstring(_svg(_chart()))
    words = {(e.text or "").strip() for e in root.iter("{http://www.w3.org/2000/svg}text")}
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
    colours = list(figures.page_colours().values())
    assert len(colours) == len(set(colours))


def test_ids_of_two_charts_in_one_page_do_not_meet() -> None:
    first, second = (set(re.findall(r'id="([^"]+)"', _svg(_chart(key)))) for key in ("one", "two"))
    assert first
    assert not first & second


def test_shortened_paths_stay_within_a_tenth_of_a_point() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(0.0, 480.0, (300, 2))
    path = "M {} {} ".format(*points[0]) + " ".join(f"L {x:.6f} {y:.6f}" for x, y in points[1:])
    short = re.sub(r' d="([^"]*)"', figures._compact, f' d="{path}"')
    assert len(short) < 0.6 * len(path)
    steps = np.array([float(v) for v in re.findall(r"-?[\d.]+", short)]).reshape(-1, 2)
    np.testing.assert_allclose(np.cumsum(steps, axis=0), points, atol=0.051)


def test_closed_paths_are_shortened_and_curved_ones_left() -> None:
    closed = ' d="M 0 0 L 10 0 L 10 10 z M 20 20 L 30 20"'
    assert re.sub(r' d="([^"]*)"', figures._compact, closed) == ' d="M0 0l10 0l0 10zM20 20l10 0"'
    curved = ' d="M 0 0 C 1 1 2 2 3 3"'
    assert re.sub(r' d="([^"]*)"', figures._compact, curved) == curved


def test_same_chart_gives_the_same_bytes() -> None:
    assert _svg(_chart()) == _svg(_chart())
    pages = [figures.pdf_pages([figures.draw(_chart())]) for _ in range(2)]
    assert pages[0] == pages[1]


def test_pdf_has_a_page_a_figure_with_its_words() -> None:
    equation = Equation("<math></math>", r"D = \dfrac{\sqrt{M}}{R_{95}}", "D is root M over R95")
    drawn = [figures.draw(_chart()), figures.draw_equation(equation)]
    pages = pypdf.PdfReader(io.BytesIO(figures.pdf_pages(drawn))).pages
    assert len(pages) == 2
    assert "simulated" in pages[0].extract_text()


def test_map_is_drawn_to_scale() -> None:
    x, y = np.array([0.0, 120.0, 120.0, 0.0]), np.array([0.0, 0.0, 30.0, 30.0])
    panel = Panel("North, m", (Curve("tractor", "tractor", x, y),))
    figure = figures.draw(Chart("map", "t", "c", "a", "East, m", (panel,), to_scale=True))
    (axes,) = figure.axes
    figures.svg(figure, "map")  # the aspect is settled when drawing
    corner, unit = axes.transData.transform([(0.0, 0.0), (1.0, 1.0)])
    assert np.isclose(*(unit - corner), rtol=1e-3)


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


def test_files_are_written_in_three_formats(tmp_path: Path) -> None:
    files = figures.write_files([_chart("one"), _chart("two")], tmp_path / "figures")
    assert sorted(p.name for p in files) == [
        f"{k}.{e}" for k in ("one", "two") for e in ("pdf", "png", "svg")
    ]
    assert (tmp_path / "figures" / "one.png").read_bytes().startswith(b"\x89PNG")
