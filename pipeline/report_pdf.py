"""report.pdf: the same content as the page, set on A4, with page numbers; figures are placed as vectors."""

from __future__ import annotations

import datetime as dt
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from itertools import accumulate, takewhile
from pathlib import Path

from fpdf import FPDF
from fpdf.enums import XPos, YPos
from fpdf.fonts import TTFFont

from . import figures_style as style
from .figures_marks import Drawing
from .figures_pdf import POINT, place
from .report_blocks import Block, Chart, Equation, Missing, Section, Table, Text
from .report_head import Head

MARGIN = 18.0  # mm
PAGE_WIDTH, PAGE_HEIGHT = 210.0, 297.0
TEXT_WIDTH = PAGE_WIDTH - 2.0 * MARGIN
FOOT = 16.0  # mm at the bottom
MISSING_GLYPH = "□"
MOST_LINES, CUT = 40, "… the rest stands in report.html"  # of one cell: a row fits on a page
TABLE_START = 34.0  # mm that a table needs to begin on a page: caption, heading, a few rows
TABLE_SIZES, LINE = (7.5, 7.0, 6.5, 6.0), 3.9  # pt, mm
INK, MUTED, RULE, CARD = (29, 35, 41), (89, 99, 110), (200, 206, 213), (244, 245, 247)
VERDICT_COLOURS = {"adequate": (11, 107, 58), "not adequate": (163, 32, 13), "inconclusive": (122, 77, 0)}


class _Sheet(FPDF):
    """A4 with a running foot."""

    def __init__(self, short: str) -> None:
        super().__init__("P", "mm", "A4")
        self.short = short
        self.glyphs: frozenset[str] = frozenset()

    def normalize_text(self, text: str) -> str:
        """The text with a box for every sign that the font lacks: manifests may hold any."""
        if self.glyphs and not self.glyphs.issuperset(text):
            shown = text.replace("\t", " ")
            text = "".join(sign if sign in self.glyphs else MISSING_GLYPH for sign in shown)
        return str(super().normalize_text(text))

    def width_of(self, text: str) -> float:
        """Width in mm of one line in the font that is set."""
        assert self.current_font is not None  # set before anything is measured
        return float(
            self.current_font.get_text_width(self.normalize_text(text), self.font_size_pt, None)[1] / self.k
        )

    def line_of(self, x: float, y: float, height: float, text: str) -> None:
        """One line of text from x, in the middle of the height that begins at y; mm."""
        self.text(x, y + 0.5 * height + 0.3 * self.font_size, text)

    def footer(self) -> None:
        """Name of the run and page number of how many, under a rule."""
        self.set_y(-FOOT + 3.0)
        self.set_draw_color(*RULE)
        self.line(MARGIN, self.get_y(), PAGE_WIDTH - MARGIN, self.get_y())
        self.set_font("Sans", size=7.5)
        self.set_text_color(*MUTED)
        self.set_y(-FOOT + 4.5)
        self.cell(TEXT_WIDTH - 30.0, 5.0, self.short)
        self.cell(30.0, 5.0, f"{self.page_no()} / {{nb}}", align="R")


def render(head: Head, sections: Sequence[Section], drawn: Mapping[str, Drawing], date: dt.date) -> bytes:
    """The PDF as bytes.

    drawn : figures by the key of their chart, or by the words of their equation
    date : stands as the creation date, so that the same result gives the same bytes
    """
    missing = any(isinstance(block, Missing) for section in sections for block in section.blocks)
    sheet = _sheet(head, date, FACES if missing else FACES[:2])
    _first_page(sheet, head)
    for section in sections:
        _section(sheet, section, drawn)
    return bytes(sheet.output())


FACES = (("", "DejaVuSans.ttf"), ("B", "DejaVuSans-Bold.ttf"), ("I", "DejaVuSans-Oblique.ttf"))


