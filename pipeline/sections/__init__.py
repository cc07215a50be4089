"""Shelf of the report's sections, one file each, in the order of the report.

A section is a module with `build(view: PassView) -> Section`. Adding one is a file here and a line in
`SECTIONS`.
Where a part is absent it says why in a sentence (`Missing`), never an empty chart.
"""

from __future__ import annotations

from typing import Protocol

from ..report_blocks import Section
from ..report_view import PassView
from . import (
    alignment,
    companions,
    conditions,
    consistency,
    discrepancies,
    ground_map,
    health,
    inputs,
    methods,
    provenance,
    residuals,
    spectra,
    trajectories,
    yaw,
)


class SectionModule(Protocol):
    """What a file of this shelf offers."""

    def build(self, view: PassView) -> Section:
        """The section of one pass."""
        ...


SECTIONS: tuple[SectionModule, ...] = (
    trajectories,
    yaw,
    residuals,
    discrepancies,
    alignment,
    spectra,
    companions,
    inputs,
    ground_map,
    consistency,
    health,
    conditions,
    methods,
    provenance,
)
