"""report.html: one self-contained page from a head and its sections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

import jinja2

from . import figures_style as style
from .report_blocks import Block, Chart, Equation, Missing, Section, Table, Text
from .report_charts import chart_json, uplot_file
from .report_head import Head

KINDS: Mapping[type, str] = {
    Text: "text",
    Missing: "missing",
    Equation: "equation",
    Table: "table",
    Chart: "chart",
}


@dataclass(frozen=True)
class _Drawn:
    """A chart for the template: its still picture, and its data when it is interactive."""

    chart: Chart
    svg: str
    data: str
    note: str


@dataclass(frozen=True)
class _Item:
    kind: str
    value: Any


@dataclass(frozen=True)
class _Part:
    key: str
    title: str
    blocks: tuple[_Item, ...]


@cache
def _environment() -> jinja2.Environment:
    folder = files(__package__).joinpath("templates")

    def load(name: str) -> str:
        return folder.joinpath(name).read_text(encoding="utf-8")

    # Everything is escaped: ids, notes and labels come from manifests, which others write.
    return jinja2.Environment(
        autoescape=True,
        loader=jinja2.FunctionLoader(load),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )


def render(head: Head, sections: Sequence[Section], stills: Mapping[str, str]) -> str:
    """The page as text.

    stills : inline SVG by chart key, for print and for readers without script
    """
    parts = [_Part(s.key, s.title, tuple(_item(block, stills) for block in s.blocks)) for s in sections]
    colours = {f"c-{role}": colour for role, colour in style.LIGHT.items()}
    dark = {f"c-{role}": colour for role, colour in style.DARK.items()}
    page_style = _environment().get_template("style.css").render(light=colours, dark=dark)
    page_script = files(__package__).joinpath("templates", "charts.js").read_text(encoding="utf-8")
    return _environment().get_template("page.html.j2").render(
        head=head, sections=parts, page_style=page_style, chart_style=uplot_file("uPlot.min.css"),
        chart_script=uplot_file("uPlot.iife.js"), page_script=page_script,
    )  # fmt: skip


def _item(block: Block, stills: Mapping[str, str]) -> _Item:
    if not isinstance(block, Chart):
        return _Item(KINDS[type(block)], block)
    thinned = style.thin(block, style.PAGE_POINTS)
    data = "" if block.to_scale else chart_json(thinned)
    return _Item("chart", _Drawn(block, stills[block.key], data, thinned.note))
