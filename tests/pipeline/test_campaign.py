"""A campaign from its passes: cells, verdict by version, exclusions, tables, operating curve, its files."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from smts_validate.pipeline.adequacy import Rules, judge_campaign, judge_pass
from smts_validate.pipeline.bounds import DEVIATION1, RESPONSES
from smts_validate.pipeline.campaign import (
    Campaign,
    PassRecord,
    read_record,
    record_of,
    summarise_campaign,
)
from smts_validate.pipeline.campaign_settings import CampaignError, CampaignSettings, read_settings
from smts_validate.pipeline.campaign_spectra import StoredDensity, averaged, version_spectra
from smts_validate.pipeline.compare import compare
from smts_validate.pipeline.findings import comparison_columns, metrics_of
from smts_validate.pipeline.operating import operating_curve
from smts_validate.pipeline.result import dump_json
from smts_validate.pipeline.tables import (
    Table,
    campaign_tables,
    csv_text,
    escaped,
    latex_text,
    write_campaign_tables,
)
from smts_validate.sensors.manifest import Manifest
from synthetic_motion import RUN_TOML, Errors, Field, machine_of, manifest_of, motion_of, truth_of

SPEED = 2.8
GROSS = {f"tyres.{axle}.cornering_stiffness": 0.35 for axle in ("front", "rear", "seeder")} | {
    "seeder.hitch_to_com": 2.2
}
Wrong = tuple[tuple[str, float], ...]
DOCS = Path(__file__).parent.parent.parent / "docs"


@cache
def stored(
    seed: int, errors: Errors = Errors(), wrong: tuple[tuple[str, float], ...] = ()
) -> tuple[Any, Any]:
    """metrics.json and comparison.parquet's columns of a simulated pass, as a results folder holds them."""
    manifest = manifest_of()
    machine = machine_of(manifest)
    motion = motion_of(truth_of(machine, Field(), SPEED, seed), machine, errors, 900 + seed)
    model = machine.replace_parameters({n: f * machine.parameter(n) for n, f in wrong})
    comparison = compare(motion, model, manifest)
    metrics = metrics_of(manifest, motion, comparison, judge_pass(comparison.statistics))
    return json.loads(dump_json(metrics)), comparison_columns(comparison)


def manifest_for(index: int, **changes: Any) -> Manifest:
    values = {
        "id": f"pass-{index}",
        "direction": ("east", "west")[index % 2],
        "repeat": 1 + index // 2,
    } | changes
    return manifest_of(**values)


def record(index: int, errors: Errors = Errors(), wrong: Wrong = (), **run: Any) -> PassRecord:
    metrics, columns = stored(index, errors, wrong)
    return record_of(manifest_for(index, **run), metrics, columns)


@cache
def good() -> Campaign:
    return summarise_campaign([record(i) for i in range(6)])


def test_passes_of_the_true_model_make_an_adequate_campaign() -> None:
    document = good().document
    assert document["verdict"]["value"] == "adequate"
    assert document["verdict"]["scope"] == "campaign"
    assert document["verdict"]["passes"] == 6
    assert document["discrepancy"]["trajectory"]["combined"] < 10.0


def test_campaign_json_satisfies_its_schema_and_begins_like_metrics_json() -> None:
    document = json.loads(dump_json(good().document))
    jsonschema.validate(document, json.loads((DOCS / "campaign.schema.json").read_text()))
    assert list(document)[:4] == ["schema", "run", "verdict", "discrepancy"]


def test_an_empty_campaign_is_inconclusive_and_satisfies_the_schema() -> None:
    document = json.loads(dump_json(summarise_campaign([]).document))
    assert document["verdict"]["value"] == "inconclusive"
    assert document["discrepancy"]["trajectory"]["combined"] is None
    jsonschema.validate(document, json.loads((DOCS / "campaign.schema.json").read_text()))


def test_the_campaign_s_verdict_is_that_of_its_own_statistics_read_back() -> None:
    passes = [r.statistics for r in good().records if r.statistics is not None]
    assert good().verdicts["b"] == judge_campaign(passes)
    logs = [np.log(np.sqrt(p.responses[DEVIATION1].mse)) for p in passes]
    found = good().document["variants"]["b"]["responses"][DEVIATION1]
    assert found["rmse"] == pytest.approx(np.exp(np.mean(logs)))


def test_stored_statistics_are_those_that_were_computed() -> None:
    manifest = manifest_of()
    machine = machine_of(manifest)
    motion = motion_of(truth_of(machine, Field(), SPEED, 0), machine, Errors(), 900)
    comparison = compare(motion, machine, manifest)
    assert comparison.statistics is not None
    back = record(0).statistics
    assert back is not None
    for name, response in comparison.statistics.responses.items():
        for key, value in vars(response).items():
            assert getattr(back.responses[name], key) == pytest.approx(value, rel=1e-9, abs=1e-12)
    assert back.windows_within == comparison.statistics.windows_within


