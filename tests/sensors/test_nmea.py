"""NMEA: the arrays against sentences built by hand and against pynmeagps, fault by fault."""

from __future__ import annotations

import datetime as dt
import math
from pathlib import Path

import numpy as np
import pynmeagps
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smts_validate.sensors.decimals import decimals
from smts_validate.sensors.formats import nmea
from smts_validate.sensors.raw import RawError, RawGnss

DATE = dt.date(2025, 5, 14)
DAY = dt.datetime(2025, 5, 14, tzinfo=dt.UTC).timestamp()
LOGS = Path(__file__).resolve().parents[3] / "shared" / "real" / "nmea" / "logs"
real_logs = sorted(LOGS.glob("*.log"))


def sentence(body: str) -> str:
    """A body with its `$` and checksum."""
    total = 0
    for letter in body:
        total ^= ord(letter)
    return f"${body}*{total:02X}"


def gga(clock: str, north: str = "5002.50000000,N,03629.00000000,E", quality: int = 4, rest: str = "") -> str:
    return sentence(f"GNGGA,{clock},{north},{quality},16,0.86,{rest or '135.5,M,16.0,M'},1.2,0001")


def parsed(*lines: str, date: dt.date = DATE) -> RawGnss:
    return nmea.parse(("\r\n".join(lines) + "\r\n").encode(), "gps.nmea", "gps", date)


def test_an_epoch_that_lost_its_gga_takes_the_altitude_of_those_beside_it() -> None:
    rmc = sentence("GNRMC,100100.20,A,5002.5,N,03629.0,E,5.000,90.0,140525,,,R")
    before = sentence("GNRMC,100100.00,A,5002.5,N,03629.0,E,5.000,90.0,140525,,,R")
    gnss = parsed(before, gga("100100.10"), rmc, gga("100100.30", rest="137.5,M,16.0,M"))
    assert gnss.values["alt"].tolist() == pytest.approx([151.5, 151.5, 152.5, 153.5])


def test_an_epoch_gathers_all_its_sentences() -> None:
    gnss = parsed(
        gga("100100.10"),
        sentence("GNRMC,100100.10,A,5002.5,N,03629.0,E,5.000,90.0,140525,,,R"),
        sentence("GNVTG,45.0,T,,M,5.4,N,10.0,K,R"),
        sentence("GNGST,100100.10,0.017,0.013,0.013,0.0,0.011,0.012,0.026"),
        sentence("GNHDT,30.0,T"),
        gga("100100.20"),
    )
    assert gnss.utc.tolist() == pytest.approx([DAY + 36060.1, DAY + 36060.2], abs=1e-6)
    first = {key: value[0] for key, value in gnss.values.items()}
    assert first["lat"] == pytest.approx(50.0 + 2.5 / 60.0, abs=1e-12)
    assert first["lon"] == pytest.approx(36.0 + 29.0 / 60.0, abs=1e-12)
    assert first["alt"] == pytest.approx(151.5)  # above the ellipsoid: sea level + geoid
    assert (first["quality"], first["satellites"], first["hdop"]) == (4.0, 16.0, 0.86)
    assert (first["sd_north"], first["sd_east"], first["sd_up"]) == (0.011, 0.012, 0.026)
    assert first["speed"] == pytest.approx(10.0 / 3.6)
    assert first["course"] == pytest.approx(math.radians(45.0))  # north-east is 45° both ways
    assert first["heading"] == pytest.approx(math.radians(60.0))
    assert np.isnan(gnss.values["heading"][1])
    assert gnss.rejected == ()


def test_south_and_west_are_negative() -> None:
    gnss = parsed(gga("100100.00", "3351.00000000,S,15112.00000000,W"))
    assert gnss.values["lat"][0] == pytest.approx(-33.85)
    assert gnss.values["lon"][0] == pytest.approx(-151.2)


def test_the_loggers_time_in_front_is_kept_to_the_nanosecond() -> None:
    gnss = parsed(f"1747303262444901074 {gga('100100.10')}", f"1747303262451901075 {gga('100100.20')}")
    assert gnss.host_ns is not None
    assert gnss.host_ns.tolist() == [1747303262444901074, 1747303262451901075]


def test_an_epoch_arrives_with_its_first_sentence() -> None:
    rmc = sentence("GNRMC,100100.10,A,5002.5,N,03629.0,E,5.0,90.0,140525,,,R")
    gnss = parsed(f"1000 {rmc}", f"1007 {gga('100100.10')}")
    assert gnss.host_ns is not None
    assert gnss.host_ns.tolist() == [1000]


