"""A campaign: cells of field × direction × repeat × version, one verdict a version, from stored results."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ..model.machine import Machine
from ..sensors import manifest as manifests
from ..sensors.manifest import Manifest
from ..sensors.streams import Warn
from .adequacy import ADEQUATE, INCONCLUSIVE, NOT_ADEQUATE, Verdict, judge_campaign
from .bounds import DEVIATION1, DEVIATION2, YAW1, YAW2, PassStatistics, ResponseStatistics
from .campaign_settings import CampaignError, CampaignSettings
from .campaign_spectra import BODIES, StoredDensity, version_spectra
from .compare import run_labels
from .cores import cores
from .effects import Effects, effects_of
from .ensemble import ensemble_values, make_ensemble
from .findings import PAPER, discrepancy_values, verdict_values, warning_values
from .operating import operating_curve
from .report_view import PlotSeries
from .result_tables import read_plots
from .traditional import Track, of_cell

Floats = NDArray[np.float64]

WORST_FIRST = (NOT_ADEQUATE, INCONCLUSIVE, ADEQUATE)
COLUMNS = {DEVIATION1: "n1", DEVIATION2: "n2", YAW1: "yaw1", YAW2: "yaw2"}  # of comparison.parquet
FACTORS = {"speed": 0.3, "hitch_to_com": 1.0, "tyre_pressure_mpa": 0.02}  # steps: m/s, m, MPa (the paper's)
INDICES = ("max_abs", "range", "r95", "rms")
SAME_HORIZON = 1e-9  # m


@dataclass(frozen=True)
class PassRecord:
    """One stored pass: who it is, its design parameters, indices, statistics and tracks.

    row_length : m, mean of the compared rows
    factors : speed m/s, hitch_to_com m (None for a tractor alone), tyre_pressure_mpa
    straightness : indices by response, m or rad; tracks : the first compared row, by response
    acceleration : density of the lateral acceleration, by body
    """

    manifest: Manifest
    verdict: str
    discrepancy: Mapping[str, Any]
    horizon: float | None
    warnings: int
    row_length: float
    straightness: Mapping[str, Mapping[str, float]]
    statistics: PassStatistics | None
    tracks: Mapping[str, Track]
    acceleration: Mapping[str, StoredDensity]

    @property
    def run(self) -> str:
        """The run's id."""
        return self.manifest.run.id

    @property
    def factors(self) -> dict[str, float | None]:
        """The design parameters whose effects are asked for."""
        operating, seeder = self.manifest.operating, self.manifest.machine.seeder
        return {
            "speed": operating.speed,
            "hitch_to_com": None if seeder is None else seeder.hitch_to_com,
            "tyre_pressure_mpa": operating.tyre_pressure_mpa,
        }


def read_record(folder: Path) -> PassRecord:
    """One pass's record from its results folder.

    Raises CampaignError that names the file which is absent or cannot be read.
    """
    try:
        metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        manifest, _ = manifests.read(folder / "run.toml")
        manifest = manifest.dated(metrics.get("provenance", {}).get("date"))
        path = folder / "comparison.parquet"
        columns = _columns(path) if path.is_file() else {}
        plots = folder / "plots.parquet"
        return record_of(manifest, metrics, columns, read_plots(plots) if plots.is_file() else {})
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CampaignError(f"{folder}: no result that can be read: {error}; run the pass again") from error


def _columns(path: Path) -> dict[str, Floats]:
    table = pq.read_table(path)
    return {name: table[name].to_numpy().astype(np.float64) for name in table.column_names}


def record_of(
    manifest: Manifest,
    metrics: Mapping[str, Any],
    columns: Mapping[str, Floats],
    plots: Mapping[str, Mapping[str, PlotSeries]] | None = None,
) -> PassRecord:
    """The record of a pass from its manifest, metrics.json, the columns of comparison.parquet and its plots."""
    compared = bool(metrics["responses"]) and bool(columns)
    rows = metrics["comparison"]["rows"]
    return PassRecord(
        manifest=manifest,
        verdict=str(metrics["verdict"]["value"]),
        discrepancy=metrics["discrepancy"],
        horizon=metrics["comparison"]["horizon"],
        warnings=len(metrics["warnings"]),
        row_length=float(np.mean([r["length"] for r in rows])) if rows else 0.0,
        straightness=metrics["straightness"],
        statistics=statistics_of(manifest, metrics, columns) if compared else None,
        tracks={n: _track(columns, n) for n in metrics["responses"]} if compared else {},
        acceleration=_accelerations(metrics, plots or {}),
    )


