"""What a drawn figure is made of: strokes, fills, dots and words, for the page and the PDF to write alike.

Lengths are points (1/72 inch) from the figure's lower left corner, y upwards. No plotting library here.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Box = tuple[float, float, float, float]  # left, bottom, width, height

MOVE, LINE, CURVE, CLOSE = "M", "L", "C", "Z"  # of a path; a curve takes three points: Bézier's cubic


@dataclass(frozen=True)
class Ink:
    """A colour, `#rrggbb`, and how much of it covers what lies below, 0 to 1."""

    colour: str
    opacity: float = 1.0


@dataclass(frozen=True)
class Pen:
    """How a line is drawn: its ink, width, dashes (on, off, …; none: solid), and the form of its ends."""

    ink: Ink
    width: float
    dash: tuple[float, ...] = ()
    cap: Literal["butt", "round", "square"] = "butt"


@dataclass(frozen=True)
class Trace:
    """A path, stroked, filled or both, inside `clip`; points (N, 2), and a letter for each step of it."""

    points: Floats
    letters: str
    pen: Pen | None = None
    fill: Ink | None = None
    clip: Box | None = None

    def steps(self) -> Iterator[tuple[str, slice]]:
        """Each step of the path with its points; closing takes none."""
        at = 0
        for letter in self.letters:
            count = TAKES[letter]
            yield letter, slice(at, at + count)
            at += count


TAKES = {MOVE: 1, LINE: 1, CURVE: 3, CLOSE: 0}


@dataclass(frozen=True)
class Words:
    """A line of text in the reports' sans serif: (x, y) is the left end of its baseline, before `angle`.

    angle : degrees, counter-clockwise; width : as long as it is in the font that it was laid out with
    anchor : the part of it that stays in place in another font, 0 (its beginning) to 1 (its end)
    """

    x: float
    y: float
    text: str
    size: float
    colour: str
    angle: float = 0.0
    width: float = 0.0
    anchor: float = 0.0


@dataclass(frozen=True)
class Drawing:
    """A drawn figure: its size and its marks, in the order in which they cover each other."""

    width: float
    height: float
    marks: tuple[Trace | Words, ...]
