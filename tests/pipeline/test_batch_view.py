"""What a person, a terminal and a machine are told while a batch runs."""

from __future__ import annotations

import io
from dataclasses import replace

import pytest
from rich.console import Console
from smts_validate.pipeline import batch_view, console
from smts_validate.pipeline.batch_loop import Progress
from smts_validate.pipeline.batch_task import Outcome

DONE = Outcome("p1", "raw/p1", "done", verdict="adequate", discrepancy={"trajectory": 4.2}, seconds=3.14)
FAILED = Outcome("p2", "raw/p2", "failed", reason="raw/p2: gps.nmea is not there")
HALFWAY = Progress(total=4, done=1, unchanged=1, failed=0, running=("p3", "p4"), elapsed=60.0, last=DONE)


def test_a_line_a_pass_says_what_became_of_it_and_how_long_the_rest_takes() -> None:
    assert batch_view.line(HALFWAY) == "[2/4] p1: adequate, 3.1 s, 2 min 00 s left"
    failed = replace(HALFWAY, failed=1, last=FAILED)
    assert batch_view.line(failed) == "[3/4] p2: failed: raw/p2: gps.nmea is not there"
    assert batch_view.line(replace(HALFWAY, last=None)) == ""
    assert batch_view.line(replace(HALFWAY, note="p3: its worker was lost")) == "p3: its worker was lost"


def test_an_event_has_the_outcome_and_the_counts_and_none_where_nothing_happened() -> None:
    event = batch_view.event(HALFWAY)
    assert event is not None
    assert (event["event"], event["run"], event["verdict"]) == ("done", "p1", "adequate")
    assert (event["total"], event["done"], event["unchanged"], event["failed"]) == (4, 1, 1, 0)
    assert batch_view.event(replace(HALFWAY, last=None)) is None


def test_the_live_table_shows_done_running_failed_and_the_time_left() -> None:
    written = io.StringIO()
    Console(width=100, file=written).print(batch_view.live_table(HALFWAY))
    text = written.getvalue()
    for word in ("2 of 4 passes", "p3, p4", "1 min 00 s", "2 min 00 s"):
        assert word in text


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(None, "-"), (0.4, "0 s"), (59.6, "1 min 00 s"), (200.0, "3 min 20 s"), (3900.0, "1 h 05 min")],
)
def test_durations_are_in_words(seconds: float | None, words: str) -> None:
    assert batch_view.duration(seconds) == words


def test_a_table_sets_numbers_to_the_right_and_marks_what_is_absent() -> None:
    text = console.table(["sensor", "rate"], [["imd1", 100.0], ["gps", None], ["wds", 9.75]])
    assert text.splitlines() == ["sensor  rate", "imd1     100", "gps        -", "wds     9.75"]


def test_sensors_with_other_figures_get_a_table_of_their_own() -> None:
    text = console.health_table({"imd1": {"rate": 100.0}, "imd2": {"rate": 99.0}, "gps": {"fixed": 12}})
    assert text.split("\n\n") == ["sensor  rate\nimd1     100\nimd2      99", "sensor  fixed\ngps        12"]


def test_a_verdict_is_printed_with_its_reasons_and_absent_numbers_as_words() -> None:
    document = {
        "run": "p1",
        "verdict": {"value": "inconclusive", "scope": "pass", "reasons": ["no row"]},
        "discrepancy": {"yaw": {"body1": None, "body2": 3.0, "combined": None, "interval": None}},
        "warnings": [],
        "report": "out/report.html",
    }
    assert console.ran(document).splitlines() == [
        "verdict (pass p1): inconclusive",
        "  because no row",
        "discrepancy of yaw: none (tractor none, seeder 3.0 %)",
        "warnings: 0",
        "report: out/report.html",
    ]