def test_a_broken_digit_in_a_host_time_is_seen_in_the_burst() -> None:
    lines = []
    for k in range(20):
        stamp = 1_747_303_262_000_000_000 + k * 100_000_000
        bodies = (gga(f"100100.{k:02d}"), sentence("GNVTG,,T,,M,,N,10.0,K,R"), sentence("GNHDT,30.0,T"))
        lines += [f"{stamp + 5_000_000 * n} {body}" for n, body in enumerate(bodies)]
    right = nmea.parse("\n".join(lines).encode() + b"\n", "gps.nmea", "gps", DATE).host_ns
    lines[30] = lines[30].replace(
        "1747303263", "1747303262", 1
    )  # the first sentence of epoch 10, a second early
    found = nmea.parse("\n".join(lines).encode() + b"\n", "gps.nmea", "gps", DATE).host_ns
    assert found is not None
    assert right is not None
    assert np.abs(found - right).max() < 1_000_000


def test_a_speed_sent_before_its_position_belongs_to_it() -> None:
    gnss = parsed(
        f"1000000000 {gga('100100.00')}",
        f"1095000000 {sentence('GNVTG,,T,,M,,N,10.0,K,R')}",
        f"1100000000 {gga('100100.10')}",
    )
    assert np.isnan(gnss.values["speed"][0])
    assert gnss.values["speed"][1] == pytest.approx(10.0 / 3.6)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (gga("100100.10")[:-1] + "Z", "bad checksum"),
        (gga("100100.10").replace("5002", "5003"), "bad checksum"),
        (gga("100100.10")[:40], "cut off: no checksum"),
        (gga("100100.10")[:-1], "cut off: no checksum"),
        (gga("100100.10", "5002.5x,N,03629.0,E"), "a field that is no number"),
        (gga("100100.10", "5002.5,N,03629.0.1,E"), "a field that is no number"),
        (gga("100100.10", "9502.5,N,03629.0,E"), "a value out of range"),
        (gga("100100.10", "5060.0,N,03629.0,E"), "a value out of range"),
        (gga("250100.10"), "a value out of range"),
        (gga("106100.10"), "a value out of range"),
        (gga("100160.10"), "a value out of range"),
        (gga(""), "no time"),
        ("logger restarted", "no sentence"),
        ("\x00\xb5b\x01\x07", "no sentence"),
        ("$" + "A" * 400, "too long"),
    ],
)
def test_a_line_that_cannot_be_used_is_counted_and_kept_with_its_reason(line: str, reason: str) -> None:
    gnss = parsed(gga("100100.00"), line, gga("100100.20"))
    assert gnss.utc.size == 2
    assert gnss.rejected_count == 1
    assert gnss.rejected[0].row == 2
    assert gnss.rejected[0].reason == reason
    assert gnss.rejected[0].text == line.encode().decode("ascii", "replace")[:120]
    assert any(reason in warning.what and warning.row == 2 for warning in gnss.warnings)


def test_a_sentence_that_cuts_into_another_is_still_read() -> None:
    gnss = parsed(gga("100100.00")[:30] + gga("100100.10"))
    assert gnss.utc.tolist() == pytest.approx([DAY + 36060.1])
    assert gnss.rejected_count == 1


def test_a_line_without_host_time_among_others_with_it_is_refused() -> None:
    lines = [f"{1000 + k} {gga(f'100100.{k}0')}" for k in range(5)]
    gnss = parsed(*lines, gga("100101.00"))
    assert gnss.utc.size == 5
    assert gnss.rejected[0].reason.startswith("no host time")


def test_no_fix_is_an_epoch_without_position() -> None:
    gnss = parsed(sentence("GPGGA,100100.00,,,,,0,00,,,M,,M,,"), gga("100101.00"))
    assert gnss.values["quality"].tolist() == [0.0, 4.0]
    assert np.isnan(gnss.values["lat"][0])


def test_a_latitude_without_longitude_is_no_position() -> None:
    gnss = parsed(gga("100100.00"), gga("100101.00", "5002.5,N,,E"))
    assert np.isnan([gnss.values[key][1] for key in ("lat", "lon", "alt")]).all()
    assert gnss.values["lat"][0] > 50.0


def test_midnight_goes_on_to_the_next_day() -> None:
    gnss = parsed(gga("235959.90"), gga("000000.00"), gga("000000.10"))
    assert np.diff(gnss.utc).tolist() == pytest.approx([0.1, 0.1], abs=1e-6)
    assert gnss.utc[0] == pytest.approx(DAY + 86399.9)


def test_rmc_states_the_date_and_overrules_the_manifest_with_a_warning() -> None:
    gnss = parsed(sentence("GNRMC,100100.00,A,5002.5,N,03629.0,E,5.0,90.0,160525,,,R"))
    assert gnss.utc[0] == pytest.approx(DAY + 2 * 86400 + 36060)
    assert any("2025-05-16" in warning.what for warning in gnss.warnings)


def test_a_receiver_that_lost_count_of_weeks_is_corrected() -> None:
    wrong = DATE - dt.timedelta(weeks=1024)
    gnss = parsed(sentence(f"GNRMC,100100.00,A,5002.5,N,03629.0,E,5.0,90.0,{wrong:%d%m%y},,,R"))
    assert gnss.utc[0] == pytest.approx(DAY + 36060)
    assert any("1024 weeks" in warning.what for warning in gnss.warnings)


