"""Shelf of companion metrics: one file a metric, listed here. They accompany the headline and never decide.

Mean relative error is not offered: it divides by the deviation's zero crossings.
"""

from __future__ import annotations

from ._base import Metric, Pair, Values
from .correlation import METRIC as CORRELATION
from .cross_track import METRIC as CROSS_TRACK
from .iso18571 import METRIC as ISO18571
from .kge import METRIC as KGE
from .nrmse import METRIC as NRMSE
from .nse import METRIC as NSE
from .range_error import METRIC as RANGE_ERROR
from .rmse import METRIC as RMSE
from .russell import METRIC as RUSSELL
from .sprague_geers import METRIC as SPRAGUE_GEERS
from .theil import METRIC as THEIL

METRICS: tuple[Metric, ...] = (
    RMSE,
    NRMSE,
    NSE,
    RANGE_ERROR,
    SPRAGUE_GEERS,
    RUSSELL,
    THEIL,
    KGE,
    ISO18571,
    CORRELATION,
    CROSS_TRACK,
)

__all__ = ["METRICS", "Metric", "Pair", "Values", "companions"]


def companions(pair: Pair) -> dict[str, dict[str, float]]:
    """Every metric of the shelf for one pair of signals, by key."""
    return {metric.key: dict(metric.compute(pair)) for metric in METRICS}
