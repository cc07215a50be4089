"""campaign.toml: what was decided before data were seen."""

from __future__ import annotations

import difflib
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from .adequacy import Rules


class CampaignError(ValueError):
    """A campaign that cannot be summed up: one line that says what, where and how to mend it."""


@dataclass(frozen=True)
class CampaignSettings:
    """Keys of campaign.toml, all optional.

    threshold_percent : of the headline discrepancies; alpha : one-sided level; horizon : m, of the windows
    exclude : reason by run id; title, notes : carried to the report
    """

    threshold_percent: float = 15.0
    alpha: float = 0.05
    horizon: float = 25.0
    exclude: Mapping[str, str] = field(default_factory=dict)
    title: str = ""
    notes: str = ""

    @property
    def rules(self) -> Rules:
        """The verdict's rules with this threshold and level."""
        return Rules(threshold_percent=self.threshold_percent, alpha=self.alpha)


def read_settings(path: Path | None) -> CampaignSettings:
    """The settings in a campaign.toml; defaults without one.

    Raises CampaignError: an unknown key names the nearest known one, a value its bound.
    """
    if path is None:
        return CampaignSettings()
    try:
        values = tomllib.loads(path.read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise CampaignError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise CampaignError(f"{path}: is not UTF-8 text; save it as UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise CampaignError(f"{path}: not valid TOML: {error}") from None
    return settings_of(values, str(path))


def settings_of(values: Mapping[str, Any], where: str) -> CampaignSettings:
    """Settings from a table's values, checked."""
    known = [f.name for f in fields(CampaignSettings)]
    for key in values:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f"; did you mean `{near[0]}`?" if near else f"; known are {', '.join(known)}"
            raise CampaignError(f"{where}: {key}: unknown key{hint}")
    for key, low, high in (("threshold_percent", 0.0, 100.0), ("alpha", 0.0, 0.5), ("horizon", 0.0, 1e4)):
        _require_between(values, key, low, high, where)
    for key in ("title", "notes"):
        if not isinstance(values.get(key, ""), str):
            raise CampaignError(f"{where}: {key} must be text")
    exclude = values.get("exclude", {})
    if not isinstance(exclude, Mapping) or not all(isinstance(reason, str) for reason in exclude.values()):
        raise CampaignError(f'{where}: exclude must be a table {{ "run-id" = "reason" }}')
    for run, reason in exclude.items():
        if not reason.strip():
            raise CampaignError(f'{where}: exclude."{run}" needs a reason')
    return CampaignSettings(**values)


def _require_between(values: Mapping[str, Any], key: str, low: float, high: float, where: str) -> None:
    if key not in values:
        return
    value = values[key]
    number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not (number and low < value < high):
        raise CampaignError(f"{where}: {key} is {value!r}; it must be a number between {low:g} and {high:g}")
