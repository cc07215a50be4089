"""Reports from a stored result: report.html and report.pdf, and exports of figures and tables."""

from __future__ import annotations

import csv
import datetime as dt
import io
from collections.abc import Sequence
from pathlib import Path

from . import figures, report_html, report_pdf
from .figures_svg import svg
from .report_blocks import Equation, Section, Table, charts_of, tables_of
from .report_head import Head
from .report_pass import head_of
from .report_view import PassView
from .result import HTML, LOG, PDF, read_result
from .result_mcap import write_result_log
from .sections import SECTIONS, methods


def sections_of(view: PassView) -> tuple[Section, ...]:
    """Every section of a pass, in order."""
    return tuple(section.build(view) for section in SECTIONS)


def finish(folder: Path) -> None:
    """Make the log and the reports of the result in `folder`, from what is stored there and nothing else."""
    view = read_result(folder)
    write_result_log(folder / LOG, view)
    write_report(view, folder)


def write_report(view: PassView, folder: Path) -> None:
    """Write report.html and report.pdf of one pass into `folder`."""
    write_pages(head_of(view), sections_of(view), folder, view.manifest.run.date)


def write_pages(head: Head, sections: Sequence[Section], folder: Path, date: dt.date) -> None:
    """Write report.html and report.pdf of a head and its sections; the figures are drawn once for both."""
    drawn = {chart.key: figures.record(figures.draw(chart)) for chart in charts_of(sections)}
    stills = {key: svg(drawing, key) for key, drawing in drawn.items()}
    (folder / HTML).write_text(report_html.render(head, sections, stills), encoding="utf-8")
    equations = [block for section in sections for block in section.blocks if isinstance(block, Equation)]
    drawn |= {equation.words: figures.draw_equation(equation) for equation in equations}
    (folder / PDF).write_bytes(report_pdf.render(head, sections, drawn, date))


def draw_equations() -> None:
    """Draw the equations that every pass's report shows, before there is a pass; what draws them keeps them."""
    for block in methods.BLOCKS:
        if isinstance(block, Equation):
            figures.draw_equation(block)


def write_figures(sections: Sequence[Section], folder: Path) -> list[Path]:
    """Every chart as SVG, PDF and PNG in `folder`; the files written."""
    return figures.write_files(charts_of(sections), folder)


def write_tables(
    sections: Sequence[Section], folder: Path, kinds: Sequence[str] = ("csv", "tex")
) -> list[Path]:
    """Every table as CSV (`csv`), LaTeX (`tex`) or both in `folder`; the files written."""
    folder.mkdir(parents=True, exist_ok=True)
    makers = {"csv": table_csv, "tex": table_latex}
    written = []
    for table in tables_of(sections):
        for kind in kinds:
            path = folder / f"{table.key}.{kind}"
            path.write_text(makers[kind](table), encoding="utf-8")
            written.append(path)
    return written


def table_csv(table: Table) -> str:
    """The table as CSV with a header line."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(table.columns)
    writer.writerows([cell.replace("\u00a0", " ") for cell in row] for row in table.rows)
    return buffer.getvalue()


TEX_SIGNS = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{",
    "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "−": "$-$", "°": r"$^\circ$",
    "²": "$^2$", "³": "$^3$", "±": r"$\pm$", "\u00a0": "~", "·": r"$\cdot$",
    "–": "--", "χ": r"$\chi$", "σ": r"$\sigma$",
    **{sign: f"$_{digit}$" for digit, sign in enumerate("₀₁₂₃₄₅₆₇₈₉")},
}  # fmt: skip


def tex_text(text: str) -> str:
    """The text with LaTeX's own signs escaped."""
    return "".join(TEX_SIGNS.get(sign, sign) for sign in text)


def table_latex(table: Table) -> str:
    """The table as LaTeX (package booktabs), ready to be put into a paper."""
    align = "".join("r" if numeric else "l" for numeric in table.numeric)
    lines = [" & ".join(tex_text(cell) for cell in row) + r" \\" for row in (table.columns, *table.rows)]
    body = "\n".join(lines[1:])
    return (
        f"\\begin{{table}}\n\\caption{{{tex_text(table.caption)}}}\n\\label{{tab:{table.key}}}\n"
        f"\\begin{{tabular}}{{{align}}}\n\\toprule\n{lines[0]}\n\\midrule\n{body}\n\\bottomrule\n"
        "\\end{tabular}\n\\end{table}\n"
    )
