"""A drawing as inline SVG for a page: text stays text, the colours are the page's own."""

from __future__ import annotations

import math
from collections.abc import Iterator
from html import escape

import numpy as np

from . import figures_style as style
from .figures_marks import CLOSE, LINE, Box, Drawing, Ink, Pen, Trace, Words

ANCHORS = {0.0: "start", 0.5: "middle", 1.0: "end"}
FONT = "'DejaVu Sans',sans-serif"


def svg(drawing: Drawing, key: str) -> str:
    """The drawing of the chart `key` as an SVG element."""
    boxes = sorted({mark.clip for mark in drawing.marks if isinstance(mark, Trace) and mark.clip})
    clips = {box: f"{svg_id(key)}-{number}" for number, box in enumerate(boxes)}
    parts = [
        _words(mark, drawing.height) if isinstance(mark, Words) else _trace(mark, drawing.height, clips)
        for mark in drawing.marks
    ]
    return (
        f'<svg id="{svg_id(key)}" aria-hidden="true" xmlns="http://www.w3.org/2000/svg" '
        f'viewBox="0 0 {drawing.width:.1f} {drawing.height:.1f}" '
        f'style="font-family:{FONT};stroke-linejoin:round">'
        f"<defs>{''.join(_clip(box, name, drawing.height) for box, name in clips.items())}</defs>"
        f"{''.join(parts)}</svg>"
    )


def svg_id(key: str) -> str:
    """Id of a chart's SVG in a page."""
    return f"svg-{key}"


def page_colours() -> dict[str, str]:
    """Names of the page's colour variables, and the colour each stands for in a drawn figure."""
    roles = {f"c-{role}": colour for role, colour in style.LIGHT.items()}
    return roles | {"ink": style.INK, "muted": style.MUTED, "grid": style.GRID, "paper": "#ffffff"}


VARIABLES = {colour: f"var(--{name},{colour})" for name, colour in page_colours().items()}


def _clip(box: Box, name: str, height: float) -> str:
    left, bottom, wide, high = box
    top = height - bottom - high
    return (
        f'<clipPath id="{name}"><rect x="{left:.1f}" y="{top:.1f}" width="{wide:.1f}" height="{high:.1f}"/>'
        "</clipPath>"
    )


def _trace(trace: Trace, height: float, clips: dict[Box, str]) -> str:
    inside = f' clip-path="url(#{clips[trace.clip]})"' if trace.clip else ""
    look = ";".join([*_fill(trace.fill), *_stroke(trace.pen)])
    return f'<path d="{_path(trace, height)}"{inside} style="{look}"/>'


def _fill(ink: Ink | None) -> Iterator[str]:
    yield f"fill:{VARIABLES.get(ink.colour, ink.colour)}" if ink else "fill:none"
    if ink and ink.opacity < 1.0:
        yield f"fill-opacity:{ink.opacity:g}"


def _stroke(pen: Pen | None) -> Iterator[str]:
    if pen is None:
        return
    yield f"stroke:{VARIABLES.get(pen.ink.colour, pen.ink.colour)};stroke-width:{pen.width:g}"
    if pen.ink.opacity < 1.0:
        yield f"stroke-opacity:{pen.ink.opacity:g}"
    if pen.dash:
        yield f"stroke-dasharray:{' '.join(f'{length:.3g}' for length in pen.dash)}"
    if pen.cap != "butt":
        yield f"stroke-linecap:{pen.cap}"


def _path(trace: Trace, height: float) -> str:
    """The path in tenths of a point, its straight lines as steps: a third of the length, the same picture."""
    tenths = np.rint(10.0 * (np.array([0.0, height]) + np.array([1.0, -1.0]) * trace.points))
    points = tenths.astype(np.int64).tolist()
    out, pen = [], [0, 0]
    for letter, part in trace.steps():
        if letter == CLOSE:  # what follows is an absolute M, so the pen's place does not matter
            out.append("z")
            continue
        at = points[part]
        if letter == LINE:
            out.append(f"l{(at[0][0] - pen[0]) / 10:g} {(at[0][1] - pen[1]) / 10:g}")
        else:
            out.append(letter + " ".join(f"{x / 10:g} {y / 10:g}" for x, y in at))
        pen = at[-1]
    return "".join(out)


def _words(words: Words, height: float) -> str:
    """Text fixed where it is aligned, so that it stays there in whatever font the reader has."""
    along, angle = words.anchor * words.width, math.radians(words.angle)
    x = words.x + along * math.cos(angle)
    y = height - words.y - along * math.sin(angle)
    turned = f' transform="rotate({-words.angle:g} {x:.1f} {y:.1f})"' if words.angle else ""
    anchor = f";text-anchor:{ANCHORS[words.anchor]}" if words.anchor else ""
    colour = VARIABLES.get(words.colour, words.colour)
    return (
        f'<text x="{x:.1f}" y="{y:.1f}"{turned} style="font-size:{words.size:g}px;fill:{colour}{anchor}">'
        f"{escape(words.text)}</text>"
    )