def _accelerations(
    metrics: Mapping[str, Any], plots: Mapping[str, Mapping[str, PlotSeries]]
) -> dict[str, StoredDensity]:
    values, curves = metrics["spectra"].get("acceleration", {}), plots.get("acceleration", {})
    return {
        body: StoredDensity(
            curves[f"{body} measured"].x,
            curves[f"{body} measured"].y,
            float(values[body]["dof"]),
            int(values[body]["segments"]),
            float(values[body]["segment_length"]),
        )
        for body in BODIES
        if body in values and f"{body} measured" in curves
    }


def statistics_of(
    manifest: Manifest, metrics: Mapping[str, Any], columns: Mapping[str, Floats]
) -> PassStatistics:
    """The numbers that the verdict needs, back from a stored pass."""
    return PassStatistics(
        **run_labels(manifest),
        responses={n: _response(v, columns, n) for n, v in metrics["responses"].items()},
        windows_within=float(metrics["alignment"]["windows_within_bound"]),
        consistent=bool(metrics["consistency"]["consistent"]),
        tractor_testable=bool(metrics["steering"]["testable"]),
    )


def _response(values: Mapping[str, Any], columns: Mapping[str, Floats], name: str) -> ResponseStatistics:
    return ResponseStatistics(
        mse=values["rmse"] ** 2,
        null_mse=values["rmse_null"] ** 2,
        r95=values["r95"],
        u2=values["u"] ** 2,
        u2_range=values["u_range"] ** 2,
        u2_absolute=values["u_absolute"] ** 2,
        u2_input=values["u_input"] ** 2,
        n_eff=values["n_eff"],
        n_eff_range=values["n_eff_range"],
        deviation=_centred_rows(columns, name),
    )


def _valid(columns: Mapping[str, Floats], name: str) -> NDArray[np.bool_]:
    body = COLUMNS[name][-1]
    return np.asarray(np.nan_to_num(columns[f"valid{body}"]) > 0.5)


def _centred_rows(columns: Mapping[str, Floats], name: str) -> Floats:
    values, valid = columns[COLUMNS[name]], _valid(columns, name)
    rows = [values[valid & (columns["row"] == row)] for row in np.unique(columns["row"])]
    return np.concatenate([r - r.mean() for r in rows if r.size])


def _track(columns: Mapping[str, Floats], name: str) -> Track:
    first = _valid(columns, name) & (columns["row"] == columns["row"].min())
    s = columns["s"][first]
    return Track(s - s[0], columns[COLUMNS[name]][first], columns[f"{COLUMNS[name]}_simulated"][first])


@dataclass(frozen=True)
class Excluded:
    """A pass left out of the verdict, and why."""

    run: str
    reason: str


@dataclass(frozen=True)
class Campaign:
    """A campaign summed up: `document` is campaign.json, the rest what the tables are made from."""

    records: tuple[PassRecord, ...]
    excluded: tuple[Excluded, ...]
    verdicts: Mapping[str, Verdict]
    effects: tuple[Effects, ...]
    cells: tuple[Mapping[str, Any], ...]
    document: Mapping[str, Any]


