"""Tables of a campaign, ready for a paper: CSV for reading on, LaTeX (booktabs) for setting."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .bounds import DEVIATION1, DEVIATION2, YAW1, YAW2
from .campaign import INDICES, Campaign

Cell = str | float | int | None

LABELS = {
    DEVIATION1: "tractor deviation",
    DEVIATION2: "seeder deviation",
    YAW1: "tractor yaw",
    YAW2: "seeder yaw",
}
DEGREES = 57.29577951308232
LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """A table with its file's name, caption, header and rows; digits: decimals of its numbers."""

    name: str
    caption: str
    header: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    digits: int = 2


def campaign_tables(campaign: Campaign) -> tuple[Table, ...]:
    """Every table of a campaign."""
    return (
        discrepancy_table(campaign),
        straightness_table(campaign),
        traditional_table(campaign),
        effects_rows(campaign),
        passes_table(campaign),
        excluded_table(campaign),
    )


def discrepancy_table(campaign: Campaign) -> Table:
    """Each version's responses: discrepancy, bounds, null model, verdict."""
    rows = []
    for variant, verdict in campaign.verdicts.items():
        for name, one in verdict.responses.items():
            values = [_percent(v) for v in (one.d, one.lo, one.hi, one.d_null)]
            rows.append(
                (variant, LABELS[name], *values, _length(one.rmse, name), verdict.passes, verdict.value)
            )
    header = (
        "version",
        "response",
        "D, %",
        "low, %",
        "high, %",
        "null, %",
        "RMSE, cm or deg",
        "passes",
        "verdict",
    )
    return Table("discrepancy", "Discrepancy of theory and experiment", header, tuple(rows))


def straightness_table(campaign: Campaign) -> Table:
    """Straightness indices of each cell: mean and standard deviation over its repeats, cm or degrees."""
    rows = []
    for cell in campaign.cells:
        for name, indices in cell["straightness"].items():
            values = [_length(indices[i][k], name) for i in INDICES for k in ("mean", "sd")]
            place = (cell["variant"], cell["field"], cell["direction"])
            rows.append((*place, LABELS[name], len(cell["passes"]), *values))
    header = (
        "version", "field", "direction", "response", "passes",
        "max", "sd", "range", "sd", "R95", "sd", "rms", "sd",
    )  # fmt: skip
    return Table("straightness", "Straightness indices by cell, cm or degrees", header, tuple(rows))


def traditional_table(campaign: Campaign) -> Table:
    """Cochran's and Fisher's tests by cell; they do not decide."""
    rows = []
    for cell in campaign.cells:
        for name, tests in cell["traditional"].items():
            for test, found in (tests or {}).items():
                holds = "holds" if found["holds"] else "rejected"
                place = (cell["variant"], cell["field"], cell["direction"], LABELS[name], test.capitalize())
                rows.append(
                    (*place, found["groups"], found["repeats"], found["statistic"], found["critical"], holds)
                )
    header = (
        "version", "field", "direction", "response", "test", "stations", "repeats", "statistic", "critical",
        "hypothesis",
    )  # fmt: skip
    return Table("traditional", "Cochran and Fisher tests, reported only", header, tuple(rows), 3)


def effects_rows(campaign: Campaign) -> Table:
    """Effects of the design parameters on the straightness indices, as ratios, with what is aliased."""
    rows: list[tuple[Cell, ...]] = []
    for found in campaign.effects:
        together = "; ".join(" with ".join(group) for group in found.aliased)
        last = (found.passes, found.model, together, found.note)
        rows += [(found.index, e.factor, e.step, e.ratio, e.low, e.high, e.p, *last) for e in found.effects]
        if not found.effects:
            rows.append((found.index, *[None] * 6, *last))
    header = (
        "index", "factor", "step", "ratio", "low", "high", "p", "passes", "model", "changed together", "note",
    )  # fmt: skip
    caption = "Effects on straightness (ratio for one step of the factor)"
    return Table("effects", caption, header, tuple(rows), 3)


def passes_table(campaign: Campaign) -> Table:
    """A line a pass."""
    passes = campaign.document["passes"]
    header = tuple(passes[0]) if passes else ("run",)
    return Table("passes", "Passes", header, tuple(tuple(p[key] for key in header) for p in passes))


def excluded_table(campaign: Campaign) -> Table:
    """Passes left out, with the reason."""
    rows = tuple((e.run, e.reason) for e in campaign.excluded)
    return Table("excluded", "Passes left out of the verdict", ("run", "reason"), rows)


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value


def _length(value: float | None, response: str) -> float | None:
    """Metres as cm, radians as degrees."""
    if value is None:
        return None
    return value * (100.0 if response in (DEVIATION1, DEVIATION2) else DEGREES)


def csv_text(table: Table) -> str:
    """The table as CSV, numbers in full."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(table.header)
    writer.writerows(["" if cell is None else cell for cell in row] for row in table.rows)
    return out.getvalue()


def latex_text(table: Table) -> str:
    """The table as a LaTeX `table` with booktabs rules."""
    kinds = "".join("r" if _numeric(table.rows, i) else "l" for i in range(len(table.header)))
    body = [" & ".join(_latex_cell(cell, table.digits) for cell in row) + r" \\" for row in table.rows]
    lines = [
        r"\begin{table}", r"\centering", rf"\caption{{{escaped(table.caption)}}}",
        rf"\label{{tab:{table.name}}}", rf"\begin{{tabular}}{{{kinds}}}", r"\toprule",
        " & ".join(escaped(h) for h in table.header) + r" \\", r"\midrule", *body, r"\bottomrule",
        r"\end{tabular}", r"\end{table}", "",
    ]  # fmt: skip
    return "\n".join(lines)


def _numeric(rows: Sequence[Sequence[Cell]], column: int) -> bool:
    return any(isinstance(row[column], int | float) for row in rows)


def _latex_cell(cell: Cell, digits: int) -> str:
    if cell is None:
        return "--"
    if isinstance(cell, float):
        return f"{cell:.{digits}f}"
    return escaped(str(cell))


def escaped(text: str) -> str:
    """Text with LaTeX's own characters made harmless."""
    return "".join(LATEX.get(character, character) for character in text)


def write_campaign_tables(campaign: Campaign, folder: Path) -> Mapping[str, Any]:
    """Write every table as CSV and LaTeX; gives the paths by table."""
    folder.mkdir(parents=True, exist_ok=True)
    written = {}
    for table in campaign_tables(campaign):
        paths = (folder / f"{table.name}.csv", folder / f"{table.name}.tex")
        for path, text in zip(paths, (csv_text(table), latex_text(table)), strict=True):
            path.write_text(text, encoding="utf-8")
        written[table.name] = paths
    return written