def _sheet(head: Head, date: dt.date, faces: Sequence[tuple[str, str]]) -> _Sheet:
    sheet = _Sheet(head.short)
    fonts = _font_folder()
    for emphasis, file in faces:
        sheet.add_font("Sans", emphasis, fonts / file)
    covered = [frozenset(font.cmap) for font in sheet.fonts.values() if isinstance(font, TTFFont)]
    sheet.glyphs = frozenset(map(chr, frozenset.intersection(*covered) | {ord("\n")}))
    sheet.set_creation_date(dt.datetime.combine(date, dt.time(), dt.UTC))
    sheet.set_title(head.title)
    sheet.set_lang("en")
    sheet.set_margins(MARGIN, MARGIN, MARGIN)
    sheet.set_auto_page_break(True, FOOT + 4.0)
    sheet.add_page()
    return sheet


def _font_folder() -> Path:
    """DejaVu's fonts, which lie in matplotlib's data; found without importing it."""
    spec = find_spec("matplotlib")
    if spec is None or spec.origin is None:
        raise RuntimeError("matplotlib is not installed; run `pip install matplotlib`")
    return Path(spec.origin).parent / "mpl-data" / "fonts" / "ttf"


def _write(
    sheet: _Sheet, text: str, size: float = 9.0, emphasis: str = "", colour: tuple[int, ...] = INK
) -> None:
    sheet.set_font("Sans", emphasis, size)
    sheet.set_text_color(*colour)
    _paragraph(sheet, sheet.l_margin, PAGE_WIDTH - MARGIN - sheet.l_margin, 0.5 * size, text)


def _paragraph(sheet: _Sheet, left: float, width: float, height: float, text: str) -> None:
    """Text broken to a width, in lines of a height (mm), from where the page is filled to."""
    for line in _broken(sheet, text, width - 2.0 * sheet.c_margin):
        _room(sheet, height)
        sheet.line_of(left + sheet.c_margin, sheet.get_y(), height, line)
        sheet.set_xy(left, sheet.get_y() + height)


def _broken(sheet: _Sheet, text: str, room: float) -> list[str]:
    """The text in lines that fit into `room` mm: between words, or inside one that is wider than a line.

    Widths add up (nothing is kerned), so each word is measured once, however long the text is.
    """
    lines, space = [], sheet.width_of(" ")
    for paragraph in text.split("\n"):
        line, used = "", -space
        for word in paragraph.split(" "):
            wide = sheet.width_of(word)
            if used >= 0.0 and used + space + wide > room:
                lines.append(line)
                line, used = "", -space
            while wide > room:
                fits = _fitting(sheet, word, room)
                lines.append(word[:fits])
                word, wide = word[fits:], sheet.width_of(word[fits:])
            line, used = (f"{line} {word}" if used >= 0.0 else word), used + space + wide
        lines.append(line)
    return lines


def _fitting(sheet: _Sheet, word: str, room: float) -> int:
    """How many of the word's first signs fit into `room` mm; one at least."""
    ends = accumulate(map(sheet.width_of, word))
    return max(sum(1 for _ in takewhile(lambda end: end <= room, ends)), 1)


def _first_page(sheet: _Sheet, head: Head) -> None:
    _write(sheet, head.title, 16.0, "B")
    sheet.ln(1.0)
    _write(sheet, head.tested, 8.5, colour=MUTED)
    sheet.ln(3.0)
    colour = VERDICT_COLOURS.get(head.verdict, INK)
    top = sheet.get_y()
    sheet.set_left_margin(MARGIN + 4.0)
    _write(sheet, head.verdict_label, 9.0)
    _write(sheet, f"{head.sign} {head.verdict}", 17.0, "B", colour)
    sheet.ln(1.0)
    _write(sheet, head.meaning, 9.0)
    for reason in head.reasons:
        _bullet(sheet, reason)
    sheet.set_left_margin(MARGIN)
    sheet.set_fill_color(*colour)
    sheet.rect(MARGIN, top, 1.4, sheet.get_y() - top, style="F")
    sheet.ln(4.0)
    _numbers(sheet, head)
    _write(sheet, head.scope, 8.5, colour=MUTED)