def test_a_leap_second_lets_time_run_on_evenly() -> None:
    night = dt.date(2016, 12, 31)
    clocks = ("235959.00", "235960.00", "000000.00", "000001.00")
    gnss = parsed(*(gga(clock) for clock in clocks), date=night)
    assert np.diff(gnss.utc).tolist() == [1.0, 1.0, 1.0]
    assert any("leap second" in warning.what and warning.row == 2 for warning in gnss.warnings)


def test_a_log_without_any_position_sentence_is_refused_in_one_line() -> None:
    with pytest.raises(RawError, match=r"gps\.nmea: no usable GGA") as caught:
        parsed("hello", "world")
    assert "\n" not in str(caught.value)


@given(st.decimals(-99999, 99999, places=6, allow_nan=False))
def test_decimals_are_read_as_python_reads_them(value: object) -> None:
    text = str(value).encode()
    data = np.frombuffer(text, dtype=np.uint8)
    found, sound = decimals(data, np.array([0]), np.array([len(text)]))
    assert sound[0]
    assert found[0] == float(text)


@given(st.binary(min_size=1, max_size=30))
def test_what_is_no_plain_decimal_is_unsound(text: bytes) -> None:
    data = np.frombuffer(text, dtype=np.uint8)
    found, sound = decimals(data, np.array([0]), np.array([len(text)]))
    if sound[0]:
        assert found[0] == float(text)


@given(st.lists(st.binary(max_size=60), max_size=20), st.integers(0, 20))
def test_rubbish_between_sentences_never_hides_them(rubbish: list[bytes], at: int) -> None:
    clean = [part.replace(b"$", b"").replace(b"\n", b"").replace(b"\r", b"") for part in rubbish]
    lines = [*clean[:at], gga("100100.00").encode(), *clean[at:]]
    gnss = nmea.parse(b"\n".join(lines) + b"\n", "gps.nmea", "gps", DATE)
    assert gnss.utc.size == 1
    assert gnss.rejected_count == sum(1 for part in clean if part)


@given(st.integers(0, 60), st.binary(min_size=1, max_size=1))
def test_a_changed_byte_never_gives_another_position(where: int, byte: bytes) -> None:
    first, second = gga("100100.00").encode(), gga("100100.10").encode()
    broken = second[:where] + byte + second[where + 1 :]
    gnss = nmea.parse(first + b"\n" + broken + b"\n", "gps.nmea", "gps", DATE)
    assert np.nanmax(np.abs(gnss.values["lat"] - (50.0 + 2.5 / 60.0))) < 1e-12


def _oracle(path: Path) -> list[pynmeagps.NMEAMessage]:
    """Every sentence that pynmeagps reads, line pieces cut at each `$`."""
    found = []
    for line in path.read_bytes().replace(b"\r", b"\n").split(b"\n"):
        for piece in line.split(b"$")[1:]:
            try:
                found.append(pynmeagps.NMEAReader.parse(b"$" + piece + b"\r\n", validate=1))
            except (
                pynmeagps.NMEAParseError,
                pynmeagps.NMEAMessageError,
                pynmeagps.NMEATypeError,
                ValueError,
            ):
                continue
    return found


@pytest.mark.skipif(not real_logs, reason="recordings of others are not beside this checkout")
@pytest.mark.parametrize("path", real_logs, ids=lambda path: path.stem)
def test_real_logs_read_as_pynmeagps_reads_them(path: Path) -> None:
    fixes = [
        m
        for m in _oracle(path)
        if m is not None and m.msgID == "GGA" and m.quality and m.time and m.lat != ""
    ]
    try:
        gnss = nmea.parse(path.read_bytes(), path.name, "gps", DATE)
    except RawError:
        assert not fixes
        return
    ours = gnss.values["quality"] > 0
    theirs = {}
    for m in fixes:
        theirs[(m.time.hour * 3600 + m.time.minute * 60 + m.time.second + m.time.microsecond / 1e6)] = m
    clock = np.round(gnss.utc % 86400.0, 3)
    for seconds, m in theirs.items():
        near = np.flatnonzero(ours & (np.abs(clock - seconds) < 2e-3))
        assert near.size, f"{path.name}: {m} is missing"
        assert gnss.values["lat"][near] == pytest.approx(m.lat, abs=2e-8)
        assert gnss.values["lon"][near] == pytest.approx(m.lon, abs=2e-8)


@pytest.mark.skipif(not real_logs, reason="recordings of others are not beside this checkout")
@pytest.mark.parametrize("path", real_logs, ids=lambda path: path.stem)
def test_every_line_of_a_real_log_is_read_or_refused_with_a_reason(path: Path) -> None:
    try:
        gnss = nmea.parse(path.read_bytes(), path.name, "gps", DATE)
    except RawError:
        return
    assert sum(gnss.reasons.values()) == gnss.rejected_count == len(gnss.rejected)
    lines = path.read_bytes().split(b"\n")
    empty = sum(1 for line in lines if not line.strip(b"\r"))
    assert gnss.sentences + gnss.rejected_count >= len(lines) - empty
