"""An identification as a page: estimates, what was held, and before, after, held out."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .report import write_pages
from .report_blocks import Block, Section, Table, Text
from .report_head import Head

Document = dict[str, Any]

STAGES = {"before": "before: as stated", "after": "after: the passes fitted", "held_out": "held out"}
COLUMNS = (
    ("trajectory", ("trajectory", "combined")),
    ("tractor", ("trajectory", "body1")),
    ("seeder", ("trajectory", "body2")),
    ("yaw", ("yaw", "combined")),
    ("tractor's yaw", ("yaw", "body1")),
    ("seeder's yaw", ("yaw", "body2")),
)


def write_report(document: Document, out: Path, date: dt.date) -> Path:
    """Write report.html and report.pdf into `out` from an identification's document; the page's path."""
    write_pages(head_of(document), sections_of(document), out, date)
    return out / "report.html"


def head_of(document: Document) -> Head:
    """The first screen: which parameters, from how many passes, and the verdict of those held out."""
    names = ", ".join(p["parameter"] for p in document["parameters"])
    passes, verdict = document["passes"], document["verdict"]
    return Head(
        title="Identification of parameters",
        tested=f"{names}, from {len(passes)} passes; held out by {document['folds_by']}",
        verdict=verdict["value"],
        verdict_label="verdict of the passes held out",
        meaning="Each pass was replayed with parameters estimated without it and without the others of its fold.",
        reasons=tuple(verdict["reasons"]),
        numbers=(),
        scope="",
        footer=f"From {len(passes)} passes; threshold {verdict['threshold_percent']:g} %.",
        short="Identification of parameters",
    )


def sections_of(document: Document) -> tuple[Section, ...]:
    """Parameters; before, after and held out; folds; passes."""
    return (
        Section("parameters", "Parameters", parameter_blocks(document)),
        Section("stages", "Before, after, held out", (stages_table(document), passes_table(document))),
        Section("folds", "Folds", fold_blocks(document)),
    )


def parameter_blocks(document: Document) -> tuple[Block, ...]:
    """Estimates, correlations, and what was held at its stated value."""
    rows = tuple(
        (
            p["parameter"], number(p["stated"]), number(p["estimate"]), number(p["standard_error"]),
            number(p["standard_error_uncorrected"]), span(p["interval"]), span(p["profile_interval"]),
            "yes" if p["at_bound"] else "no",
        )
        for p in document["parameters"]
    )  # fmt: skip
    estimates = Table(
        "estimates",
        "Estimates in SI units over all passes. The standard error pays for autocorrelated residuals; "
        "uncorrected, it would take every sample's weight at its word. The profile interval lets all others follow.",
        (
            "parameter",
            "stated",
            "estimate",
            "standard error",
            "uncorrected",
            "95 % interval",
            "profile",
            "at bound",
        ),
        rows,
    )
    return (estimates, correlation_table(document), *held_words(document["held"]))


def correlation_table(document: Document) -> Table:
    """Correlation matrix of the estimates."""
    names, matrix = document["correlation"]["parameters"], document["correlation"]["matrix"]
    rows = tuple(
        (name, *(f"{value:.2f}" for value in line)) for name, line in zip(names, matrix, strict=True)
    )
    return Table("correlations", "Correlation of the estimates.", ("parameter", *names), rows)


def held_words(held: Sequence[Document]) -> tuple[Text, ...]:
    """A sentence for each parameter that was held."""
    return tuple(Text(f"Held at its stated value: {h['name']} {h['reason']}.") for h in held)


def stages_table(document: Document) -> Table:
    """Discrepancies and verdict words of the three stages."""
    rows = tuple(
        (words, *_discrepancies(found["discrepancy"]), found["verdict"]["value"])
        for words, found in ((words, document["stages"][stage]) for stage, words in STAGES.items())
    )
    return Table(
        "stages",
        "Discrepancy in percent of R95. Only the passes held out decide: those that were fitted speak for the fit.",
        ("stage", *(name for name, _ in COLUMNS), "says"),
        rows,
    )


def _discrepancies(found: Document | None) -> tuple[str, ...]:
    if found is None:
        return ("–",) * len(COLUMNS)
    return tuple(percent(found[kind][body]) for _, (kind, body) in COLUMNS)


def passes_table(document: Document) -> Table:
    """Each pass: trajectory and yaw of both bodies together, at the three stages."""
    rows = tuple(
        (
            p["run"], p["field"], p["direction"],
            *(_combined(p[stage], kind) for kind in ("trajectory", "yaw") for stage in STAGES),
        )
        for p in document["passes"]
    )  # fmt: skip
    heads = (
        f"{kind}, {stage.replace('_', ' ')}" for kind in ("trajectory", "yaw") for stage in STAGES
    )  # fmt: skip
    return Table("passes", "Each pass, percent of its R95.", ("pass", "field", "direction", *heads), rows)


def _combined(found: Document | None, kind: str) -> str:
    return "–" if found is None else percent(found[kind]["combined"])


def fold_blocks(document: Document) -> tuple[Block, ...]:
    """The estimates of each fold, made without the passes named."""
    if not document["folds"]:
        return (Text("All passes belong to one fold, so none could be held out."),)
    names = [p["parameter"] for p in document["parameters"]]
    rows = tuple(
        (fold["left_out"], ", ".join(fold["runs"]), *(_with_error(fold, n) for n in names))
        for fold in document["folds"]
    )
    table = Table(
        "folds", "Estimates without the passes left out, ± a standard error; a dash: held at its stated value.",
        ("left out", "passes", *names), rows,
    )  # fmt: skip
    failed = tuple(
        Text(
            f"Without {f['left_out']} nothing could be fitted, so the stated values were used: {f['reason']}."
        )
        for f in document["folds"]
        if f["reason"]
    )
    return (table, *failed)


def _with_error(fold: Document, name: str) -> str:
    """`4.15e+04 ± 3e+03`, a dash for a parameter that was held."""
    error = fold["standard_errors"].get(name)
    return "–" if error is None else f"{number(fold['estimates'][name])} ± {error:.2g}"


def number(value: float | None) -> str:
    """A number with four significant digits, a dash for none."""
    return "–" if value is None else f"{value:.4g}"


def percent(value: float | None) -> str:
    """A percentage without its sign, a dash for none."""
    return "–" if value is None else f"{value:.1f}"


def span(ends: Sequence[float | None]) -> str:
    """`4.1e+04 to 7.2e+04`; an end that its bound cut off is open."""
    low, high = ("open" if end is None else f"{end:.4g}" for end in ends)
    return f"{low} to {high}"