def test_versions_get_a_verdict_each_and_the_worst_is_the_campaign_s() -> None:
    bad = tuple(GROSS.items())
    records = [record(i) for i in range(6)]
    records += [record(i, wrong=bad, id=f"c-{i}", variant="c") for i in range(6)]
    found = summarise_campaign(records)
    assert {v: x.value for v, x in found.verdicts.items()} == {"b": "adequate", "c": "not adequate"}
    assert found.document["verdict"]["value"] == "not adequate"
    assert all(r.startswith("version c: ") for r in found.document["verdict"]["reasons"])


def test_exclusions_are_listed_with_their_reason_and_take_part_in_nothing() -> None:
    settings = CampaignSettings(exclude={"pass-3": "the seeder hit a stone"})
    found = summarise_campaign([record(i) for i in range(6)], settings)
    assert found.document["excluded"] == [{"run": "pass-3", "reason": "the seeder hit a stone"}]
    assert found.document["verdict"]["passes"] == 5
    assert "pass-3" not in found.document["variants"]["b"]["passes"]
    assert "pass-3" in [p["run"] for p in found.document["passes"]]


def test_an_exclusion_of_an_unknown_pass_is_a_warning_and_not_silently_nothing() -> None:
    found = summarise_campaign([record(i) for i in range(4)], CampaignSettings(exclude={"pas-3": "typo"}))
    (warning,) = found.document["warnings"]
    assert 'exclude."pas-3"' in warning["what"]
    assert "did you mean `pass-3`" in warning["what"]
    jsonschema.validate(
        json.loads(dump_json(found.document)), json.loads((DOCS / "campaign.schema.json").read_text())
    )


def test_passes_in_other_windows_are_left_out_with_the_reason() -> None:
    found = summarise_campaign([record(i) for i in range(4)], CampaignSettings(horizon=10.0))
    assert len(found.excluded) == 4
    assert "25.0 m" in found.excluded[0].reason


def test_a_pass_without_a_row_is_left_out_with_the_reason() -> None:
    metrics, columns = stored(0)
    empty = record_of(manifest_for(9), metrics | {"responses": {}, "straightness": {}}, columns)
    found = summarise_campaign([*[record(i) for i in range(4)], empty])
    assert found.document["excluded"] == [{"run": "pass-9", "reason": "no row was compared"}]


def test_cells_are_field_by_direction_by_version_with_their_repeats() -> None:
    cells = good().cells
    assert [(c["field"], c["direction"], len(c["passes"])) for c in cells] == [
        ("field1", "east", 3),
        ("field1", "west", 3),
    ]
    index = cells[0]["straightness"][DEVIATION1]["r95"]
    values = [r.straightness[DEVIATION1]["r95"] for r in good().records if r.manifest.run.direction == "east"]
    assert index["mean"] == pytest.approx(np.mean(values))
    assert index["sd"] == pytest.approx(np.std(values, ddof=1))
    assert {"cochran", "fisher"} == set(cells[0]["traditional"][DEVIATION1])


def test_the_operating_curve_falls_for_adequate_and_rises_for_not_adequate() -> None:
    curve = good().document["variants"]["b"]["operating_curve"]
    adequate = [p["adequate"] for p in curve]
    rejected = [p["not_adequate"] for p in curve]
    assert adequate == sorted(adequate, reverse=True)
    assert rejected == sorted(rejected)
    assert adequate[0] > 0.9
    assert rejected[-1] > 0.9
    by_ratio = {p["ratio"]: p for p in curve}
    assert by_ratio[1.5]["adequate"] < 0.05
    assert by_ratio[0.5]["not_adequate"] < 0.05
    assert all(p["adequate"] + p["not_adequate"] + p["inconclusive"] == pytest.approx(1.0) for p in curve)


def test_more_passes_decide_more_often() -> None:
    passes = [r.statistics for r in good().records if r.statistics is not None]
    few = operating_curve(passes[:4], Rules(), ratios=(0.6,), repeats=150)[0]
    many = operating_curve([*passes, *passes, *passes], Rules(), ratios=(0.6,), repeats=150)[0]
    assert many.adequate > few.adequate


def test_one_pass_has_no_operating_curve() -> None:
    statistics = record(0).statistics
    assert statistics is not None
    assert operating_curve([statistics], Rules()) == ()


