"""Whether the filter's own statistics hold: innovations against their bounds, by sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ..report_blocks import Block, Missing, Section, Table, Text
from ..report_view import PassView
from ._common import deep, number

HOLDS = (
    "The filter's innovations agree with their stated variances, so the narrow guard factors (0.8 "
    "and 1.25) apply."
)
FAILS = (
    "The filter's innovations do not agree with their stated variances on this pass, so the verdict uses "
    "the wide guard factors (0.5 and 2)."
)
EXPLAINED = (
    "NIS is the normalised innovation squared: its mean should be the channel's number of dimensions, "
    "within the bounds given. The autocorrelation at lag one should be near zero."
)


def build(view: PassView) -> Section:
    """The section."""
    channels = deep(view.metrics, "consistency", "channels") or deep(view.metrics, "filter", "channels")
    holds = deep(view.metrics, "consistency", "consistent")
    if not channels:
        return Section(
            "consistency",
            "Consistency of the filter",
            (Missing("The result holds no innovation statistics."),),
        )
    words: tuple[Block, ...] = (Text(HOLDS if holds else FAILS), Text(EXPLAINED))
    return Section("consistency", "Consistency of the filter", (*words, _table(channels)))


def _table(channels: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple(
        (str(c["channel"]), str(c["count"]), str(c["rejected"]), str(c["dof"]), number(c["mean_nis"]),
         f"{number(c['nis_low'])} to {number(c['nis_high'])}", number(c["lag1_autocorrelation"]),
         "yes" if c["consistent"] else "no")
        for c in channels
    )  # fmt: skip
    columns = ("channel", "used", "rejected", "dimensions", "mean NIS", "bounds", "lag-one", "consistent")
    return Table("consistency", "Innovations by channel", columns, rows)
