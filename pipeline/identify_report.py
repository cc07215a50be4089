"""An identification as a page: estimates, what was held, and before, after, held out."""

from __future__ import annotations

import datetime as dt
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .report import write_pages
from .report_blocks import Block, Section, Table, Text
from .report_head import Head, Number

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
    names = ", ".join(brief(p["parameter"]) for p in document["parameters"])
    passes, verdict = document["passes"], document["verdict"]
    return Head(
        title="Identification of parameters",
        tested=f"{names}, from {len(passes)} passes; held out by {document['folds_by']}",
        verdict=verdict["value"],
        verdict_label="verdict of the passes held out",
        meaning="Each pass was replayed with parameters estimated without it and without the others of its fold.",
        reasons=tuple(verdict["reasons"]),
        numbers=tuple(_headline(document, kind) for kind in ("trajectory", "yaw")),
        scope="",
        footer=f"From {len(passes)} passes; threshold {verdict['threshold_percent']:g} %.",
        short="Identification of parameters",
    )


def _headline(document: Document, kind: str) -> Number:
    """A held-out discrepancy beside those before and after."""
    values = {
        stage: "–" if (entry := found["discrepancy"]) is None else percent(entry[kind]["combined"])
        for stage, found in document["stages"].items()
    }
    details = (("as stated", f"{values['before']} %"), ("fitted", f"{values['after']} %"))
    return Number(f"{kind}, held out", f"{values['held_out']} %", "", details)


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
            brief(p["parameter"]), number(p["stated"]), number(p["estimate"]), number(p["standard_error"]),
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
    return (
        estimates,
        *prior_words(document["parameters"]),
        correlation_table(document),
        *held_words(document["held"]),
    )


def prior_words(parameters: Sequence[Document]) -> tuple[Text, ...]:
    """A sentence for each parameter of which something was known before."""
    return tuple(
        Text(f"Known before of {brief(p['parameter'])}: {number(p['prior_mean'])} ± {number(p['prior_sd'])}.")
        for p in parameters
        if p["prior_sd"] is not None
    )


def correlation_table(document: Document) -> Table:
    """Correlation matrix of the estimates: its lower half, columns by the rows' numbers."""
    names, matrix = document["correlation"]["parameters"], document["correlation"]["matrix"]
    rows = tuple(
        (f"{i + 1}: {brief(name)}", *(f"{v:.2f}" for v in line[: i + 1]), *("",) * (len(names) - i - 1))
        for i, (name, line) in enumerate(zip(names, matrix, strict=True))
    )
    heads = (str(i + 1) for i in range(len(names)))
    return Table("correlations", "Correlation of the estimates.", ("parameter", *heads), rows)


def held_words(held: Sequence[Document]) -> tuple[Text, ...]:
    """A sentence for each parameter that was held."""
    return tuple(Text(f"Held at its stated value: {brief(h['name'])} {h['reason']}.") for h in held)


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
    folds = document["folds"]
    rows = tuple((brief(name), *(_with_error(fold, name) for fold in folds)) for name in names)
    table = Table(
        "folds", "Estimates without the passes of one fold, ± a standard error; a dash: held at its stated value.",
        ("parameter", *(f"without {fold['left_out']}" for fold in folds)), rows,
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
    """`41500 ± 3000`, a dash for a parameter that was held."""
    error = fold["standard_errors"].get(name)
    return "–" if error is None else f"{number(fold['estimates'][name])} ± {number(float(f'{error:.2g}'))}"


def brief(name: str) -> str:
    """`cornering_stiffness (front)` for `tyres.front.cornering_stiffness`."""
    *path, last = name.split(".")
    if last.isdigit() and path:
        return f"{brief('.'.join(path))} {last}"
    return f"{last} ({path[-1]})" if path else last


def number(value: float | None) -> str:
    """A number with four significant digits, without an exponent where it is short; a dash for none."""
    if value is None:
        return "–"
    rounded = float(f"{value:.4g}")
    return f"{rounded:.0f}" if 1e4 <= abs(rounded) < 1e7 else f"{rounded:g}"


def percent(value: float | None) -> str:
    """A percentage without its sign, a dash for none."""
    return "–" if value is None else f"{value:.1f}"


def span(ends: Sequence[float | None]) -> str:
    """`41200 to 72100`; an end that its bound cut off is open."""
    low, high = ("open" if end is None else number(end) for end in ends)
    return f"{low} to {high}"
