"""report.html and report.pdf: self-contained, readable, escaped, the same again from what is stored."""

from __future__ import annotations

import csv
import datetime as dt
import io
import json
import re
import sys
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pypdf
import pytest
import report_samples as samples
from fpdf.enums import MethodReturnValue
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from smts_validate.pipeline import figures_style as style
from smts_validate.pipeline import report, report_charts, report_pass, report_pdf
from smts_validate.pipeline.remake import Exports, RemakeError, remake
from smts_validate.pipeline.report_blocks import Chart, Curve, Missing, Panel, Table, charts_of, tables_of
from smts_validate.pipeline.result import PassResult, read_result, write_result
from smts_validate.pipeline.result_mcap import write_result_log
from smts_validate.pipeline.sections import SECTIONS
from smts_validate.sensors import manifest as manifests


class Page(HTMLParser):
    """Elements of a page with their attributes, and its text outside scripts and styles."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.words: list[str] = []
        self.inside: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag in {"script", "style"}:
            self.inside.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if self.inside and tag == self.inside[-1]:
            self.inside.pop()

    def handle_data(self, data: str) -> None:
        if not self.inside:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def _made(folder: Path, result: PassResult) -> Path:
    return write_result(folder / "out", result, report.finish)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _made(tmp_path_factory.mktemp("report"), samples.pass_result())


@pytest.fixture(scope="module")
def html(out: Path) -> str:
    return (out / "report.html").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def page(html: str) -> Page:
    return Page(html)


def test_page_asks_nothing_of_the_network_and_is_under_a_megabyte(html: str, page: Page) -> None:
    assert len(html.encode()) < 1_000_000
    for _, attributes in page.elements:
        for name in ("src", "href", "action", "data"):
            value = attributes.get(name) or ""
            assert not re.match(r"(https?:)?//", value), value
    assert "@import" not in html
    assert not re.search(r"url\(\s*['\"]?(https?:)?//", html)


def test_first_screen_holds_verdict_scope_reason_and_numbers_beside_the_papers(page: Page) -> None:
    head = page.text[: page.text.index("Contents")]
    for words in ("inconclusive", "scope: this pass", "One direction only.", "7.1", "4.0 to 9.5", "11", "9"):
        assert words in head, words
    assert "–" in head  # the yaw discrepancy is null: a dash, never 0 or None
    assert "None" not in head


def test_what_manifests_say_is_escaped(html: str, page: Page) -> None:
    assert "<script>alert(1)" not in html
    assert "<b>Meadow" not in html
    assert "dry <script>alert(1)</script> & windy" in page.text
    assert "Lower <b>Meadow</b>" in page.text


def test_no_id_stands_twice_and_every_anchor_has_its_target(page: Page) -> None:
    ids = Counter(a["id"] for _, a in page.elements if a.get("id"))
    assert [name for name, count in ids.items() if count > 1] == []
    targets = {a["href"] for tag, a in page.elements if tag == "a" and (a.get("href") or "").startswith("#")}
    assert {f"#{name}" for name in ids} >= targets
    referenced = {word for _, a in page.elements for word in re.findall(r"url\(#([^)]+)\)", str(a))}
    assert referenced <= set(ids)


def test_every_chart_has_a_still_picture_with_words_and_a_caption(page: Page, out: Path) -> None:
    charts = charts_of(report.sections_of(read_result(out)))
    figures = [a for tag, a in page.elements if tag == "figure"]
    pictures = [a for tag, a in page.elements if tag == "div" and a.get("class") == "still"]
    assert [f["id"] for f in figures] == [f"figure-{c.key}" for c in charts]
    assert [p["aria-label"] for p in pictures] == [c.alt for c in charts]
    assert all(c.caption and c.x_label and all(p.y_label for p in c.panels) for c in charts)
    assert sum(tag == "figcaption" for tag, _ in page.elements) == len(charts)


def test_tables_say_what_they_hold_and_which_cells_are_headings(page: Page) -> None:
    tables = sum(tag == "table" for tag, _ in page.elements)
    assert tables == sum(tag == "caption" for tag, _ in page.elements)
    assert all(a.get("scope") in {"col", "row"} for tag, a in page.elements if tag == "th")


@pytest.mark.parametrize("module", SECTIONS, ids=lambda m: m.__name__.rpartition(".")[2])
def test_a_section_tells_something_of_any_pass(module: Any, out: Path) -> None:
    view = read_result(out)
    bare = replace(view, comparison={}, plots={}, metrics={"run": view.metrics["run"]})
    no_rows = replace(
        bare, lines=(), trajectory={**view.trajectory, "row": np.full(view.trajectory["row"].size, -1)}
    )
    for each in (view, bare, no_rows):
        section = module.build(each)
        assert section.title
        assert section.blocks
        for chart in charts_of((section,)):
            values = np.concatenate([c.y for p in chart.panels for c in p.curves])
            assert np.isfinite(values).any(), f"{chart.key} is an empty chart"


def test_pass_without_a_row_says_why_there_is_nothing_to_compare(out: Path) -> None:
    view = read_result(out)
    none = replace(
        view,
        lines=(),
        comparison={},
        trajectory={**view.trajectory, "row": np.full(view.trajectory["row"].size, -1)},
    )
    sections = {s.key: s for s in report.sections_of(none)}
    for key in ("trajectories", "yaw", "residuals"):
        (block,) = sections[key].blocks
        assert isinstance(block, Missing)
        assert "60 m" in block.text


def test_tractor_alone_is_reported_without_a_seeder(tmp_path: Path) -> None:
    made = _made(tmp_path, samples.pass_result(seeder=False))
    text = Page((made / "report.html").read_text(encoding="utf-8")).text
    assert "Tractor alone" in text
    for chart in charts_of(report.sections_of(read_result(made))):
        assert not any("seeder" in panel.y_label for panel in chart.panels), chart.key


def test_imposed_tractor_is_never_shown_as_simulated(out: Path, tmp_path: Path) -> None:
    view = read_result(out)
    steering = {"source": None, "testable": False}
    imposed = replace(view, metrics={**view.metrics, "steering": steering})
    sections = {section.key: section for section in report.sections_of(imposed)}
    for key in ("trajectories", "yaw"):
        tractor, seeder = charts_of((sections[key],))[0].panels
        assert [curve.name for curve in tractor.curves] == ["measured"]
        assert [curve.name for curve in seeder.curves] == ["measured", "simulated"]
    words = " ".join(
        block.text for s in sections.values() for block in s.blocks if isinstance(block, Missing)
    )
    assert "the measured tractor is imposed" in words
    assert "cannot be tested on this pass" in words
    write_result_log(tmp_path / "result.mcap", imposed)
    with AnyReader([tmp_path / "result.mcap"], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        topics = {connection.topic for connection in reader.connections}
    assert "/simulated/seeder/pose" in topics
    assert "/simulated/tractor/pose" not in topics


def test_same_result_gives_the_same_report(out: Path, tmp_path: Path) -> None:
    again = _made(tmp_path, samples.pass_result())
    for name in ("report.html", "report.pdf", "result.mcap"):
        assert (again / name).read_bytes() == (out / name).read_bytes(), name


def test_reports_come_again_from_what_is_stored(out: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    for path in out.iterdir():
        if path.name not in {"report.html", "report.pdf", "result.mcap"}:
            (copy / path.name).write_bytes(path.read_bytes())
    assert remake(copy) == copy / "report.html"
    for name in ("report.html", "report.pdf", "result.mcap"):
        assert (copy / name).read_bytes() == (out / name).read_bytes(), name
    assert not [path for path in copy.iterdir() if path.name.startswith(".")]


def test_folder_without_a_result_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RemakeError, match="holds no results"):
        remake(tmp_path)


@pytest.mark.slow
def test_exports_are_figures_in_three_formats_and_tables_in_two(out: Path, tmp_path: Path) -> None:
    view = read_result(out)
    sections = report.sections_of(view)
    figures = report.write_figures(sections, tmp_path / "figures")
    assert {p.suffix for p in figures} == {".svg", ".pdf", ".png"}
    assert len(figures) == 3 * len(charts_of(sections))
    tables = report.write_tables(sections, tmp_path / "tables")
    assert len(tables) == 2 * len(tables_of(sections))
    assert all(path.stat().st_size > 0 for path in (*figures, *tables))
    remake(out, Exports(tables=("csv",)))
    assert {path.suffix for path in (out / "tables").iterdir()} == {".csv"}


TABLE = Table(
    "t", "Costs & gains_1", ("name, with comma", "50 %"), (("a_b", "−1.5\u00a0%"), ('quote "x"', "2 ± 1")),
)  # fmt: skip


def test_csv_reads_back_as_the_table() -> None:
    rows = list(csv.reader(io.StringIO(report.table_csv(TABLE))))
    assert rows == [list(TABLE.columns), ["a_b", "−1.5 %"], ['quote "x"', "2 ± 1"]]


def test_latex_escapes_its_own_signs() -> None:
    text = report.table_latex(TABLE)
    assert r"a\_b & $-$1.5~\% \\" in text
    assert r"\caption{Costs \& gains\_1}" in text
    assert not re.search(r"(?<!\\)[%#]", text)


@pytest.mark.parametrize(
    ("cell", "numeric"),
    [("4.0 to 9.5 %", True), ("−0.02°", True), ("–", True), ("0.001 (0.061)", True), ("12.0 cm", True),
     ("4 rows doubled", False), ("east", False), ("", False), ("(unnamed)", False)],
)  # fmt: skip
def test_only_columns_of_numbers_are_set_as_numbers(cell: str, numeric: bool) -> None:
    table = Table("t", "c", ("name", "value"), (("a", "1.0"), ("b", cell)))
    assert table.numeric == (False, numeric)


def test_pdf_is_numbered_has_the_verdict_and_no_pixels(out: Path) -> None:
    document = pypdf.PdfReader(out / "report.pdf")
    pages = [page.extract_text() for page in document.pages]
    assert "inconclusive" in pages[0]
    for number, text in enumerate(pages, 1):
        assert f"{number} / {len(pages)}" in text
    assert not any(page["/Resources"].get("/XObject") for page in document.pages)
    whole = " ".join("\n".join(pages).split())
    for chart in charts_of(report.sections_of(read_result(out))):
        assert all(panel.y_label in whole for panel in chart.panels), chart.key
    assert document.metadata is not None
    assert document.metadata.title == "Adequacy report: sample-1"


def test_signs_that_the_pdfs_font_lacks_become_boxes_without_a_word(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    text = samples.toml().replace("Lower <b>Meadow</b>", "玉米 \\u0001 🌽")
    odd = replace(samples.pass_result(), manifest=manifests.parse(text), manifest_text=text)
    made = _made(tmp_path, odd)
    assert "玉米" in Page((made / "report.html").read_text(encoding="utf-8")).text
    assert "Field □□ □ □" in pypdf.PdfReader(made / "report.pdf").pages[0].extract_text()
    assert caplog.text == ""
    assert capfd.readouterr() == ("", "")


def test_endless_note_is_cut_in_the_pdf_and_whole_in_the_page(tmp_path: Path) -> None:
    text = samples.toml().replace('notes = "dry', f'notes = "{"word " * 20_000}dry')
    made = _made(tmp_path, replace(samples.pass_result(), manifest=manifests.parse(text), manifest_text=text))
    pages = [page.extract_text() for page in pypdf.PdfReader(made / "report.pdf").pages]
    assert len(pages) < 20
    assert sum("the rest stands in report.html" in page for page in pages) == 1
    assert (made / "report.html").read_text(encoding="utf-8").count("word word") > 9_000


def test_pdf_has_bookmarks_for_its_sections(out: Path) -> None:
    document = pypdf.PdfReader(out / "report.pdf")
    titles = [str(item.title) for item in document.outline if not isinstance(item, list)]
    assert titles == [section.title for section in report.sections_of(read_result(out))]


def test_uplot_is_found_without_importing_its_package(html: str) -> None:
    assert "uPlot.js (μPlot)" in html
    assert "uplot" not in sys.modules


def test_a_file_that_uplot_lacks_is_named() -> None:
    with pytest.raises(report_charts.MissingFileError, match=r"nothing\.js"):
        report_charts.uplot_file("nothing.js")


def _chart(x: style.Floats, *curves: style.Floats, log_y: bool = False) -> Chart:
    panel = Panel("y, m", tuple(Curve(f"c{i}", "measured", x, y) for i, y in enumerate(curves)), log_y)
    return Chart("k", "t", "c", "a", "x, m", (panel,))


finite = st.floats(-1e6, 1e6, allow_nan=False)


@given(st.lists(finite | st.just(float("nan")), min_size=1, max_size=400), st.integers(1, 40))
def test_thinning_keeps_ends_and_extremes(values: list[float], buckets: int) -> None:
    y = np.array(values)
    keep = style.extremes(y, buckets)
    assert keep[0] == 0
    assert keep[-1] == y.size - 1
    assert (np.diff(keep) > 0).all()
    if np.isfinite(y).any():
        assert np.nanmin(y[keep]) == np.nanmin(y)
        assert np.nanmax(y[keep]) == np.nanmax(y)


def test_simulated_line_breaks_where_a_window_ends(out: Path) -> None:
    view = read_result(out)
    chart = next(c for c in charts_of(report.sections_of(view)) if c.key == "trajectories")
    panel = json.loads(report_charts.chart_json(style.thin(chart, 700)))["panels"][0]
    names = [curve["name"] for curve in panel["curves"]]
    drawn = panel["data"][1 + names.index("simulated")]
    windows = np.unique(view.comparison["window1"]).size
    inner = [i for i in range(1, len(drawn) - 1) if drawn[i] is None and drawn[i - 1] is not None]
    assert len(inner) == windows - 1
    assert None not in panel["data"][1 + names.index("measured (± 2 sd)")]


def test_thinned_chart_says_so_and_a_short_one_does_not() -> None:
    x = np.arange(10_000.0)
    thinned = style.thin(_chart(x, np.sin(x)), 500)
    assert 400 < thinned.drawn <= 510
    assert "of 10,000 points" in thinned.note
    assert style.thin(_chart(x[:300], x[:300]), 500).note == ""


def test_curves_of_one_panel_stay_on_one_grid_when_thinned() -> None:
    x = np.arange(5000.0)
    (panel,) = style.thin(_chart(x, np.sin(x), np.cos(x)), 400).chart.panels
    np.testing.assert_array_equal(panel.curves[0].x, panel.curves[1].x)


def test_page_data_are_the_series_to_four_digits_with_gaps_as_null() -> None:
    x = np.arange(5.0)
    y = np.array([1.23456789, np.nan, -100.0, 1e-9, 3.0])
    data = json.loads(report_charts.chart_json(style.thin(_chart(x, y), 100)))["panels"][0]["data"]
    assert data[0] == [0, 1, 2, 3, 4]
    assert data[1] == [1.2, None, -100.0, 0.0, 3.0]
    log = json.loads(report_charts.chart_json(style.thin(_chart(x, y, log_y=True), 100)))["panels"][0]["data"]
    assert log[1] == [1.23, None, -100.0, 1e-9, 3.0]


def test_page_data_cannot_close_their_script_element() -> None:
    chart = replace(_chart(np.arange(2.0), np.arange(2.0)), x_label="</script><b>, m")
    text = report_charts.chart_json(style.thin(chart, 10))
    assert "<" not in text
    assert json.loads(text)["x_label"] == "</script><b>, m"


def _luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(a: str, b: str) -> float:
    high, low = sorted((_luminance(a), _luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_curves_stand_out_from_paper_in_both_themes_as_wcag_asks() -> None:
    for role, colour in style.LIGHT.items():
        assert _contrast(colour, "#ffffff") >= 3.0, role
    for role, colour in style.DARK.items():
        assert _contrast(colour, "#14181d") >= 3.0, role


def test_words_stand_out_from_every_card_in_both_themes(html: str) -> None:
    sheet = html[html.index(":root") :]
    themes = re.findall(r":root \{(.*?)\}", sheet, re.S)[:2]
    for theme in themes:
        colours = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", theme))
        for ground in ("paper", "card"):
            for ink in ("ink", "muted", "link"):
                assert _contrast(colours[ink], colours[ground]) >= 4.5, (ink, ground)
        for word in ("good", "bad", "open"):
            assert _contrast(colours["ink"], colours[f"{word}-card"]) >= 4.5


def test_measured_and_simulated_differ_by_more_than_colour(out: Path) -> None:
    for chart in charts_of(report.sections_of(read_result(out))):
        for panel in chart.panels:
            kinds = {c.name: c.style for c in panel.curves}
            if {"measured", "simulated"} <= set(kinds):
                assert kinds["measured"] != kinds["simulated"], chart.key


def test_creation_date_is_the_runs_so_that_bytes_do_not_change(out: Path) -> None:
    metadata = pypdf.PdfReader(out / "report.pdf").metadata
    assert metadata is not None
    created = metadata.creation_date
    assert created is not None
    assert created.date() == dt.date(2025, 5, 15)


def test_pdf_breaks_text_as_its_library_does_and_a_long_word_inside(out: Path) -> None:
    sheet = report_pdf._sheet(report_pass.head_of(read_result(out)), dt.date(2025, 5, 14), report_pdf.FACES)
    sheet.set_font("Sans", "", 9.0)
    words = (
        "The windows' residuals after the bounded alignment, at equal distance along the line; gaps left out."
    )
    theirs = sheet.multi_cell(60.0, 4.5, words, dry_run=True, output=MethodReturnValue.LINES, align="L")
    assert report_pdf._broken(sheet, words, 60.0 - 2.0 * sheet.c_margin) == theirs
    lines = report_pdf._broken(sheet, f"before {'x' * 200} after\n\nend", 50.0)
    assert "".join(lines).replace(" ", "") == f"before{'x' * 200}afterend"
    assert lines[-2:] == ["", "end"]
    assert all(sheet.get_string_width(line) <= 50.0 for line in lines)
