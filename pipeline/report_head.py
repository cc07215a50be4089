"""The first screen of a report: what was tested, the verdict in words, the headline numbers."""

from __future__ import annotations

from dataclasses import dataclass

SIGNS = {"adequate": "✓", "not adequate": "✗", "inconclusive": "?"}  # beside the colour, never colour alone


@dataclass(frozen=True)
class Number:
    """One headline discrepancy, ready to print; details are pairs of a name and a value."""

    name: str
    value: str
    interval: str
    details: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Head:
    """Title, verdict and numbers of a report, ready to print."""

    title: str
    tested: str
    verdict: str
    verdict_label: str
    meaning: str
    reasons: tuple[str, ...]
    numbers: tuple[Number, ...]
    scope: str
    footer: str
    short: str  # for the running foot of the PDF

    @property
    def sign(self) -> str:
        """A mark for the verdict that does not need colour."""
        return SIGNS.get(self.verdict, "?") if self.verdict else ""
