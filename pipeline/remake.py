"""Reports made again from stored results, each file whole or as it was."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from . import report, result
from .batch_store import PASSES
from .report_blocks import Section

CAMPAIGN = ("campaign.json", "failures.json", PASSES)
STORED = (
    result.MANIFEST,
    result.TRAJECTORY,
    result.SIMULATION,
    result.COMPARISON,
    result.PLOTS,
    result.METRICS,
)


class RemakeError(ValueError):
    """A folder that holds no results; one line."""


@dataclass(frozen=True)
class Exports:
    """What is made beside the reports. figures: each as SVG, PDF and PNG; tables: of "csv" and "tex"."""

    figures: bool = False
    tables: tuple[str, ...] = ()


def remake(
    out: Path, exports: Exports = Exports(), say: Callable[[str], None] = lambda message: None
) -> Path:
    """Make the reports of a pass's results folder again, or those of a batch's OUT with all its passes.

    Returns the report to open. Raises RemakeError, or ResultError for a result that cannot be read.
    """
    if (out / CAMPAIGN[0]).is_file():
        for folder in sorted(path.parent for path in (out / PASSES).glob(f"*/{result.METRICS}")):
            say(f"{folder.name}")
            remake_pass(folder, exports)
        remake_campaign(out, exports)
    elif (out / result.METRICS).is_file():
        remake_pass(out, exports)
    else:
        raise RemakeError(f"{out}: holds no results; give a folder that `run` or `batch` has left")
    return out / result.HTML


def remake_campaign(out: Path, exports: Exports = Exports()) -> None:
    """Make a campaign's reports and exports from its campaign.json and its stored passes."""
    # Late: a pass's reports do without a campaign's statistics, which are slow to import.
    from . import report_campaign, report_campaign_parts

    with _beside(out, CAMPAIGN) as part:
        view = report_campaign.write_campaign_report(part)
        _export(part, report_campaign_parts.parts_of(view), exports)


def remake_pass(out: Path, exports: Exports) -> None:
    """Make one pass's reports, log and exports from what is stored."""
    view = result.read_result(out)
    with _beside(out, STORED) as part:
        report.finish(part)
        _export(part, report.sections_of(view) if exports.figures or exports.tables else (), exports)


def _export(part: Path, sections: Sequence[Section], exports: Exports) -> None:
    if exports.figures:
        report.write_figures(sections, part / result.FIGURES)
    if exports.tables:
        report.write_tables(sections, part / result.TABLES, exports.tables)


@contextmanager
def _beside(out: Path, stored: Sequence[str]) -> Iterator[Path]:
    """A folder that shows the stored files; what is made in it replaces its namesakes in `out` at the end."""
    with tempfile.TemporaryDirectory(prefix=".report.", dir=out) as name:
        part = Path(name)
        for needed in stored:
            if (out / needed).exists():
                (part / needed).symlink_to(Path("..") / needed)
        yield part
        for made in sorted(part.iterdir()):
            if made.is_symlink():
                continue
            if made.is_dir():
                shutil.rmtree(out / made.name, ignore_errors=True)
            os.replace(made, out / made.name)
