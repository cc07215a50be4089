"""What the commands say to a person: results as plain values in, text out (the command line prints it)."""

from __future__ import annotations

import datetime as dt
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

Document = dict[str, Any]


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Columns side by side, as wide as their widest cell; numbers to the right."""
    cells = [[_cell(value) for value in row] for row in rows]
    widths = [max(len(line[i]) for line in [list(header), *cells]) for i in range(len(header))]
    lines = ["  ".join(name.ljust(width) for name, width in zip(header, widths, strict=True)).rstrip()]
    for line in cells:
        lines.append("  ".join(_aligned(c, w) for c, w in zip(line, widths, strict=True)).rstrip())
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value)


def _aligned(cell: str, width: int) -> str:
    numeric = cell[:1].isdigit() or cell[:1] in "+-"
    return cell.rjust(width) if numeric else cell.ljust(width)


def ingested(document: Document) -> str:
    """One block a log: its path, its health table, its warnings."""
    return "\n\n".join(inspected(log) for log in document["logs"])


def inspected(document: Document) -> str:
    """A log's path, run id, health by sensor, and warnings."""
    lines = [f"{document['log']}: pass {document['run']['id']}"]
    lines.append(health_table(document["health"]))
    lines += [_warning(warning) for warning in document["warnings"]]
    return "\n".join(lines)


def health_table(health: Document) -> str:
    """A line a sensor, sensors with the same figures under one header; nested figures are left to --json."""
    groups: dict[tuple[str, ...], list[str]] = {}
    for name, entry in health.items():
        if isinstance(entry, dict):
            groups.setdefault(tuple(key for key, value in entry.items() if _scalar(value)), []).append(name)
    tables = []
    for keys, names in groups.items():
        rows = [[name, *(_figure(key, health[name][key]) for key in keys)] for name in names]
        tables.append(table(["sensor", *(key.replace("_", " ") for key in keys)], rows))
    return "\n\n".join(tables)


def _figure(key: str, value: Any) -> Any:
    if key == "start" and isinstance(value, float):
        return dt.datetime.fromtimestamp(value, dt.UTC).strftime("%Y-%m-%d %H:%M:%S")
    return value


def _scalar(value: Any) -> bool:
    return value is None or isinstance(value, str | int | float)


def _warning(warning: Document) -> str:
    where = ", ".join(str(warning[k]) for k in ("sensor", "file") if warning.get(k))
    row = f", row {warning['row']}" if warning.get("row") is not None else ""
    return f"warning: {where}{row}: {warning['what']}; {warning['effect']}"


def ran(document: Document) -> str:
    """Verdict with reasons, headline discrepancies, and the report to open."""
    verdict = document["verdict"]
    lines = [f"verdict ({verdict['scope']} {document['run']}): {verdict['value']}"]
    lines += [f"  because {reason}" for reason in verdict["reasons"]]
    for name, entry in document["discrepancy"].items():
        lines.append(discrepancy(name, entry))
    lines.append(f"warnings: {len(document['warnings'])}")
    lines.append(f"report: {document['report']}")
    return "\n".join(lines)


def discrepancy(name: str, entry: Document) -> str:
    """`discrepancy of yaw: 4.2 % (2.8 to 3.9 % with measuring error taken out; tractor 3.9 %, seeder 4.5 %)`."""
    low, high = entry["interval"] or (None, None)
    parts = f"{low:.1f} to {_percent(high)} with measuring error taken out; " if low is not None else ""
    parts += f"tractor {_percent(entry['body1'])}, seeder {_percent(entry['body2'])}"
    return f"discrepancy of {name}: {_percent(entry['combined'])} ({parts})"


def _percent(value: float | None) -> str:
    return "none" if value is None else f"{value:.1f} %"


def batched(document: Document) -> str:
    """Counts, failures with their reasons, the campaign's verdict, and the report to open."""
    counts = ", ".join(f"{document[key]} {key}" for key in ("done", "unchanged", "failed"))
    lines = [f"{document['passes']} passes in {document['out']}: {counts}"]
    lines += [f"  {failure['run']}: {failure['reason']}" for failure in document["failures"]]
    if document["verdict"]:
        lines.append(f"verdict (campaign): {document['verdict']['value']}")
        lines += [f"  because {reason}" for reason in document["verdict"]["reasons"]]
        lines += [discrepancy(name, entry) for name, entry in document["discrepancy"].items()]
    if document["report"]:
        lines.append(f"report: {document['report']}")
    return "\n".join(lines)


def study_values(out: Path, files: Iterable[Path], tables: Iterable[Any]) -> Document:
    """What a study or a sweep left, as plain values; a table has `caption`, `columns` and `rows`."""
    values = [
        {"caption": t.caption, "columns": list(t.columns), "rows": [list(r) for r in t.rows]} for t in tables
    ]
    return {"out": str(out), "tables": values, "files": [str(file) for file in files]}


def studied(document: Document) -> str:
    """The tables of a study or a sweep, and where its files are."""
    tables = [f"{t['caption']}\n{table(t['columns'], t['rows'])}\n" for t in document["tables"]]
    return "\n".join([*tables, f"{len(document['files'])} files in {document['out']}"])


def identified(document: Document) -> str:
    """The estimates with their intervals, what was held, and the verdicts before, after and held out."""
    header = ["parameter", "stated", "estimate", "standard error", "interval", "profile"]
    keys = ("parameter", "stated", "estimate", "standard_error")
    rows = [
        [*(entry[key] for key in keys), _interval(entry["interval"]), _interval(entry["profile_interval"])]
        for entry in document["parameters"]
    ]
    lines = [table(header, rows)]
    lines += [f"held at its stated value: {entry['name']} {entry['reason']}" for entry in document["held"]]
    for name, stage in document["stages"].items():
        lines.append(f"verdict {name.replace('_', ' ')}: {stage['verdict']['value']}")
        lines += [f"  {discrepancy(kind, entry)}" for kind, entry in stage["discrepancy"].items()]
    lines += [f"  because {reason}" for reason in document["verdict"]["reasons"]]
    return "\n".join([*lines, f"all of it: {document['out']}/identify.json"])


def parameter_names(document: Document) -> str:
    """Every parameter of a machine that can be freed, with its short form and its stated value."""
    rows = [list(entry.values()) for entry in document["parameters"]]
    return table(["parameter", "short form", "stated, SI"], rows)


def _interval(ends: Sequence[float | None]) -> str:
    return " to ".join("open" if end is None else _cell(end) for end in ends)


def planned(document: Document) -> str:
    """The advice for each version of a planned campaign, and the report to open."""
    lines = []
    for variant in document["variants"]:
        lines += [f"version {variant['variant']}:", *(f"  {line}" for line in variant["advice"])]
    return "\n".join([*lines, f"report: {document['report']}"])
