"""Options of one pass, all that its result depends on beside its files."""

from __future__ import annotations

from dataclasses import dataclass, replace

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


def of_campaign(campaign: CampaignSettings) -> RunSettings:
    """The options that a campaign.toml asks for."""
    return RunSettings(replay=replace(ReplaySettings(), horizon=campaign.horizon), rules=campaign.rules)
