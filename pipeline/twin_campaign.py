"""Synthetic passes on disk: one pass, or a whole campaign of fields, directions, repeats and variants in
one command."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from .twin import make_pass, write_raw
from .twin_plan import TwinPlan, changed, preset, read_plan, with_value
from .twin_tables import PlanError, read_toml

COMPASS = {"east": 0.0, "north": 90.0, "west": 180.0, "south": 270.0}
DEFAULT_LABEL = {"fields": "field1", "directions": "east", "variants": "b"}
AXES = tuple(DEFAULT_LABEL)
RULES = {"threshold_percent": 15.0, "alpha": 0.05, "horizon": 25.0}
SPACING = 600.0  # s between the starts of a campaign's passes
TRUTH = "truth"  # folder beside the passes


@dataclass(frozen=True)
class CampaignPlan:
    """Fields × directions × variants × repeats of one base plan. Each axis is label → changes of the plan.

    threshold_percent, alpha, horizon : what campaign.toml would say, for the forecast of verdicts
    """

    base: TwinPlan
    fields: Mapping[str, Mapping[str, Any]]
    directions: Mapping[str, Mapping[str, Any]]
    variants: Mapping[str, Mapping[str, Any]]
    repeats: int = 1
    seed: int = 0
    threshold_percent: float = RULES["threshold_percent"]
    alpha: float = RULES["alpha"]
    horizon: float = RULES["horizon"]

    def passes(self) -> Iterator[tuple[TwinPlan, int]]:
        """(plan, seed) of every pass; ids are field-variant-direction-repeat, seeds follow each other."""
        count = 0
        for field, field_changes in self.fields.items():
            for variant, variant_changes in self.variants.items():
                for direction, turn in self.directions.items():
                    for repeat in range(1, self.repeats + 1):
                        plan = self.base
                        for changes in (field_changes, variant_changes, turn):
                            plan = changed(plan, changes)
                        yield _labelled(plan, field, variant, direction, repeat, count), self.seed + count
                        count += 1


def _labelled(plan: TwinPlan, field: str, variant: str, direction: str, repeat: int, count: int) -> TwinPlan:
    run = replace(
        plan.run,
        id=f"{field}-{variant}-{direction}-{repeat}",
        field=field, variant=variant, direction=direction, repeat=repeat,
        start=plan.run.start + SPACING * count,
    )  # fmt: skip
    return replace(plan, run=run)


def read_campaign(path: Path) -> CampaignPlan:
    """The campaign plan of a TOML file.

    Keys: preset or plan (a file beside it), seed, repeats, base (changes for all), and fields,
    directions, variants: a list of labels, or a table of label → changes. A direction named by the
    compass turns the base's heading. Raises PlanError: what, where, how to mend.
    """
    table = read_toml(path)
    try:
        return campaign_from(table, path.parent)
    except PlanError as error:
        raise PlanError(f"{path}: {error}") from None


def campaign_from(table: Mapping[str, Any], folder: Path = Path()) -> CampaignPlan:
    """A campaign plan from its TOML form (see `read_campaign`)."""
    known = {"preset", "plan", "seed", "repeats", "base", *AXES, *RULES}
    for key in table:
        if key not in known:
            raise PlanError(f"{key}: unknown key; a campaign has {', '.join(sorted(known))}")
    start = (
        read_plan(folder / table["plan"]) if "plan" in table else preset(str(table.get("preset", "benign")))
    )
    base = changed(start, table.get("base", {}))
    fields, directions, variants = (_axis(table.get(axis), axis) for axis in AXES)
    turned = {label: _turned(base, label, changes) for label, changes in directions.items()}
    repeats, seed = table.get("repeats", 1), table.get("seed", 0)
    if not (isinstance(repeats, int) and repeats >= 1 and isinstance(seed, int) and seed >= 0):
        raise PlanError("repeats must be a whole number from 1, seed one from 0")
    return CampaignPlan(base, fields, turned, variants, repeats, seed, *_rules(table))


def _rules(table: Mapping[str, Any]) -> tuple[float, float, float]:
    """threshold_percent, alpha and horizon: numbers above 0."""
    found = []
    for key, usual in RULES.items():
        value = table.get(key, usual)
        if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0.0:
            raise PlanError(f"{key}: {value!r} must be a number above 0")
        found.append(float(value))
    threshold, alpha, horizon = found
    return threshold, alpha, horizon


def _axis(given: Any, axis: str) -> dict[str, Mapping[str, Any]]:
    if given is None:
        return {DEFAULT_LABEL[axis]: {}}
    if isinstance(given, list) and given and all(isinstance(label, str) for label in given):
        return {label: {} for label in given}
    if isinstance(given, Mapping) and given and all(isinstance(c, Mapping) for c in given.values()):
        return dict(given)
    raise PlanError(f"{axis}: must be a list of labels, or a table of label = {{ changes }}")


def _turned(base: TwinPlan, label: str, changes: Mapping[str, Any]) -> Mapping[str, Any]:
    if "heading_deg" in changes.get("place", {}) or label not in COMPASS:
        return changes
    place = {**changes.get("place", {}), "heading_deg": base.place.heading_deg + COMPASS[label]}
    return {**changes, "place": place}


def synth(
    out: Path,
    *,
    named: str | None = None,
    plan: Path | None = None,
    campaign: Path | None = None,
    seed: int = 0,
    run_id: str | None = None,
) -> tuple[Path, ...]:
    """Write a synthetic pass, or a campaign's passes, under `out`; gives the passes' folders.

    One of `named` (a preset; default "benign"), `plan` (a TOML file) and `campaign` (a TOML file, whose
    own seed counts); passes land in out/<run id>, truth in out/truth/<run id>. Raises PlanError.
    """
    if sum(given is not None for given in (named, plan, campaign)) > 1:
        raise PlanError("give one of a preset, a plan and a campaign")
    if campaign is not None:
        return tuple(_write(out, one, number) for one, number in read_campaign(campaign).passes())
    chosen = read_plan(plan) if plan is not None else preset(named or "benign")
    if run_id is not None:
        chosen = with_value(with_value(chosen, "run.id", run_id), "run.field", run_id)
    return (_write(out, chosen, seed),)


def _write(out: Path, plan: TwinPlan, seed: int) -> Path:
    folder = out / plan.run.id
    write_raw(make_pass(plan, seed), folder, out / TRUTH / plan.run.id)
    return folder
