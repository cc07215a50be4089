"""What a person asks of an identification: names in short, bounds, priors, and errors that say how to mend them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from smts_validate.model.machine import Machine
from smts_validate.pipeline.identify_fit import prior_centre, prior_information
from smts_validate.pipeline.identify_names import SYMBOLS, full_name, known_names, listed
from smts_validate.pipeline.identify_parameter import (
    IdentifyError,
    Parameter,
    WrongUseError,
    parameter_of,
)
from smts_validate.pipeline.identify_wishes import Wish, asked, parse_free, read_priors, wishes
from synthetic_motion import alone, machine_of, manifest_of

FRONT = "tyres.front.cornering_stiffness"
TRUE = machine_of(manifest_of())
ALONE = machine_of(alone(manifest_of()))
TANDEM = TRUE.replace_parameters({"seeder.com_to_axle": (0.0, 1.1), "seeder.track": (3.6, 3.6)})


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("cornering_stiffness.front", FRONT),
        ("front.cornering_stiffness", FRONT),
        ("machine.tyres.front.cornering_stiffness", FRONT),
        ("hitch_to_com", "seeder.hitch_to_com"),
        ("l5", "seeder.hitch_to_com"),
        ("yaw_inertia.tractor", "tractor.yaw_inertia"),
        ("Pw", "tyre_pressure_mpa"),
    ],
)
def test_a_parameter_is_known_by_its_short_forms_and_the_papers_symbol(given: str, name: str) -> None:
    assert full_name(given, TRUE) == name


@pytest.mark.parametrize("machine", [TRUE, ALONE, TANDEM], ids=["seeder", "alone", "tandem"])
def test_every_listed_name_and_short_form_leads_to_a_number_that_can_be_changed(machine: Machine) -> None:
    rows = listed(machine)
    assert len({row["short"] for row in rows}) == len(rows)
    for row in rows:
        name = str(row["parameter"])
        assert full_name(str(row["short"]), machine) == name
        value = machine.parameter(name)
        assert machine.replace_parameters({name: value * 1.001}).parameter(name) == pytest.approx(
            value * 1.001
        )


def test_the_papers_symbols_name_parameters_that_exist() -> None:
    assert set(SYMBOLS.values()) <= set(known_names(TRUE))


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("cornering_stifness.front", f"did you mean `{FRONT}`"),
        ("hich_to_com", "did you mean `seeder.hitch_to_com`"),
        ("xyzzy", "`--free help` lists all names"),
        ("cornering_stiffness", f"may be {FRONT}, tyres.rear.cornering_stiffness"),
        ("", "unknown parameter"),
    ],
)
def test_an_unknown_or_doubtful_name_is_refused_with_what_was_meant(given: str, says: str) -> None:
    with pytest.raises(WrongUseError) as caught:
        full_name(given, TRUE)
    assert says in str(caught.value)


def test_a_seeders_parameter_of_a_tractor_alone_is_refused_as_such() -> None:
    with pytest.raises(WrongUseError, match="no seeder"):
        full_name("l5", ALONE)


def test_bounds_and_priors_come_from_options_and_a_file_and_the_option_goes_first(tmp_path: Path) -> None:
    file = tmp_path / "priors.toml"
    file.write_text(
        "[tyres.front.cornering_stiffness]\nmean = 5e4\nsd = 1e4\nlow = 2e4\nhigh = 9e4\n"
        "[l5]\nlow = 2.0\nhigh = 4.0\n['mass.seeder']\nsd = 100\n",
        encoding="utf-8",
    )
    found = wishes(
        asked(
            ["cornering_stiffness.front,l5=1:5", "seeder.mass"], ["mass.seeder=3000:3600"], ["l5=3:0.1"], file
        ),
        TRUE,
    )
    assert found == {
        FRONT: Wish((2e4, 9e4), 5e4, 1e4),
        "seeder.hitch_to_com": Wish((1.0, 5.0), 3.0, 0.1),
        "seeder.mass": Wish((3000.0, 3600.0), None, 100.0),
    }


def test_a_file_may_know_more_than_is_freed_but_nothing_that_does_not_exist(tmp_path: Path) -> None:
    file = tmp_path / "priors.toml"
    file.write_text("[l5]\nsd = 0.1\n[l4]\nsd = 0.1\n", encoding="utf-8")
    assert set(wishes(asked(["l5"], file=file), TRUE)) == {"seeder.hitch_to_com"}
    file.write_text("[hich_to_com]\nsd = 0.1\n", encoding="utf-8")
    with pytest.raises(WrongUseError, match=r"--priors hich_to_com: .*did you mean"):
        wishes(asked(["l5"], file=file), TRUE)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"free": ["l5", "seeder.hitch_to_com"]}, "named twice"),
        ({"free": ["l5=1:2"], "bounds": ["l5=1:3"]}, "has bounds in --free too"),
        ({"free": ["l5"], "bounds": ["l4=1:3"]}, "is not free; add it to --free"),
        ({"free": ["l5"], "priors": ["l4=1:3"]}, "is not free; add it to --free"),
        ({"free": ["l5"], "priors": ["l5"]}, "NAME=MEAN:SD"),
        ({"free": ["l5"], "priors": ["l5=3"]}, "NAME=MEAN:SD"),
        ({"free": ["l5"], "priors": ["l5=3:nan"]}, "finite"),
        ({"free": ["l5"], "bounds": ["l5=1:2", "l5=1:2"]}, "given twice"),
        ({"free": ["l5=inf:2"]}, "finite"),
    ],
)
def test_wishes_that_contradict_themselves_are_refused(options: dict[str, list[str]], says: str) -> None:
    with pytest.raises(WrongUseError, match=says):
        wishes(asked(**options), TRUE)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("l5 = 3", "l5: must be a table"),
        ("[l5]\nmena = 3", "l5.mena: unknown key"),
        ("[l5]\nmean = 3", "a mean needs its sd"),
        ("[l5]\nlow = 3", "low and high go together"),
        ("[l5]\nsd = 'a'", "l5.sd: must be a finite number"),
        ("[l5", "not valid TOML"),
    ],
)
def test_a_broken_file_of_priors_is_named_with_its_key(tmp_path: Path, text: str, says: str) -> None:
    file = tmp_path / "priors.toml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(IdentifyError) as caught:
        read_priors(file)
    assert str(caught.value).startswith(f"{file}: ")
    assert says in str(caught.value)


def test_free_parameters_are_read_from_the_command_line() -> None:
    assert parse_free(["a.b, c=1:2", "d=-1e3:4"]) == {"a.b": None, "c": (1.0, 2.0), "d": (-1000.0, 4.0)}
    for text, word in (("a,a", "twice"), ("a=1", "LOW:HIGH"), ("a=x:y", "LOW:HIGH")):
        with pytest.raises(WrongUseError, match=word):
            parse_free([text])


@pytest.mark.parametrize(
    ("mean", "sd", "says"),
    [(None, 0.0, "must be above 0"), (None, -1.0, "must be above 0"), (9e9, 1e4, "outside the bounds")],
)
def test_a_prior_that_cannot_be_is_refused(mean: float | None, sd: float, says: str) -> None:
    with pytest.raises(WrongUseError, match=says):
        parameter_of(FRONT, [TRUE], None, sd, mean)


SCALES = [
    Parameter(FRONT, 6e4, 6e4, 6e3, 6e5, 3e3, 5e4),
    Parameter("seeder.hitch_to_com", 3.0, 3.0, 0.3, 30.0, 0.2, 3.3),
    Parameter("seeder.draft_angle_deg", 0.0, 10.0, -5.0, 5.0, 0.5, 1.0),
]


@pytest.mark.parametrize("p", SCALES, ids=lambda p: p.name)
def test_the_scale_of_a_parameter_is_undone_grows_and_spreads_by_its_derivative(p: Parameter) -> None:
    values = np.linspace(p.low, p.high, 7)
    z = [p.change(float(value)) for value in values]
    assert [p.value(one) for one in z] == pytest.approx(list(values))
    assert (np.diff(z) > 0.0).all()
    step = 1e-6
    slope = (p.value(z[3] + step) - p.value(z[3] - step)) / (2.0 * step)
    assert p.spread(z[3], 1.0) == pytest.approx(slope, rel=1e-6)
    assert p.change(p.stated) == pytest.approx(0.0)


@pytest.mark.parametrize("p", SCALES, ids=lambda p: p.name)
def test_a_prior_alone_gives_back_its_mean_and_standard_deviation(p: Parameter) -> None:
    z = float(prior_centre([p])[0])
    assert p.value(z) == pytest.approx(p.prior_mean)
    assert p.spread(z, 1.0 / math.sqrt(float(prior_information([p])[0, 0]))) == pytest.approx(p.prior_sd)
    assert prior_information([replace(p, prior_sd=None)])[0, 0] == 0.0


def test_an_interval_that_its_bound_cuts_off_is_open_there() -> None:
    p = SCALES[0]
    assert p.end(p.change(7e4)) == pytest.approx(7e4)
    assert p.end(1.2) is None  # of an inverse: no stiffness is as large
    assert p.end(-50.0) is None
