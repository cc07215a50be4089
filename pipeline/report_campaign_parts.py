"""The parts of the campaign's report, one function each, in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .campaign import PassRecord
from .report_blocks import Block, Chart, Curve, Missing, Panel, Role, Section, Table, Text
from .sections._common import RESPONSES, deep, interval, number, percent, small

MOST_CELLS = 6  # cells of repeats that are drawn
ROLES: tuple[Role, ...] = ("measured", "simulated", "third", "fourth", "null", "residual")
FACTORS = {"speed": "speed, m/s", "hitch_to_com": "l₅, m", "tyre_pressure_mpa": "tyre pressure, MPa"}
TESTS = {"cochran": "Cochran's C", "fisher": "Fisher's F"}
INDICES = {"max_abs": "greatest", "range": "range", "r95": "R95", "rms": "rms"}
ALIASED = (
    "{} changed together in these passes, so their effects cannot be told apart; the first stands for all."
)
EFFECTS = (
    "By what factor each straightness index changes for a step of each parameter, fields and "
    "directions as blocks, the pass as the unit. A factor of 1 is no effect."
)
FISHER = (
    "Reported and never deciding. Cochran's C asks whether the repeats' variances are equal, "
    "Fisher's F whether the misfit exceeds the repeats' scatter. Fisher's test rewards sloppy "
    "repeats: the more they scatter, the easier a wrong model passes."
)
CURVE = (
    "How often a campaign with these passes, spread and noise would come to each verdict, by Monte "
    "Carlo, if the true discrepancy were the one on the axis."
)


@dataclass(frozen=True)
class CampaignView:
    """A campaign as stored: campaign.json, the records of the passes that are drawn, and what failed."""

    document: Mapping[str, Any]
    records: Mapping[str, PassRecord]
    failures: tuple[Mapping[str, Any], ...] = ()


def parts_of(view: CampaignView) -> tuple[Section, ...]:
    """Every section of a campaign's report, in order."""
    return tuple(build(view) for build in PARTS)


def versions(view: CampaignView) -> Section:
    """One verdict for each version of the parameters."""
    found: Mapping[str, Any] = view.document.get("variants") or {}
    if not found:
        return Section("versions", "Versions", (Missing("No pass could be judged."),))
    rows = tuple(
        (
            name or "(unnamed)",
            deep(v, "verdict", "value"),
            str(deep(v, "verdict", "passes")),
            percent(deep(v, "discrepancy", "trajectory", "combined")),
            interval(deep(v, "discrepancy", "trajectory", "interval")),
            percent(deep(v, "discrepancy", "yaw", "combined")),
            interval(deep(v, "discrepancy", "yaw", "interval")),
            _needed(deep(v, "verdict", "passes_needed")),
        )
        for name, v in found.items()
    )
    columns = (
        "version",
        "verdict",
        "passes",
        "trajectory",
        "interval",
        "yaw",
        "interval",
        "passes to decide",
    )
    return Section(
        "versions",
        "Versions",
        (Table("versions", "Verdict of each version", columns, rows), *_responses(found)),
    )


def _needed(value: Any) -> str:
    return "–" if value is None else str(value)


def _responses(found: Mapping[str, Any]) -> tuple[Table, ...]:
    rows = tuple(
        (
            f"{name}: {RESPONSES[response]}" if name else RESPONSES[response],
            _share(r.get("d")),
            _range(r),
            _share(r.get("d_null")),
            small(r.get("rmse"), response),
            small(r.get("r95"), response),
            small(r.get("u"), response),
            number(None if r.get("spread") is None else 100.0 * (np.exp(r["spread"]) - 1.0), 0, "%"),
        )
        for name, v in found.items()
        for response, r in (v.get("responses") or {}).items()
        if response in RESPONSES
    )
    columns = ("response", "D", "interval", "straight line", "RMSE", "R95", "u", "spread of passes")
    return (Table("responses", "Each response of each version", columns, rows),) if rows else ()