def _bullet(sheet: _Sheet, text: str) -> None:
    """A listed sentence, its later lines under its first."""
    left = sheet.l_margin
    sheet.set_font("Sans", "", 9.0)
    _room(sheet, 4.5)
    sheet.line_of(left + sheet.c_margin, sheet.get_y(), 4.5, "•")
    _paragraph(sheet, left + 4.0, TEXT_WIDTH - 8.0, 4.5, text)
    sheet.set_x(left)


def _numbers(sheet: _Sheet, head: Head) -> None:
    """The headline numbers side by side."""
    top, bottom = sheet.get_y(), sheet.get_y()
    width = TEXT_WIDTH / max(len(head.numbers), 1)
    for index, number in enumerate(head.numbers):
        left = MARGIN + index * width
        sheet.set_xy(left, top)
        for text, size, emphasis, colour in (
            (number.name, 9.0, "B", INK),
            (number.value, 19.0, "B", INK),
            (number.interval, 8.5, "", MUTED),
        ):
            sheet.set_font("Sans", emphasis, size)
            sheet.set_text_color(*colour)
            _paragraph(sheet, left, width - 4.0, 0.5 * size, text)
        for name, value in number.details:
            sheet.set_x(left)
            sheet.set_font("Sans", "", 8.5)
            sheet.set_text_color(*MUTED)
            sheet.cell(width * 0.62, 4.6, name)
            sheet.set_text_color(*INK)
            sheet.cell(width * 0.30, 4.6, value, align="R", new_x=XPos.LEFT, new_y=YPos.NEXT)
        bottom = max(bottom, sheet.get_y())
    sheet.set_xy(MARGIN, bottom + 4.0)


def _section(sheet: _Sheet, section: Section, drawn: Mapping[str, Drawing]) -> None:
    _room(sheet, 24.0 + _opening_height(section.blocks, drawn))
    sheet.ln(5.0)
    sheet.start_section(section.title)
    _write(sheet, section.title, 12.5, "B")
    sheet.ln(1.5)
    for block in section.blocks:
        _block(sheet, block, drawn)


