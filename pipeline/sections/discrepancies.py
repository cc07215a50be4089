"""The numbers behind the headline, response by response, and the threshold they are held against."""

from __future__ import annotations

from ..report_blocks import Block, Missing, Section, Table, Text
from ..report_view import PassView
from ._common import RESPONSES, deep, interval, nothing_compared, percent, responses_of, small

COLUMNS = ("response", "D", "interval", "straight line", "RMSE", "R95", "u", "u input")
EXPLAINED = (
    "D is the discrepancy in percent of R95; the straight line is the null model, scored in the "
    "same way. u is the standard uncertainty that measuring error leaves in the residual, u input "
    "that of steering, start and stated parameters."
)
ATTRIBUTION = (
    "Attribution, after ASME V&V 20: u_val joins the uncertainty of measurement and inputs. "
    "“Explained” says whether the residual is no larger than these alone produce in 95 of 100 draws."
)


def build(view: PassView) -> Section:
    """The section."""
    names = responses_of(view)
    if not names:
        return Section("discrepancies", "Discrepancies", (Missing(nothing_compared(view)),))
    blocks: tuple[Block, ...] = (Text(_rule(view)), _table(view, names), Text(EXPLAINED))
    if view.metrics.get("attribution"):
        blocks = (*blocks, Text(ATTRIBUTION), _attribution(view, names))
    return Section("discrepancies", "Discrepancies", (*blocks, *_straightness(view, names)))


def _rule(view: PassView) -> str:
    threshold = percent(deep(view.metrics, "verdict", "threshold_percent"), 0)
    return (
        f"The threshold, fixed before the data were seen, is {threshold} for every response; the "
        "paper's figures are 11 % for trajectories and 9 % for turning angles."
    )


def _table(view: PassView, names: tuple[str, ...]) -> Table:
    rows = []
    for name in names:
        r = view.metrics["responses"][name]
        rows.append(
            (RESPONSES[name], percent(r["percent"]), interval(r["interval"]), percent(r["percent_null"]),
             *(small(r[key], name) for key in ("rmse", "r95", "u", "u_input")))
        )  # fmt: skip
    return Table("discrepancies", "Discrepancy of each response", COLUMNS, tuple(rows))


def _attribution(view: PassView, names: tuple[str, ...]) -> Table:
    rows = []
    for name in names:
        a = view.metrics["attribution"].get(name) or {}
        groups = [key for key in a if key.startswith("u_") and key not in {"u_measuring", "u_val"}]
        inputs = ", ".join(f"{key[2:]} {small(a[key], name)}" for key in groups)
        share = a.get("share_within_2_u_val")
        rows.append(
            (RESPONSES[name], small(a.get("u_measuring"), name), inputs, small(a.get("u_val"), name),
             percent(None if share is None else 100.0 * share, 0), "yes" if a.get("explained") else "no")
        )  # fmt: skip
    columns = ("response", "u measuring", "u of inputs", "u_val", "|e| < 2 u_val", "explained")
    return Table("attribution", "What known uncertainty explains", columns, tuple(rows))


def _straightness(view: PassView, names: tuple[str, ...]) -> tuple[Block, ...]:
    found = view.metrics.get("straightness") or {}
    rows = tuple(
        (RESPONSES[name], *(small(found[name].get(key), name) for key in ("max_abs", "range", "r95", "rms")))
        for name in names
        if name in found
    )
    columns = ("response", "greatest", "range", "R95", "rms")
    return (Table("straightness", "Straightness of the measured run", columns, rows),) if rows else ()