def _share(value: Any) -> str:
    return percent(None if value is None else 100.0 * value)


def _range(response: Mapping[str, Any]) -> str:
    low, high = response.get("lo"), response.get("hi")
    return "–" if low is None or high is None else interval([100.0 * low, 100.0 * high])


def passes(view: CampaignView) -> Section:
    """The table of passes, each linked to its own report, and their discrepancies."""
    listed: Sequence[Mapping[str, Any]] = view.document.get("passes") or []
    if not listed:
        return Section("passes", "Passes", (Missing("There is no pass."),))
    rows = tuple(
        (
            str(p["run"]),
            p["field"],
            p["direction"],
            str(p["repeat"]),
            p["variant"],
            number(p["speed"], 2),
            number(p["hitch_to_com"], 2),
            number(p["tyre_pressure_mpa"], 2),
            percent(p["trajectory"]),
            percent(p["yaw"]),
            p["verdict"],
            str(p["warnings"]),
        )
        for p in listed
    )
    columns = (
        "pass",
        "field",
        "direction",
        "repeat",
        "version",
        "v, m/s",
        "l₅, m",
        "P, MPa",
        "trajectory",
        "yaw",
        "verdict of the pass",
        "warnings",
    )
    links = tuple(f"passes/{p['run']}/report.html" for p in listed)
    table = Table("passes", "Passes, each with its own report", columns, rows, links=links)
    return Section("passes", "Passes", (table, *_scatter(view, listed)))


def _scatter(view: CampaignView, listed: Sequence[Mapping[str, Any]]) -> tuple[Chart, ...]:
    if not any(p["trajectory"] is not None or p["yaw"] is not None for p in listed):
        return ()
    x = np.arange(1.0, len(listed) + 1.0)

    def curve(key: str, name: str, role: Role) -> Curve:
        return Curve(
            name, role, x, np.array([np.nan if p[key] is None else p[key] for p in listed]), style="points"
        )

    threshold = deep(view.document, "verdict", "threshold_percent")
    levels = ((float(threshold), "threshold"),) if threshold is not None else ()
    chart = Chart(
        key="scatter",
        discrete=True,
        title="Discrepancy of each pass",
        x_label="pass, in the order of the table",
        panels=(
            Panel(
                "D, %",
                (curve("trajectory", "trajectory", "measured"), curve("yaw", "yaw", "simulated")),
                levels=levels,
            ),
        ),
        caption="Both bodies combined, each pass by itself.",
        alt=f"Discrepancies of {len(listed)} passes; the table above holds the values.",
    )
    return (chart,)


def repeats(view: CampaignView) -> Section:
    """Repeats of each cell drawn over one another: what the field itself scatters."""
    charts = tuple(_overlay(view, index, cell) for index, cell in enumerate(drawn_cells(view.document)))
    if not charts:
        words = "No pass holds a compared row, so there is nothing to draw."
        return Section("repeats", "Repeats", (Missing(words),))
    left = len(view.document.get("cells") or []) - len(charts)
    more = (
        (Text(f"{left} more cells are not drawn; their passes' own reports show them."),) if left > 0 else ()
    )
    return Section("repeats", "Repeats", (*charts, *more))