def _opening_height(blocks: Sequence[Block], drawn: Mapping[str, Drawing]) -> float:
    """Height of a section's first words with the figure that follows them: they are not torn apart."""
    words = 0.0
    for block in blocks[:3]:
        if isinstance(block, Chart):
            return words + _figure_height(block, drawn)
        if isinstance(block, Table):
            return words + TABLE_START
        if not isinstance(block, Text | Missing):
            break
        words += 4.6 * (1 + len(block.text) // 100) + 1.5
    return 0.0


def _figure_height(chart: Chart, drawn: Mapping[str, Drawing]) -> float:
    return POINT * drawn[chart.key].height + 16.0


def _room(sheet: _Sheet, needed: float) -> None:
    """Start a new page when `needed` mm are not left on this one."""
    if sheet.get_y() + needed > PAGE_HEIGHT - FOOT - 4.0:
        sheet.add_page()


def _block(sheet: _Sheet, block: Block, drawn: Mapping[str, Drawing]) -> None:
    if isinstance(block, Text):
        _write(sheet, block.text)
        sheet.ln(1.5)
    elif isinstance(block, Missing):
        _write(sheet, block.text, 9.0, "I", MUTED)
        sheet.ln(1.5)
    elif isinstance(block, Table):
        _table(sheet, block)
    elif isinstance(block, Equation):
        _place(sheet, drawn[block.words])
    else:
        _chart(sheet, block, drawn)


def _chart(sheet: _Sheet, chart: Chart, drawn: Mapping[str, Drawing]) -> None:
    _room(sheet, _figure_height(chart, drawn))
    _write(sheet, chart.title, 9.5, "B")
    sheet.ln(0.5)
    _place(sheet, drawn[chart.key])
    _write(sheet, chart.caption + style.thin(chart, style.STILL_POINTS).note, 8.0, colour=MUTED)
    sheet.ln(4.0)


def _place(sheet: _Sheet, drawing: Drawing) -> None:
    height = POINT * drawing.height
    _room(sheet, height)
    place(sheet, drawing, MARGIN, sheet.get_y(), "Sans")
    sheet.set_y(sheet.get_y() + height + 1.0)


def _table(sheet: _Sheet, table: Table) -> None:
    """A table with a rule under every row; its heading is repeated on each page that it reaches."""
    size, widths = _fitted(sheet, table)
    _room(sheet, TABLE_START)
    _write(sheet, table.caption, 9.0, "B")
    sheet.ln(0.8)
    sheet.set_text_color(*INK)
    sheet.set_draw_color(*RULE)
    aligned = ["R" if numeric else "L" for numeric in table.numeric]
    _table_row(sheet, aligned, table.columns, widths, size, "B")
    for row in table.rows:
        sheet.set_font("Sans", "", size)
        if sheet.get_y() + _row_height(sheet, row, widths) > PAGE_HEIGHT - FOOT - 4.0:
            sheet.add_page()
            _table_row(sheet, aligned, table.columns, widths, size, "B")
        _table_row(sheet, aligned, row, widths, size, "")
    sheet.ln(4.0)


def _table_row(
    sheet: _Sheet,
    aligned: Sequence[str],
    row: Sequence[str],
    widths: Sequence[float],
    size: float,
    emphasis: str,
) -> None:
    sheet.set_font("Sans", emphasis, size)
    top, height = sheet.get_y(), _row_height(sheet, row, widths)
    left = MARGIN
    for index, (text, width) in enumerate(zip(row, widths, strict=True)):
        align = aligned[index]
        for number, line in enumerate(_lines(sheet, text, width)):
            indent = 2.0 if align == "L" and index > 0 else 0.0
            spare = width - sheet.width_of(line) - sheet.c_margin
            start = spare if align == "R" else indent + sheet.c_margin
            sheet.line_of(left + start, top + 0.5 + number * LINE, LINE, line)
        left += width
    sheet.line(MARGIN, top + height, MARGIN + sum(widths), top + height)
    sheet.set_xy(MARGIN, top + height)


def _row_height(sheet: _Sheet, row: Sequence[str], widths: Sequence[float]) -> float:
    return 1.0 + LINE * max(len(_lines(sheet, text, width)) for text, width in zip(row, widths, strict=True))


def _lines(sheet: _Sheet, text: str, width: float) -> list[str]:
    """The text broken to a cell's width; the common case, one line, costs one measurement."""
    if not text or _text_width(sheet, text) <= width - 3.0:
        return [text]
    lines = _broken(sheet, text, width - 2.0 * sheet.c_margin)
    return lines if len(lines) <= MOST_LINES else [*lines[: MOST_LINES - 1], CUT]


def _fitted(sheet: _Sheet, table: Table) -> tuple[float, list[float]]:
    """Size of type in pt and column widths in mm with which the table fits; smaller before lines break."""
    sheet.set_font("Sans", "B", TABLE_SIZES[0])
    natural = [
        max(_text_width(sheet, row[column]) for row in (table.columns, *table.rows))
        for column in range(len(table.columns))
    ]
    for size in TABLE_SIZES:
        wanted = [width * size / TABLE_SIZES[0] + 4.0 for width in natural]
        spare = TEXT_WIDTH - sum(wanted)
        if spare >= 0.0:
            return size, [width + min(spare / len(wanted), 6.0) for width in wanted]
    fair = _fair_share(wanted, TEXT_WIDTH)
    return size, [min(width, fair) for width in wanted]


def _fair_share(wanted: Sequence[float], room: float) -> float:
    """The greatest width at which all columns, cut to it, fit into the room."""
    ordered = sorted(wanted)
    for index, width in enumerate(ordered):
        share = (room - sum(ordered[:index])) / (len(ordered) - index)
        if width > share:
            return share
    return ordered[-1]


def _text_width(sheet: _Sheet, text: str) -> float:
    return max((sheet.width_of(line) for line in text.splitlines()), default=0.0)
