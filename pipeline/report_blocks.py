"""What a report section is made of: plain values that the HTML, the PDF and the exports all draw from."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
UNITS = {"to", "RMSE", "cm", "mm", "ms", "Hz", "ppm", "MPa", "kg", "rad"}  # words that a number may hold

Role = Literal[
    "measured", "simulated", "measured2", "simulated2", "residual", "null", "tractor", "seeder",
    "reference", "third", "fourth",
]  # fmt: skip
Style = Literal["line", "dash", "dots", "points", "marked", "bars", "none"]


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text."""

    text: str


@dataclass(frozen=True)
class Missing:
    """Why a part of the report is not there, in a sentence."""

    text: str


def is_number(cell: str) -> bool:
    """Whether a cell holds a number, perhaps with its unit, a range of numbers, or a dash for none."""
    return cell[:1] in set("−–(0123456789") and set(re.findall(r"[A-Za-z]{2,}", cell)) <= UNITS


@dataclass(frozen=True)
class Table:
    """A table of ready-made strings; `key` names its export."""

    key: str
    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    links: tuple[str, ...] = ()  # one address a row, for its first cell; empty: none

    @property
    def numeric(self) -> tuple[bool, ...]:
        """Which columns hold numbers (and so are set to the right); the first is the rows' name."""
        return tuple(
            index > 0 and all(is_number(row[index]) for row in self.rows)
            for index in range(len(self.columns))
        )


@dataclass(frozen=True)
class Curve:
    """One curve of a panel: y over x, with an optional band low to high; x and y (N,), NaN breaks the line.

    role says what it is, and so its colour in every rendering; style how it is drawn: "marked" is a line with
    a mark at each point, "none" draws the band alone.
    """

    name: str
    role: Role
    x: Floats
    y: Floats
    low: Floats | None = None
    high: Floats | None = None
    style: Style = "line"
    band_name: str = ""


@dataclass(frozen=True)
class Panel:
    """Axes with one y label (quantity and unit) and its curves; all panels of a chart share the x axis."""

    y_label: str
    curves: tuple[Curve, ...]
    log_y: bool = False
    levels: tuple[tuple[float, str], ...] = ()  # horizontal lines: value and what it means


@dataclass(frozen=True)
class Chart:
    """A figure: panels one above another over a common x axis.

    key names the exported file; alt says in words what a reader who cannot see it would miss;
    to_scale draws both axes in the same unit length (a map), and then it is not interactive;
    discrete: x counts things (windows, passes).
    """

    key: str
    title: str
    caption: str
    alt: str
    x_label: str
    panels: tuple[Panel, ...]
    log_x: bool = False
    to_scale: bool = False
    discrete: bool = False


@dataclass(frozen=True)
class Equation:
    """A displayed equation: in MathML for the page, in TeX's mathematics for the PDF, and in words."""

    mathml: str
    tex: str
    words: str


Block = Text | Missing | Table | Chart | Equation


@dataclass(frozen=True)
class Section:
    """A titled part of the report; key is its anchor."""

    key: str
    title: str
    blocks: tuple[Block, ...]


def charts_of(sections: Sequence[Section]) -> tuple[Chart, ...]:
    """Every chart of the sections, in order."""
    return tuple(block for section in sections for block in section.blocks if isinstance(block, Chart))


def tables_of(sections: Sequence[Section]) -> tuple[Table, ...]:
    """Every table of the sections, in order."""
    return tuple(block for section in sections for block in section.blocks if isinstance(block, Table))
