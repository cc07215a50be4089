"""A drawing placed on a page of a PDF, as vectors and in the document's own font."""

from __future__ import annotations

import numpy as np
from fpdf import FPDF

from .figures_marks import CLOSE, CURVE, LINE, MOVE, Box, Drawing, Ink, Pen, Trace, Words

POINT = 25.4 / 72.0  # mm
CAPS = {"butt": 0, "round": 1, "square": 2}
OPERATORS = {MOVE: "m", LINE: "l", CURVE: "c", CLOSE: "h"}
ROUND_JOIN = "1 j"


def place(sheet: FPDF, drawing: Drawing, left: float, top: float, family: str) -> None:
    """Draw on the current page; left and top, mm, of the drawing's upper left corner; family: of its words."""
    x, y = left / POINT, (sheet.h - top) / POINT - drawing.height  # pt, of the lower left corner
    for mark in drawing.marks:
        if isinstance(mark, Words):
            _words(sheet, mark, x, y, family)
        else:
            _trace(sheet, mark, x, y)


def _trace(sheet: FPDF, trace: Trace, x: float, y: float) -> None:
    lines = ["q", *_clip(trace.clip, x, y), *_fill(trace.fill), *_stroke(trace.pen), _path(trace, x, y)]
    lines += [PAINT[trace.fill is not None, trace.pen is not None], "Q"]
    operators = "\n".join(lines)
    opacity = min(ink.opacity for ink in (trace.fill, trace.pen and trace.pen.ink) if ink)
    if opacity == 1.0:
        sheet._out(operators)
        return
    with sheet.local_context(fill_opacity=opacity, stroke_opacity=opacity):
        sheet._out(operators)


PAINT = {(True, True): "B", (True, False): "f", (False, True): "S", (False, False): "n"}


def _clip(box: Box | None, x: float, y: float) -> list[str]:
    if box is None:
        return []
    return [f"{x + box[0]:.2f} {y + box[1]:.2f} {box[2]:.2f} {box[3]:.2f} re W n"]


def _fill(ink: Ink | None) -> list[str]:
    return [f"{_rgb(ink.colour)} rg"] if ink else []


def _stroke(pen: Pen | None) -> list[str]:
    if pen is None:
        return []
    dash = " ".join(f"{length:.3g}" for length in pen.dash)
    return [f"{_rgb(pen.ink.colour)} RG {pen.width:g} w [{dash}] 0 d {CAPS[pen.cap]} J {ROUND_JOIN}"]


def _rgb(colour: str) -> str:
    return " ".join(f"{int(colour[at : at + 2], 16) / 255:.3f}" for at in (1, 3, 5))


def _path(trace: Trace, x: float, y: float) -> str:
    points = [f"{right:.2f} {up:.2f}" for right, up in (trace.points + np.array([x, y])).tolist()]
    return "\n".join(" ".join((*points[part], OPERATORS[letter])) for letter, part in trace.steps())


def _words(sheet: FPDF, words: Words, x: float, y: float, family: str) -> None:
    sheet.set_font(family, "", words.size)
    sheet.set_text_color(*(int(words.colour[at : at + 2], 16) for at in (1, 3, 5)))
    right, down = POINT * (x + words.x), sheet.h - POINT * (y + words.y)
    if not words.angle:
        sheet.text(right, down, words.text)
        return
    with sheet.rotation(words.angle, right, down):
        sheet.text(right, down, words.text)