def summarise_campaign(
    records: Sequence[PassRecord], settings: CampaignSettings = CampaignSettings(), seed: int = 1
) -> Campaign:
    """Verdict, cells, traditional tests, effects and operating curve of the passes' records.

    A pass is left out where campaign.toml says so, where no row was compared, or where its windows were
    of another
    length than the campaign's; each with its reason.
    """
    kept, excluded = sort_out(records, settings)
    names = dict.fromkeys(r.manifest.run.variant for r in kept)
    by_variant = {v: [r for r in kept if r.manifest.run.variant == v] for v in names}
    with ThreadPoolExecutor(1) as beside:  # compiled code, which other code need not wait for
        ensembles = {v: beside.submit(version_ensemble, rs) for v, rs in by_variant.items()}
        verdicts = {v: judge_campaign(_statistics(rs), settings.rules) for v, rs in by_variant.items()}
        effects = effects_table(kept, settings.alpha)
        cells = tuple(cell_values(kept, settings.alpha))
        variants = {v: variant_values(verdicts[v], rs, settings, seed) for v, rs in by_variant.items()}
    for variant, values in variants.items():
        values["ensemble"] = ensembles[variant].result()
    document = {
        "schema": 1,
        "run": settings.title or "campaign",
        "verdict": worst_verdict(verdicts),
        "discrepancy": worst_discrepancy(verdicts),
        "paper": dict(PAPER),
        "warnings": unknown_exclusions(records, settings),
        "health": {},
        "settings": {**asdict(settings), "exclude": dict(settings.exclude)},
        "variants": variants,
        "cells": list(cells),
        "effects": [asdict(e) for e in effects],
        "excluded": [asdict(e) for e in excluded],
        "passes": [pass_values(r) for r in records],
    }
    return Campaign(tuple(records), excluded, verdicts, effects, cells, document)


def unknown_exclusions(records: Sequence[PassRecord], settings: CampaignSettings) -> list[dict[str, Any]]:
    """A warning for each excluded run that has no result: it may have failed, or be misspelt."""
    runs = [r.run for r in records]
    found = []
    for run in settings.exclude:
        if run not in runs:
            near = difflib.get_close_matches(run, runs, n=1, cutoff=0.6)
            hint = f"; did you mean `{near[0]}`?" if near else ""
            what = f'exclude."{run}": there is no such pass among the results{hint}'
            found.append(warning_values(Warn(what, "nothing was left out by it", file="campaign.toml")))
    return found


def sort_out(
    records: Sequence[PassRecord], settings: CampaignSettings
) -> tuple[list[PassRecord], tuple[Excluded, ...]]:
    """The records that count, and those that do not with the reason."""
    kept, excluded = [], []
    for record in records:
        reason = _reason(record, settings)
        if reason:
            excluded.append(Excluded(record.run, reason))
        else:
            kept.append(record)
    return kept, tuple(excluded)


def _reason(record: PassRecord, settings: CampaignSettings) -> str:
    if record.run in settings.exclude:
        return settings.exclude[record.run]
    if record.statistics is None:
        return "no row was compared"
    if record.horizon is None or abs(record.horizon - settings.horizon) > SAME_HORIZON:
        return f"compared in windows of {record.horizon} m, the campaign asks for {settings.horizon:g} m"
    return ""


def _statistics(records: Sequence[PassRecord]) -> list[PassStatistics]:
    return [r.statistics for r in records if r.statistics is not None]


def worst_verdict(verdicts: Mapping[str, Verdict]) -> dict[str, Any]:
    """The campaign's verdict: the worst of its versions', with each version's reasons."""
    if not verdicts:
        return verdict_values(judge_campaign(()))
    worst = min(verdicts.values(), key=lambda v: WORST_FIRST.index(v.value))
    found = verdict_values(worst)
    many = len(verdicts) > 1
    found["reasons"] = [
        f"version {name or '(unnamed)'}: {reason}" if many else reason
        for name, verdict in verdicts.items()
        if verdict.value == worst.value
        for reason in verdict.reasons
    ]
    found["passes"] = sum(v.passes for v in verdicts.values())
    return found


def worst_discrepancy(verdicts: Mapping[str, Verdict]) -> dict[str, Any]:
    """The headline of the version whose combined trajectory discrepancy is the largest."""
    found = [discrepancy_values(v.responses) for v in verdicts.values()]
    if not found:
        return discrepancy_values({})
    return max(found, key=lambda d: d["trajectory"]["combined"] or -1.0)


