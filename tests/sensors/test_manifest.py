"""run.toml: what is accepted, and what each mistake is told as."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raw_samples import MANIFEST
from smts_validate.sensors import manifest
from smts_validate.sensors.draft_text import SEEDER
from smts_validate.sensors.manifest import ManifestError

TRAILED = (
    SEEDER
    + """[sensors.imd2]
kind = "imd"
body = "seeder"
file = "imd2.csv"
position = [0.0, 0.0, 0.0]
rate = 100.0
[sensors.wds1]
kind = "wds"
wheel = "front_right"
file = "wds1.csv"
rate = 100.0
[conditions]
anything = { goes = ["here", 1] }
"""
)
WHOLE = MANIFEST.format(id="field1-b-east-1", imd1="", rest=TRAILED)


def complaint(old: str, new: str, text: str = WHOLE) -> str:
    """What the manifest says about one change."""
    assert old in text
    with pytest.raises(ManifestError) as caught:
        manifest.parse(text.replace(old, new, 1))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def line_of(part: str, text: str = WHOLE) -> int:
    return text[: text.index(part)].count("\n") + 1


def test_a_whole_manifest_is_read_with_its_names_as_keys() -> None:
    run = manifest.parse(WHOLE)
    assert run.machine.tractor.front_axle == 1.45
    assert run.machine.seeder is not None
    assert run.machine.seeder.axles == (0.35,)
    assert run.machine.tractor.driven == "all"
    assert list(run.sensors) == ["imd1", "gps", "imd2", "wds1"]
    assert run.conditions["anything"] == {"goes": ["here", 1]}
    assert set(run.of_kind("imd")) == {"imd1", "imd2"}


def test_a_tractor_alone_needs_no_seeder() -> None:
    run = manifest.parse(MANIFEST.format(id="t", imd1="", rest=""))
    assert run.machine.seeder is None


def test_tandem_axles_need_a_track_each_or_one_for_all() -> None:
    tandem = WHOLE.replace("com_to_axle = 0.35", "com_to_axle = [0.1, 0.9]")
    seeder = manifest.parse(tandem).machine.seeder
    assert seeder is not None
    assert seeder.tracks == (3.6, 3.6)
    for tracks, count in (("[1.0, 2.0, 3.0]", 3), ("[3.6]", 1)):
        told = complaint("track = 3.60\ncog", f"track = {tracks}\ncog", tandem)
        assert f"same number of axles, at least one (they list 2 and {count})" in told


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("yaw_inertia = 9500", "yaw_inertai = 9500", "unknown key; did you mean `yaw_inertia`?"),
        ("mass = 5200", "mas = 5200", "unknown key; did you mean `mass`?"),
        ("position = [0.3", "postion = [0.3", "unknown key; did you mean `position`?"),
        ("[operating]", "[operatng]", "unknown key; did you mean `operating`?"),
        ("speed = 2.5", "speed = 2.5\ndraft = 1.0", "did you mean `draft` of [machine.seeder]?"),
        ("mass = 5200.0", "mass = -1.0", "greater than 0 (it is -1.0)"),
        ("mass = 5200.0", "mass = nan", "(it is nan)"),
        ("mass = 5200.0", "mass = inf", "(it is inf)"),
        ("mass = 5200.0", 'mass = "5200"', "must be a number (it is '5200')"),
        ("mass = 5200.0", "mass = true", "must be a number (it is True)"),
        ("mass = 5200.0\n", "", "machine.tractor.mass: this key is missing"),
        ('wheel = "front_right"', 'wheel = "fr"', "sensors.wds1.wheel:"),
        ('kind = "gps"', 'kind = "gsp"', 'needs kind = "imd", "wds", "steer", "speed" or "gps"'),
        ('file = "imd2.csv"', 'file = "imd1.csv"', "sensors.imd1 and sensors.imd2 both read 'imd1.csv'"),
        ('kind = "gps"\n', 'kind = "gps"\nbody = "seeder"\n', "needs a receiver on the tractor"),
        ('file = "imd2.csv"', "", "needs either `file` or `topic`"),
        ('body = "seeder"', 'body = "tractor"', 'at least one IMD with body = "seeder"'),
        ('id = "field1-b-east-1"', 'id = "../etc"', "run.id"),
        ('id = "field1-b-east-1"', 'id = "a..b"', "run.id: must not contain '..'"),
        ('id = "field1-b-east-1"', 'id = "-x"', "run.id"),
        ('id = "field1-b-east-1"', 'id = "a/b"', "run.id"),
        ('id = "field1-b-east-1"', 'id = "a\\nb"', "run.id"),
        ("date = 2025-05-14", 'date = "May"', "run.date"),
        ("rate = 100.0\n\n", 'rate = 100.0\ncolumns = { axx = "x" }\n', "did you mean `ax`?"),
        ("rate = 100.0\n\n", 'rate = 100.0\nunits = { accl = "g" }\n', "did you mean `accel`?"),
        ("rate = 100.0\n\n", 'rate = 100.0\nunits = { accel = "mg" }\n', "sensors.imd1.units.accel"),
        ("schema = 1", "schema = 2", "schema"),
        ("schema = 1", "schema = ", "not valid TOML"),
        ("[run]", "[line]\na = [50.0, 36.0]\nb = [50.0, 36.0]\n[run]", "two different points"),
        ("[run]", "[line]\na = [95.0, 36.0]\nb = [50.0, 36.0]\n[run]", "must be latitude"),
        ("[sensors.imd2]", '[sensors."im d2"]', "letters, digits"),
    ],
)
def test_a_mistake_is_told_in_one_line_with_its_place(old: str, new: str, told: str) -> None:
    assert told in complaint(old, new)


def test_a_misspelt_key_is_named_rather_than_the_one_it_makes_missing() -> None:
    told = complaint("front_track", "fron_track")
    where = f"run.toml, line {line_of('front_track')}: machine.tractor.fron_track"
    assert told == f"{where}: unknown key; did you mean `front_track`?"


@pytest.mark.parametrize("old", ["mass = 5200.0", "mass = 3300.0", "cornering_stiffness = 9.0e4"])
def test_the_line_is_that_of_the_right_table(old: str) -> None:
    key = old.split()[0]
    assert f"line {line_of(old)}:" in complaint(old, f"{key} = -1.0")


def test_a_missing_key_is_told_with_the_line_of_its_table() -> None:
    where = f"run.toml, line {line_of('[operating]')}: operating.speed: this key is missing"
    assert complaint("speed = 2.5\n", "") == where
    assert complaint("[operating]\nspeed = 2.5\ntyre_pressure_mpa = 0.12\n", "").startswith(
        "run.toml: operating:"
    )


def test_what_may_be_left_out_takes_the_format_pages_defaults() -> None:
    run = manifest.parse(WHOLE.replace("date = 2025-05-14\n", ""))
    assert (run.run.field, run.run.direction, run.run.variant, run.run.repeat) == ("", "", "", 1)
    assert run.run.date == manifest.UNDATED
    assert run.line is None
    assert run.machine.seeder is not None
    assert run.machine.seeder.draft_angle_deg == 0.0
    tyre = run.machine.tyres.front
    assert (tyre.reference_pressure_mpa, tyre.pressure_exponent, tyre.relaxation_length) == (0.1, 0.5, 0.0)
    assert run.sensors["wds1"].offset == run.sensors["wds1"].rotation_deg == (0.0, 0.0, 0.0)  # type: ignore[union-attr]
    assert run.sensors["gps"].body == "tractor"  # type: ignore[union-attr]


def test_further_mistakes_are_counted() -> None:
    text = WHOLE.replace("mass = 5200.0", "mass = -1.0")
    assert complaint("mass = 3300.0", "mass = -2.0", text).endswith("(1 more)")


def test_a_gps_named_gps_keeps_its_name_in_the_complaint() -> None:
    assert "sensors.gps.position: this key is missing" in complaint("position = [0.4, 0.0, 2.1]\n", "")


@pytest.mark.parametrize("text", ["x = " + "[" * 100_000, "a." * 50_000 + "b = 1", '"\\u0000" = 1', "\x00"])
def test_hostile_text_is_refused_in_one_line(text: str) -> None:
    with pytest.raises(ManifestError) as caught:
        manifest.parse(text)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=200))
def test_any_text_is_a_manifest_or_a_one_line_refusal(text: str) -> None:
    with pytest.raises(ManifestError) as caught:
        manifest.parse(text)
    assert str(caught.value).isprintable()


@settings(max_examples=100, deadline=None)
@given(st.integers(0, len(WHOLE)), st.text(max_size=6))
def test_a_manifest_with_an_insertion_is_read_or_refused_in_one_line(at: int, more: str) -> None:
    try:
        manifest.parse(WHOLE[:at] + more + WHOLE[at:])
    except ManifestError as error:
        told = str(error)
        if not told.isprintable():
            pytest.fail(repr(told))


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_bytes(b"\xef\xbb\xbf" + WHOLE.encode())
    run, text = manifest.read(tmp_path / "run.toml")
    assert run.run.id == "field1-b-east-1"
    assert text == WHOLE


@pytest.mark.parametrize("kind", ["missing", "folder", "binary", "huge"])
def test_a_file_that_is_no_manifest_is_refused_with_its_name(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "run.toml"
    if kind == "folder":
        path.mkdir()
    elif kind == "binary":
        path.write_bytes(b"\xff\xfe\x00\x01")
    elif kind == "huge":
        with path.open("wb") as file:
            file.truncate(10 * 2**30)
    with pytest.raises(ManifestError, match=r"run\.toml"):
        manifest.read(path)


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(["..", "a/../..", "/x", "\\\\host\\x", "c:/x", "a\x00b", "..\\x", "x/\x1b[2J"]))
def test_no_file_leads_out_of_the_folder(name: str) -> None:
    escaped = name.replace("\\", "\\\\").replace("\x00", "\\u0000").replace("\x1b", "\\u001b")
    with pytest.raises(ManifestError):
        manifest.parse(WHOLE.replace('"imd1.csv"', f'"{escaped}"'))