def test_tables_are_read_back_as_csv_and_set_as_latex() -> None:
    for table in campaign_tables(good()):
        rows = list(csv.reader(io.StringIO(csv_text(table))))
        assert rows[0] == list(table.header)
        assert len(rows) == 1 + len(table.rows)
        text = latex_text(table)
        assert text.count(r"\\") == 1 + len(table.rows)
        assert text.count("&") == (len(table.header) - 1) * (1 + len(table.rows))


def test_latex_s_own_characters_in_a_name_do_no_harm() -> None:
    table = Table("t", "50 % of a_b", ("name", "value"), (("A&B_{c}\\~^$#", 1.23456), (None, None)))
    text = latex_text(table)
    assert r"A\&B\_\{c\}\textbackslash{}\textasciitilde{}\textasciicircum{}\$\#" in text
    assert "1.23" in text
    assert "--" in text
    assert escaped("50 %") == r"50 \%"


def test_tables_are_written_beside_each_other(tmp_path: Path) -> None:
    written = write_campaign_tables(good(), tmp_path / "tables")
    assert set(written) == {"discrepancy", "straightness", "traditional", "effects", "passes", "excluded"}
    for name in written:
        assert (tmp_path / "tables" / f"{name}.csv").is_file()
        assert (tmp_path / "tables" / f"{name}.tex").read_text(encoding="utf-8").startswith(r"\begin{table}")


def test_a_results_folder_that_is_no_result_is_named(tmp_path: Path) -> None:
    with pytest.raises(CampaignError, match="no result that can be read"):
        read_record(tmp_path)


def write_result_folder(folder: Path, index: int) -> None:
    """A results folder with what a campaign reads."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    metrics, columns = stored(index % 6)
    folder.mkdir(parents=True)
    text = RUN_TOML.replace('id = "synthetic-1"', f'id = "pass-{index}"')
    text = text.replace('direction = "east"', f'direction = "{("east", "west")[index % 2]}"')
    (folder / "run.toml").write_text(text, encoding="utf-8")
    (folder / "metrics.json").write_text(json.dumps(metrics), encoding="utf-8")
    pq.write_table(pa.table(dict(columns)), folder / "comparison.parquet")


def test_a_record_is_read_from_its_folder(tmp_path: Path) -> None:
    write_result_folder(tmp_path / "pass-3", 3)
    found = read_record(tmp_path / "pass-3")
    assert found.run == "pass-3"
    assert found.statistics is not None
    expected = record(3).statistics
    assert expected is not None
    assert found.statistics.responses[DEVIATION1].mse == expected.responses[DEVIATION1].mse


@pytest.mark.slow
def test_a_hundred_passes_are_summarised_and_tabled(tmp_path: Path) -> None:
    folders = [tmp_path / f"pass-{i}" for i in range(100)]
    for i, folder in enumerate(folders):
        write_result_folder(folder, i)
    found = summarise_campaign([read_record(f) for f in folders])
    campaign_tables(found)
    assert found.document["verdict"]["passes"] == 100


def toml(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "campaign.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_campaign_toml_is_read_and_its_absence_means_the_defaults(tmp_path: Path) -> None:
    assert read_settings(None) == CampaignSettings()
    text = 'threshold_percent = 12\nalpha = 0.1\nhorizon = 30.0\ntitle = "T"\n[exclude]\n"p-1" = "stone"\n'
    found = read_settings(toml(tmp_path, text))
    assert found == CampaignSettings(12, 0.1, 30.0, {"p-1": "stone"}, "T", "")
    assert found.rules == Rules(threshold_percent=12, alpha=0.1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("treshold_percent = 10", "did you mean `threshold_percent`"),
        ("threshold_percent = nan", "between 0 and 100"),
        ("threshold_percent = -1", "between 0 and 100"),
        ("alpha = true", "between 0 and 0.5"),
        ("horizon = 'long'", "between 0"),
        ("title = 3", "title must be text"),
        ("exclude = ['p-1']", "table"),
        ('[exclude]\n"p-1" = " "', "needs a reason"),
        ("a = [", "not valid TOML"),
    ],
)
def test_a_mistake_in_campaign_toml_is_named_in_one_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(CampaignError) as caught:
        read_settings(toml(tmp_path, text))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(CampaignError, match="cannot be read"):
        read_settings(tmp_path / "absent.toml")


def real_discrepancies(wrong: Mapping[str, float], seeds: range) -> dict[str, float]:
    """The wrong model's discrepancy with true inputs and no measuring error: geometric mean over passes."""
    manifest = manifest_of()
    machine = machine_of(manifest)
    model = machine.replace_parameters({n: f * machine.parameter(n) for n, f in wrong.items()})
    names = ("slow", "fast", "yaw1", "yaw2", "speed", "rate", "steer", "steer_zero", "steer_scale")
    tiny = dict.fromkeys(names, 1e-7)
    logs = []
    for seed in seeds:
        motion = motion_of(truth_of(machine, Field(), SPEED, seed), machine, Errors(**tiny), 1)
        statistics = compare(motion, model, manifest).statistics
        assert statistics is not None
        logs.append([np.log(np.sqrt(r.mse) / r.r95) for r in statistics.responses.values()])
    return dict(zip(statistics.responses, np.exp(np.mean(logs, axis=0)), strict=True))