def drawn_cells(document: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """The cells whose repeats are drawn: the first few that hold a pass."""
    return tuple(cell for cell in document.get("cells") or [] if cell["passes"])[:MOST_CELLS]


def drawn_runs(cell: Mapping[str, Any]) -> tuple[str, ...]:
    """The repeats of a cell that are drawn, as many as there are colours to tell them apart."""
    return tuple(cell["passes"][: len(ROLES)])


def _overlay(view: CampaignView, index: int, cell: Mapping[str, Any]) -> Chart:
    members = [(run, view.records[run].tracks) for run in drawn_runs(cell)]
    panels = []
    for response in ("deviation1", "deviation2"):
        curves = tuple(
            Curve(run, role, tracks[response].s, 100.0 * tracks[response].measured)
            for role, (run, tracks) in zip(ROLES, members, strict=False)
            if response in tracks
        )
        if curves:
            panels.append(Panel(f"{RESPONSES[response].split(', ')[1]}, cm", curves))
    name = ", ".join(str(cell[key]) for key in ("field", "direction") if cell[key])
    version = f", version {cell['variant']}" if cell["variant"] else ""
    left = len(cell["passes"]) - len(members)
    return Chart(
        key=f"repeats-{index}",
        title=f"Repeats: {name or 'one cell'}{version}",
        x_label="distance along the row, m",
        panels=tuple(panels),
        caption="Measured deviation from the line of each pass's first row, from where it begins."
        + (f" {left} more repeats are not drawn." if left > 0 else ""),
        alt=f"Measured deviation of {len(members)} repeats over distance, one over another.",
    )


def straightness(view: CampaignView) -> Section:
    """Straightness of each cell's runs."""
    rows = tuple(
        (_cell_name(cell), RESPONSES[response], *(_mean_sd(indices.get(i), response) for i in INDICES))
        for cell in view.document.get("cells") or []
        for response, indices in (cell.get("straightness") or {}).items()
        if response in RESPONSES
    )
    if not rows:
        return Section("straightness", "Straightness", (Missing("No pass has straightness indices."),))
    columns = ("cell", "response", *INDICES.values())
    table = Table(
        "straightness", "Straightness indices: mean (standard deviation) over the repeats", columns, rows
    )
    return Section("straightness", "Straightness", (table,))


def _cell_name(cell: Mapping[str, Any]) -> str:
    return ", ".join(str(cell[key]) for key in ("variant", "field", "direction") if cell[key]) or "all"


def _mean_sd(index: Mapping[str, Any] | None, response: str) -> str:
    if index is None:
        return "–"
    spread = "" if index["sd"] is None else f" ({small(index['sd'], response)})"
    return small(index["mean"], response) + spread


def effects(view: CampaignView) -> Section:
    """Effects of speed, hitch length and tyre pressure on straightness, or why they cannot be told."""
    found: Sequence[Mapping[str, Any]] = view.document.get("effects") or []
    if not found:
        return Section("effects", "Effects of the design", (Missing("Too few passes to ask for effects."),))
    rows = tuple(
        (
            _index_name(entry["index"]),
            FACTORS.get(e["factor"], e["factor"]),
            number(e["step"], 2),
            number(e["ratio"], 3),
            f"{number(e['low'], 3)} to {number(e['high'], 3)}",
            number(e["p"], 3),
        )
        for entry in found
        for e in entry["effects"]
    )
    blocks: list[Block] = [Text(words) for words in dict.fromkeys(_caveats(found))]
    if rows:
        columns = ("index", "parameter", "step", "factor", "interval", "p")
        blocks += [Text(EFFECTS), Table("effects", "Effects on the straightness indices", columns, rows)]
    else:
        blocks.append(Missing("No effect can be estimated from these passes."))
    return Section("effects", "Effects of the design", tuple(blocks))


def _index_name(index: str) -> str:
    response, _, name = index.partition(".")
    return f"{RESPONSES.get(response, response)}: {INDICES.get(name, name)}"


def _caveats(found: Sequence[Mapping[str, Any]]) -> list[str]:
    words = []
    for entry in found:
        words += [
            ALIASED.format(" and ".join(FACTORS.get(f, f).split(",")[0] for f in group))
            for group in entry["aliased"]
        ]
        constant = [FACTORS.get(f, f).split(",")[0] for f in entry["constant"]]
        words += [f"Never changed, so without an effect to tell: {', '.join(constant)}."] if constant else []
        words += [entry["note"]] if entry.get("note") else []
    return words


def operating(view: CampaignView) -> Section:
    """The operating curve of each version: what this campaign could have decided."""
    threshold = float(deep(view.document, "settings", "threshold_percent") or 15.0)
    curves = {
        name: v.get("operating_curve") or [] for name, v in (view.document.get("variants") or {}).items()
    }
    charts = tuple(
        _operating_chart(index, name, points, threshold)
        for index, (name, points) in enumerate(curves.items())
        if points
    )
    if not charts:
        return Section(
            "operating",
            "Operating curve",
            (Missing("An operating curve needs two compared passes or more."),),
        )
    return Section("operating", "Operating curve", (Text(CURVE), *charts))


def _operating_chart(index: int, name: str, points: Sequence[Mapping[str, Any]], threshold: float) -> Chart:
    x = np.array([threshold * p["ratio"] for p in points])
    kinds: tuple[tuple[str, str, Role], ...] = (
        ("adequate", "adequate", "third"),
        ("inconclusive", "inconclusive", "null"),
        ("not_adequate", "not adequate", "simulated"),
    )
    curves = tuple(
        Curve(label, role, x, np.array([100.0 * p[key] for p in points]), style="marked")
        for key, label, role in kinds
    )
    at = next((p for p in points if p["ratio"] == 1.0), points[0])
    return Chart(
        key=f"operating-{index}",
        title=f"Chance of each verdict{f', version {name}' if name else ''}",
        x_label="true discrepancy, %",
        panels=(Panel("share of campaigns, %", curves),),
        caption=f"The threshold is {threshold:g} %.",
        alt=(
            f"At the threshold {100.0 * at['adequate']:.0f} % adequate, "
            f"{100.0 * at['inconclusive']:.0f} % inconclusive, {100.0 * at['not_adequate']:.0f} % not "
            "adequate."
        ),
    )


def traditional(view: CampaignView) -> Section:
    """Cochran's and Fisher's tests by cell."""
    rows = tuple(
        (
            _cell_name(cell),
            RESPONSES[response],
            TESTS.get(test, test),
            number(result["statistic"], 3),
            number(result["critical"], 3),
            "holds" if result["holds"] else "rejected",
            f"{result['groups']} × {result['repeats']}",
        )
        for cell in view.document.get("cells") or []
        for response, tests in (cell.get("traditional") or {}).items()
        if tests and response in RESPONSES
        for test, result in tests.items()
    )
    if not rows:
        words = "The traditional tests need two repeats or more in a cell."
        return Section("traditional", "The field's traditional tests", (Missing(words),))
    columns = ("cell", "response", "test", "statistic", "critical", "equality", "stations × repeats")
    table = Table("traditional", "Cochran's C and Fisher's F", columns, rows)
    return Section("traditional", "The field's traditional tests", (Text(FISHER), table))


def left_out(view: CampaignView) -> Section:
    """Passes that were left out or failed, each with its reason."""
    excluded = [(str(e["run"]), "left out", str(e["reason"])) for e in view.document.get("excluded") or []]
    failed = [
        (str(f.get("run") or f.get("source") or "?"), "failed", str(f.get("reason", "")))
        for f in view.failures
    ]
    if not excluded and not failed:
        return Section("left-out", "Left out", (Text("No pass was left out, and none failed."),))
    table = Table(
        "left-out",
        "Passes that do not count",
        ("pass", "what", "reason"),
        (*excluded, *failed),
    )
    return Section("left-out", "Left out", (table,))


def settings(view: CampaignView) -> Section:
    """What was fixed before data were seen."""
    stated: Mapping[str, Any] = view.document.get("settings") or {}
    rows = tuple(
        (key.replace("_", " "), str(value)) for key, value in stated.items() if value not in ("", {}, None)
    )
    return Section(
        "settings",
        "Fixed beforehand",
        (Table("settings", "campaign.toml", ("key", "value"), rows),),
    )


PARTS: tuple[Callable[[CampaignView], Section], ...] = (
    versions,
    passes,
    repeats,
    straightness,
    effects,
    operating,
    traditional,
    left_out,
    settings,
)
