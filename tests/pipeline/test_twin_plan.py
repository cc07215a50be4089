"""Plans of synthetic passes and campaigns: presets, TOML, errors that name the nearest key."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from smts_validate.pipeline.twin import make_pass, manifest_text
from smts_validate.pipeline.twin_campaign import campaign_from, read_campaign, synth
from smts_validate.pipeline.twin_plan import PRESETS, changed, plan_from, preset, read_plan, with_value
from smts_validate.pipeline.twin_tables import PlanError, as_table
from smts_validate.pipeline.twin_writing import toml_text
from smts_validate.sensors import manifest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_a_presets_manifest_is_what_the_format_asks_for(name: str) -> None:
    read = manifest.parse(manifest_text(preset(name)))
    assert read.machine.tractor.mass == preset(name).machine["tractor"]["mass"]
    assert list(read.sensors) == list(preset(name).sensors)


def test_a_plan_changes_only_what_it_names() -> None:
    plan = plan_from({"preset": "outage", "path": {"speed": 2}, "gnss": {"floats": []}})
    assert plan.path.speed == 2.0
    assert isinstance(plan.path.speed, float)
    assert plan.gnss.floats == ()
    assert plan.gnss.outages == preset("outage").gnss.outages
    assert plan.path.duration == preset("outage").path.duration


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"soil": {"roughnes": 1e-3}}, "soil.roughnes: unknown key; did you mean `roughness`?"),
        ({"path": {"speed": "fast"}}, "path.speed: 'fast' is not of type float"),
        ({"path": {"rows": 1.5}}, "path.rows: 1.5 is not of type int"),
        ({"gnss": {"kind": "perfect"}}, "gnss.kind: 'perfect' is not one of"),
        ({"gnss": {"outages": [[1.0]]}}, "gnss.outages"),
        ({"gnss": 3}, "gnss: must be a table"),
        ({"preset": "bening"}, "no preset 'bening'; did you mean `benign`?"),
        ({"errors": {"lever_arm": float("nan")}}, "errors.lever_arm"),
    ],
)
def test_an_error_of_a_plan_says_where_and_how_to_mend_it(table: dict[str, object], says: str) -> None:
    with pytest.raises(PlanError) as caught:
        plan_from(table, "plan.toml")
    assert says in str(caught.value)
    assert str(caught.value).startswith("plan.toml: ")
    assert "\n" not in str(caught.value)


def test_a_manifest_that_would_be_refused_is_refused_before_anything_is_made() -> None:
    plan = changed(preset("benign"), {"sensors": {"imd1": {"positon": [0.0, 0.0, 0.0]}}})
    with pytest.raises(PlanError, match="did you mean `position`"):
        make_pass(plan, 0)


def test_truth_that_names_no_number_of_the_machine_is_refused() -> None:
    with pytest.raises(PlanError, match=r"truth\.tyres\.front\.stiffness"):
        make_pass(changed(preset("benign"), {"truth": {"tyres.front.stiffness": 0.5}}), 0)


def test_a_machine_that_cannot_stand_is_refused() -> None:
    plan = with_value(preset("benign"), "machine.seeder.com_to_axle", -2.9)
    with pytest.raises(PlanError, match="without load"):
        make_pass(plan, 0)


def test_toml_comes_back_as_it_was_written() -> None:
    table = {
        "schema": 1, "run": {"id": 'a "b"', "ok": True}, "machine": {"a": {"list": [1.5, 2.0]}},
        "conditions": {"crop": "maïs", "soil": {"0-5cm": 21.4}},
    }  # fmt: skip
    assert tomllib.loads(toml_text(table)) == table


def test_a_plan_is_recorded_with_every_key_that_has_a_value() -> None:
    table = as_table(preset("outage"))
    assert table["gnss"]["outages"] == ((25.0, 8.0),)
    assert "latency" not in table["gnss"]


def test_a_campaign_is_the_product_of_its_axes_with_distinct_ids_seeds_and_times() -> None:
    campaign = campaign_from(
        {
            "seed": 7, "repeats": 3, "fields": ["north", "south"], "directions": ["east", "west"],
            "variants": {"a": {"path": {"speed": 2.5}}, "b": {}},
        }
    )  # fmt: skip
    passes = list(campaign.passes())
    assert len(passes) == 2 * 2 * 2 * 3
    assert len({plan.run.id for plan, _ in passes}) == len({seed for _, seed in passes}) == len(passes)
    assert len({plan.run.start for plan, _ in passes}) == len(passes)
    assert {plan.path.speed for plan, _ in passes if plan.run.variant == "a"} == {2.5}
    headings = {plan.run.direction: plan.place.heading_deg for plan, _ in passes}
    assert headings["west"] - headings["east"] == 180.0


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"repeat": 3}, "repeat: unknown key"),
        ({"fields": 3}, "fields: must be"),
        ({"repeats": 0}, "repeats must be"),
    ],
)
def test_an_error_of_a_campaign_says_where(table: dict[str, object], says: str) -> None:
    with pytest.raises(PlanError, match=says):
        campaign_from(table)


def test_a_campaign_is_written_in_one_command_with_truth_beside_it(tmp_path: Path) -> None:
    base = 'preset = "benign"\n[path]\nduration = 8.0\n[sensors]\nwds1 = false\n'
    (tmp_path / "base.toml").write_text(base)
    (tmp_path / "plan.toml").write_text('plan = "base.toml"\ndirections = ["east", "west"]\n')
    folders = synth(tmp_path / "out", campaign=tmp_path / "plan.toml")
    assert [folder.name for folder in folders] == ["field1-b-east-1", "field1-b-west-1"]
    for folder in folders:
        assert manifest.read(folder / "run.toml")[0].run.id == folder.name
        assert (tmp_path / "out/truth" / folder.name / "truth.csv").is_file()
        assert not (folder / "wds1.csv").exists()


def test_a_missing_or_broken_file_is_named_once(tmp_path: Path) -> None:
    (tmp_path / "broken.toml").write_text("speed = = 3")
    for read in (read_plan, read_campaign):
        for name in ("absent.toml", "broken.toml"):
            with pytest.raises(PlanError) as caught:
                read(tmp_path / name)
            assert str(caught.value).count(name) == 1


def test_one_source_of_a_pass_is_enough(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match="give one of"):
        synth(tmp_path, named="benign", plan=tmp_path / "plan.toml")


def test_the_sample_is_what_its_plan_and_seed_make(tmp_path: Path) -> None:
    synth(tmp_path, plan=ROOT / "data_samples/field1.plan.toml", seed=20250514)
    for name in ("run.toml", "gps.nmea", "imd1.csv", "wds4.csv", "steer.csv"):
        made, kept = ((folder / "field1" / name).read_text() for folder in (tmp_path, ROOT / "data_samples"))
        assert made == kept, name


def test_the_how_tos_examples_are_plans_that_work() -> None:
    text = (ROOT / "docs/howto-synth.md").read_text()
    plan, campaign = (tomllib.loads(block) for block in re.findall(r"```toml\n(.*?)```", text, re.S))
    assert manifest.parse(manifest_text(plan_from(plan))).run.id == "sandy-1"
    assert len(list(campaign_from(campaign).passes())) == 2 * 2 * 2 * 3
    for name in PRESETS:
        assert f"| `{name}` |" in text