def one_campaign(seed: int, wrong: Mapping[str, float], errors: Errors) -> str:
    """The verdict on six passes drawn about fresh truths."""
    manifest = manifest_of()
    machine = machine_of(manifest)
    model = machine.replace_parameters({n: f * machine.parameter(n) for n, f in wrong.items()})
    passes = []
    for i in range(6):
        truth = truth_of(machine, Field(), SPEED, 1000 * seed + i)
        motion = motion_of(truth, machine, errors, 7000 + 1000 * seed + i)
        statistics = compare(motion, model, manifest_for(i)).statistics
        assert statistics is not None
        passes.append(statistics)
    return judge_campaign(passes, foresee=False).value


METRE = Errors(slow=1.0, fast=0.3, yaw1=0.01, yaw2=0.015)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "errors", "allowed"),
    [
        ({}, Errors(), {"adequate"}),
        (GROSS, Errors(), {"not adequate"}),
        ({}, METRE, {"inconclusive"}),
        (GROSS, METRE, {"inconclusive"}),
    ],
    ids=["true", "gross", "metre", "gross and metre"],
)
def test_campaigns_drawn_from_the_stated_covariance_get_the_verdict_they_deserve(
    wrong: Mapping[str, float], errors: Errors, allowed: set[str]
) -> None:
    if wrong:
        assert max(real_discrepancies(wrong, range(3)).values()) > 1.3 * 0.15
    assert one_campaign(1, wrong, errors) in allowed


@pytest.mark.full
def test_confusion_table_over_a_hundred_and_twenty_campaigns() -> None:
    kinds: list[tuple[str, Mapping[str, float], Errors, int]] = [
        ("true", {}, Errors(), 50),
        ("gross", GROSS, Errors(), 40),
        ("metre", {}, METRE, 30),
    ]
    table = {
        name: [one_campaign(i, wrong, errors) for i in range(count)] for name, wrong, errors, count in kinds
    }
    shares = {
        name: {v: values.count(v) / len(values) for v in ("adequate", "not adequate", "inconclusive")}
        for name, values in table.items()
    }
    assert max(real_discrepancies(GROSS, range(6)).values()) > 1.3 * 0.15
    assert shares["true"]["not adequate"] == 0.0
    assert shares["true"]["adequate"] > 0.6
    assert shares["gross"]["adequate"] == 0.0
    assert shares["gross"]["not adequate"] > 0.8
    assert shares["metre"]["inconclusive"] == 1.0


def test_every_response_is_written_for_the_campaign_to_read() -> None:
    metrics, _ = stored(0)
    assert tuple(sorted(metrics["responses"])) == tuple(sorted(RESPONSES))


def test_densities_are_averaged_over_passes_with_their_degrees_of_freedom() -> None:
    frequency = np.linspace(0.1, 5.0, 50)
    bump = np.exp(-(((frequency - 2.0) / 0.3) ** 2))
    stored = [StoredDensity(frequency, size * bump, 4.0, 2, 10.0) for size in (1.0, 3.0)]
    odd = StoredDensity(frequency[::2], bump[::2], 4.0, 2, 5.0)
    found = averaged([*stored, odd])
    assert found is not None
    assert found.density[1:] == pytest.approx(2.0 * bump)
    assert (found.dof, found.segments) == (8.0, 4)
    values = version_spectra([], [{"tractor": s} for s in stored])["acceleration"]["tractor"]
    assert values["peaks"][0]["frequency"] == pytest.approx(2.0, abs=0.06)
    # ∫ 2·exp(−((f − 2)/0.3)²) df = 2·0.3·√π; its half-power band holds erf(√ln 2) = 76 % of it.
    power = 0.76 * 2.0 * 0.3 * np.sqrt(np.pi)
    displacement = 1000.0 * np.sqrt(power) / (4.0 * np.pi) ** 2
    assert values["peaks"][0]["displacement_mm"] == pytest.approx(displacement, rel=0.1)
    assert averaged([]) is None


def test_a_version_s_spectra_say_over_how_many_passes_they_run() -> None:
    spatial = good().document["variants"]["b"]["spectra"]["spatial"]["tractor"]
    assert spatial["passes"] == 6
    assert spatial["segments"] >= 6
    assert spatial["peaks"][0]["displacement_mm"] > 5.0
