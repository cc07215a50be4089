"""Reports made again from what is stored, of a pass or of a campaign, and exports of figures and tables."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from . import report
from .report_blocks import Section
from .result import FIGURES, HTML, LOG, PDF, TABLES, ResultError, read_result
from .result_mcap import write_result_log

CAMPAIGN = "campaign.json"


@dataclass(frozen=True)
class Exports:
    """What is wanted beside the reports: figures as files, tables as CSV and LaTeX."""

    figures: bool = False
    csv: bool = False
    latex: bool = False

    @property
    def tables(self) -> tuple[str, ...]:
        """Kinds of table files, by suffix."""
        return tuple(kind for kind, wanted in (("csv", self.csv), ("tex", self.latex)) if wanted)


@dataclass(frozen=True)
class Made:
    """What was made again: the page to open, and every file written."""

    page: Path
    files: tuple[Path, ...]


def make_again(out: Path, exports: Exports = Exports()) -> Made:
    """Make report.html, report.pdf and (of a pass) result.mcap again in a results folder, without computing.

    Each file is replaced only when its successor is whole. Exports land in OUT/figures and OUT/tables.
    Raises ResultError when `out` is neither a pass's result nor a batch's OUT.
    """
    if not out.is_dir():
        raise ResultError(f"{out}: is not a folder; give one that `smts-validate run` or `batch` has left")
    if (out / CAMPAIGN).is_file():
        return _campaign(out, exports)
    view = read_result(out)
    sections = report.sections_of(view)
    with tempfile.TemporaryDirectory(prefix=".report.", dir=out) as name:
        part = Path(name)
        write_result_log(part / LOG, view)
        report.write_pages(report.head_of(view), sections, part, view.manifest.run.date)
        files = _moved(part, out, (LOG, HTML, PDF))
    return Made(out / HTML, (*files, *_exported(out, sections, exports)))


def _campaign(out: Path, exports: Exports) -> Made:
    from . import report_campaign, report_campaign_parts  # late: their statistics are slow to import

    view = report_campaign.read_campaign(out)
    sections = report_campaign_parts.parts_of(view)
    with tempfile.TemporaryDirectory(prefix=".report.", dir=out) as name:
        part = Path(name)
        report.write_pages(report_campaign.head_of(view), sections, part, report_campaign.date_of(view))
        files = _moved(part, out, (HTML, PDF))
    return Made(out / HTML, (*files, *_exported(out, sections, exports)))


def _moved(part: Path, out: Path, names: Sequence[str]) -> tuple[Path, ...]:
    for name in names:
        os.replace(part / name, out / name)
    return tuple(out / name for name in names)


def _exported(out: Path, sections: Sequence[Section], exports: Exports) -> tuple[Path, ...]:
    files: list[Path] = []
    if exports.figures:
        files += report.write_figures(sections, out / FIGURES)
    if exports.tables:
        files += report.write_tables(sections, out / TABLES, exports.tables)
    return tuple(files)
