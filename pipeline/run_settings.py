"""Options of one pass, all that its result depends on beside its files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from .adequacy import Rules
from .campaign_settings import CampaignSettings
from .fusion.settings import FusionSettings
from .replay_settings import ReplaySettings


@dataclass(frozen=True)
class RunSettings:
    """Options of the stages: fusion, replay and comparison, verdict."""

    fusion: FusionSettings = FusionSettings()
    replay: ReplaySettings = ReplaySettings()
    rules: Rules = Rules()


def with_engine(settings: RunSettings, engine: str) -> RunSettings:
    """The same options with another engine of the fusion: "compiled" or "filterpy".

    Raises ValueError for another name.
    """
    if engine not in ("compiled", "filterpy"):
        raise ValueError(f"engine {engine!r}: is neither compiled nor filterpy")
    chosen: Literal["compiled", "filterpy"] = "compiled" if engine == "compiled" else "filterpy"
    return replace(settings, fusion=replace(settings.fusion, engine=chosen))


def of_campaign(campaign: CampaignSettings) -> RunSettings:
    """The options that a campaign.toml asks for."""
    return RunSettings(replay=replace(ReplaySettings(), horizon=campaign.horizon), rules=campaign.rules)