def variant_values(
    verdict: Verdict, records: Sequence[PassRecord], settings: CampaignSettings, seed: int
) -> dict[str, Any]:
    """One version without its ensemble: verdict, headline, responses with bounds, operating curve."""
    return {
        "verdict": verdict_values(verdict),
        "discrepancy": discrepancy_values(verdict.responses),
        "responses": {n: asdict(j) for n, j in verdict.responses.items()},
        "passes": [r.run for r in records],
        "spectra": version_spectra([r.tracks for r in records], [r.acceleration for r in records]),
        "operating_curve": [asdict(p) for p in operating_curve(_statistics(records), settings.rules, seed)],
    }


def version_ensemble(records: Sequence[PassRecord]) -> dict[str, Any]:
    """Ensemble mode of one version: its first pass's machine at the passes' mean speed and row length."""
    manifest = records[0].manifest
    machine = Machine.from_mapping(manifest.machine.model_dump(), manifest.operating.tyre_pressure_mpa)
    speed = float(np.mean([r.manifest.operating.speed for r in records]))
    measured: dict[str, list[float]] = {}
    for record in records:
        for response, indices in record.straightness.items():
            for index, value in indices.items():
                measured.setdefault(f"{response}.{index}", []).append(value)
    length = float(np.mean([r.row_length for r in records]))
    return ensemble_values(make_ensemble(machine, speed, length, threads=cores()), measured)


def cell_values(records: Sequence[PassRecord], alpha: float) -> list[dict[str, Any]]:
    """Each cell field × direction × version: its passes, their indices' means and spreads, the
    traditional tests."""
    keys = dict.fromkeys(
        (r.manifest.run.variant, r.manifest.run.field, r.manifest.run.direction) for r in records
    )
    cells = []
    for variant, field, direction in keys:
        members = [
            r
            for r in records
            if (r.manifest.run.variant, r.manifest.run.field, r.manifest.run.direction)
            == (variant, field, direction)
        ]
        cells.append(
            {
                "variant": variant,
                "field": field,
                "direction": direction,
                "passes": [r.run for r in members],
                "straightness": _index_statistics(members),
                "traditional": _traditional(members, alpha),
            }
        )
    return cells


def _index_statistics(members: Sequence[PassRecord]) -> dict[str, Any]:
    """Mean, standard deviation and count of each index over a cell's repeats."""
    found: dict[str, Any] = {}
    for response in dict.fromkeys(n for r in members for n in r.straightness):
        values = {
            i: [r.straightness[response][i] for r in members if response in r.straightness] for i in INDICES
        }
        found[response] = {
            index: {
                "mean": float(np.mean(v)),
                "sd": float(np.std(v, ddof=1)) if len(v) > 1 else None,
                "count": len(v),
            }
            for index, v in values.items()
        }
    return found


def _traditional(members: Sequence[PassRecord], alpha: float) -> dict[str, Any]:
    responses = [n for n in COLUMNS if all(n in r.tracks for r in members)]
    found = {n: of_cell([r.tracks[n] for r in members], alpha) for n in responses}
    return {
        n: None if tests is None else {name: asdict(result) for name, result in tests.items()}
        for n, tests in found.items()
    }


def effects_table(records: Sequence[PassRecord], alpha: float) -> tuple[Effects, ...]:
    """Effects of speed, l5 and tyre pressure on every straightness index; the unit is the pass."""
    found = []
    for response in dict.fromkeys(n for r in records for n in r.straightness):
        usable = [r for r in records if response in r.straightness]
        factors = {
            name: np.array([r.factors[name] for r in usable], dtype=np.float64)
            for name in FACTORS
            if all(r.factors[name] is not None for r in usable)
        }
        fields = [r.manifest.run.field for r in usable]
        directions = [r.manifest.run.direction for r in usable]
        for index in INDICES:
            values = np.array([r.straightness[response][index] for r in usable])
            if (values > 0.0).all():
                name = f"{response}.{index}"
                found.append(effects_of(name, values, factors, fields, directions, FACTORS, alpha))
    return tuple(found)


def pass_values(record: PassRecord) -> dict[str, Any]:
    """One line a pass for campaign.json."""
    return {
        **run_labels(record.manifest),
        **record.factors,
        "verdict": record.verdict,
        "trajectory": record.discrepancy["trajectory"]["combined"],
        "yaw": record.discrepancy["yaw"]["combined"],
        "warnings": record.warnings,
    }
