"""Tables of text: dialects are under test with the formats; here are bounds on hostile ones."""

from __future__ import annotations

import datetime as dt
import time
from pathlib import Path

import pytest
from smts_validate.sensors import tables
from smts_validate.sensors.formats import imu_csv, nmea
from smts_validate.sensors.manifest import Imd
from smts_validate.sensors.raw import RawError

DATE = dt.date(2025, 5, 14)
UNIT = Imd(kind="imd", body="tractor", file="x.csv", position=(0.0, 0.0, 0.0), rate=100.0)
HEADER = b"t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    "body",
    [b"\n" * 20_000_000, b"1\n" * 500_000, b"x" * 50_000_000, b"," * 50_000_000, b'"' * 20_000_000 + b"\n"],
    ids=["blank lines", "short rows", "one endless cell", "one endless row", "quotes"],
)
def test_a_hostile_table_is_refused_in_bounded_time(tmp_path: Path, body: bytes) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(HEADER + body)
    start = time.process_time()
    with pytest.raises(RawError) as caught:
        imu_csv.read(path, UNIT, "x", DATE)
    assert "\n" not in str(caught.value)
    assert time.process_time() - start < 20.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "body", [b"\n" * 20_000_000, b"$" * 20_000_000, b"," * 120_000_000, b"\r" * 20_000_000, b"*" * 20_000_000]
)
def test_a_hostile_sentence_log_is_refused_in_bounded_time(body: bytes) -> None:
    start = time.process_time()
    with pytest.raises(RawError):
        nmea.parse(body, "gps.nmea", "gps", DATE)
    assert time.process_time() - start < 20.0


def test_integers_keep_every_digit_when_other_cells_are_broken() -> None:
    text = b"t,x\n1747303262444901074,1\n,2\noops,3\n+1747303262444901075,4\n1747303262444901076,5\n"
    header = tables.find_header(text, "x.csv")
    table = tables.parse_table(text, header, "x.csv", {"t": "int", "x": "int"})
    values, good = table.integers("t")
    assert good.tolist() == [True, False, False, True, True]
    assert values[good].tolist() == [1747303262444901074, 1747303262444901075, 1747303262444901076]
    assert table.rows.tolist() == [2, 3, 4, 5, 6]


def test_the_header_is_the_line_that_holds_the_wanted_names() -> None:
    text = b"Device,7\nRate,100 Hz\n\nseq;time;ax\n1;2;3\n"
    header = tables.find_header(text, "x.csv", ["time", "ax"])
    assert header == tables.Header(("seq", "time", "ax"), ";", 4)
