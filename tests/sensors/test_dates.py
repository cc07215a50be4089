"""A run.toml without date: the recordings tell the day, or the pass is refused in a line."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest
from raw_samples import START, Plan, checked, gps_lines, write_pass
from smts_validate.sensors.formats import nmea
from smts_validate.sensors.ingest import IngestError, read_pass
from smts_validate.sensors.log import read_log, write_log
from smts_validate.sensors.manifest import UNDATED

DAY = dt.date(2025, 5, 14)
PLACE = "A,5002.4,N,03629.4,E,5.000,90.0"


def undated(folder: Path, first: str | None = None, plan: Plan | None = None) -> Path:
    """A pass whose run.toml has no date; `first` is put in front of its sentences, with its host time."""
    plan = plan or Plan(seconds=30.0)
    write_pass(folder, plan)
    manifest = folder / "run.toml"
    manifest.write_text(manifest.read_text().replace("date = 2025-05-14\n", ""))
    if first is not None:
        stamp = round((START + plan.offset + plan.gnss_latency) * 1e9)
        lines = [f"{stamp} {checked(first)}", *gps_lines(plan)]
        (folder / "gps.nmea").write_text("\r\n".join(lines) + "\r\n")
    return folder


@pytest.mark.parametrize("first", [f"GNRMC,100000.00,{PLACE},140525,,,R", "GNZDA,100000.00,14,05,2025,00,00"])
def test_the_receiver_tells_the_day(tmp_path: Path, first: str) -> None:
    log = read_pass(undated(tmp_path / "pass", first))
    assert log.manifest.run.date == DAY
    assert log.streams["gps"].t[0] == pytest.approx(START, abs=1e-4)
    assert not any("date" in warning.what for warning in log.warnings)


def test_where_nobody_tells_the_day_the_pass_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        IngestError, match=r"^pass/run\.toml: run\.date is missing, .*gps\.nmea .*enter date"
    ) as caught:
        read_pass(undated(tmp_path / "pass"))
    assert "\n" not in str(caught.value)


def test_a_receiver_that_tells_no_day_takes_anothers(tmp_path: Path) -> None:
    second = '[sensors.roof]\nkind = "gps"\nfile = "roof.csv"\nposition = [0.4, 0.0, 2.1]\nrate = 10.0\n'
    rows = "".join(f"{START + k / 10.0:.1f},50.04,36.49,150.0\n" for k in range(300))
    plan = Plan(seconds=30.0, rest=second, extra={"roof.csv": "t,lat,lon,alt\n" + rows})
    log = read_pass(undated(tmp_path / "pass", plan=plan))
    assert log.manifest.run.date == DAY
    assert log.streams["gps"].t[0] == pytest.approx(START, abs=1e-4)


def test_a_log_needs_no_date_it_has_utc(tmp_path: Path) -> None:
    log = read_pass(undated(tmp_path / "pass", "GNZDA,100000.00,14,05,2025,00,00"))
    write_log(tmp_path / "a.mcap", log)
    back = read_log(tmp_path / "a.mcap")
    assert "date" not in back.manifest_text
    assert back.manifest.run.date == DAY


def test_zda_is_no_epoch_and_weaker_than_rmc() -> None:
    gga = "GNGGA,100000.10,5002.4,N,03629.4,E,4,16,0.8,134.0,M,16.0,M,1.0,0001"
    stale = "GNZDA,100000.00,01,01,2020,00,00"
    both = [stale, f"GNRMC,100000.10,{PLACE},140525,,,R", gga]
    gnss = nmea.parse("\n".join(checked(each) for each in both).encode() + b"\n", "a", "gps", UNDATED)
    assert np.allclose(gnss.utc, [START + 0.1])


def test_the_day_is_that_of_the_start_when_zda_comes_after_midnight() -> None:
    rest = "5002.4,N,03629.4,E,4,16,0.8,134.0,M,16.0,M,1.0,0001"
    lines = [f"GNGGA,235959.90,{rest}", f"GNGGA,000000.00,{rest}", "GNZDA,000000.00,15,05,2025,00,00"]
    gnss = nmea.parse("\n".join(checked(each) for each in lines).encode() + b"\n", "a", "gps", UNDATED)
    midnight = dt.datetime(2025, 5, 15, tzinfo=dt.UTC).timestamp()
    assert np.allclose(gnss.utc, [midnight - 0.1, midnight])
