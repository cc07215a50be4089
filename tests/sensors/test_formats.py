"""Receivers and loggers of others: each format against values written by hand or by pyubx2."""

from __future__ import annotations

import datetime as dt
import math
from pathlib import Path

import numpy as np
import pytest
from pyubx2 import GET, UBXMessage
from smts_validate.sensors.formats import FORMATS, gcsv, gnss_csv, nmea, rtklib_pos, sensor_logger, ubx
from smts_validate.sensors.gnss_values import utc_of_gps_time
from smts_validate.sensors.manifest import Gps, Imd, Sensor, Speed, Steer, Units, Wds
from smts_validate.sensors.raw import RawError, RawGnss, RawImu

DATE = dt.date(2025, 5, 14)
START = dt.datetime(2025, 5, 14, 10, 1, 0, tzinfo=dt.UTC).timestamp()
GPS = Gps(kind="gps", file="gps", position=(0.0, 0.0, 2.0), rate=10.0)
IMD = Imd(kind="imd", body="tractor", file="imd", position=(0.0, 0.0, 0.0), rate=100.0)
WDS = Wds(kind="wds", wheel="front_left", file="wds", rate=100.0)
STEER = Steer(kind="steer", file="steer", rate=50.0)
SPEED = Speed(kind="speed", file="speed", rate=20.0)


def chosen(sensor: Sensor, path: Path) -> object:
    """The format that the shelf gives a file to."""
    head = path.read_bytes()[:4096]
    return next(form for form in FORMATS if form.reads(sensor, path, head))


# --- contract of the shelf ---


@pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.__name__.rsplit(".", 1)[-1])
@pytest.mark.parametrize(
    "content", [b"\n", b"abc", b"\x00" * 100, b"a,b\n1,2\n", b"%\n", b"\xb5b\x01\x07\x5c\x00"]
)
def test_a_format_reads_or_refuses_by_name(form: object, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "log.bin"
    path.write_bytes(content)
    for sensor in (GPS, IMD, WDS, STEER, SPEED):
        assert isinstance(form.reads(sensor, path, content), bool)  # type: ignore[attr-defined]
        with pytest.raises(RawError, match=r"log\.bin|Gyroscope\.csv|Gravity\.csv") as caught:
            form.read(path, sensor, "name", DATE)  # type: ignore[attr-defined]
        assert "\n" not in str(caught.value)


# --- u-blox binary, messages made by pyubx2 ---


def pvt(k: int, **changes: float) -> bytes:
    """A NAV-PVT message 0.1 s after the one before."""
    fields = {
        "iTOW": 295_278_000 + 100 * k,
        "year": 2025,
        "month": 5,
        "day": 14,
        "hour": 10,
        "min": 1,
        "second": k // 10,
        "validDate": 1,
        "validTime": 1,
        "fullyResolved": 1,
        "nano": k % 10 * 100_000_000 - 250,
        "fixType": 3,
        "gnssFixOk": 1,
        "diffSoln": 1,
        "carrSoln": 2,
        "numSV": 17,
        "lon": 36.4902 + 1e-6 * k,
        "lat": 50.0431 - 1e-6 * k,
        "height": 151_608,
        "hMSL": 135_608,
        "hAcc": 14,
        "vAcc": 25,
        "gSpeed": 2500,
        "headMot": 45.0,
    } | changes
    return bytes(UBXMessage("NAV", "NAV-PVT", GET, **fields).serialize())


def read_ubx(tmp_path: Path, content: bytes) -> RawGnss:
    path = tmp_path / "gps.ubx"
    path.write_bytes(content)
    assert chosen(GPS, path) is ubx
    return ubx.read(path, GPS, "gps", DATE)


def test_nav_pvt_is_read_as_pyubx2_wrote_it(tmp_path: Path) -> None:
    gnss = read_ubx(tmp_path, b"".join(pvt(k) for k in range(20)))
    assert gnss.utc == pytest.approx(START + np.arange(20) * 0.1, abs=1e-6)
    assert gnss.values["lat"] == pytest.approx(50.0431 - 1e-6 * np.arange(20), abs=1.01e-7)
    assert gnss.values["lon"] == pytest.approx(36.4902 + 1e-6 * np.arange(20), abs=1.01e-7)
    assert gnss.values["alt"] == pytest.approx(151.608)
    assert gnss.values["quality"].tolist() == [4.0] * 20
    assert gnss.values["sd_east"] == pytest.approx(0.014 / math.sqrt(2.0))
    assert gnss.values["speed"] == pytest.approx(2.5)
    assert gnss.values["course"] == pytest.approx(math.radians(45.0))
    assert gnss.values["satellites"].tolist() == [17.0] * 20


@pytest.mark.parametrize(
    ("changes", "quality"),
    [
        ({"carrSoln": 1}, 5.0),
        ({"carrSoln": 0}, 2.0),
        ({"carrSoln": 0, "diffSoln": 0}, 1.0),
        ({"gnssFixOk": 0}, 0.0),
        ({"fixType": 5}, 0.0),
    ],
)
def test_the_carrier_solution_becomes_the_quality(
    tmp_path: Path, changes: dict[str, float], quality: float
) -> None:
    gnss = read_ubx(tmp_path, pvt(0) + pvt(1, **changes))
    assert gnss.values["quality"][1] == quality
    assert np.isnan(gnss.values["lat"][1]) == (quality == 0.0)


def test_a_broken_frame_is_counted_and_rubbish_between_frames_passed_over(tmp_path: Path) -> None:
    broken = bytearray(pvt(2))
    broken[40] ^= 0x10
    gnss = read_ubx(
        tmp_path, pvt(0) + b"\xb5b\x01" + pvt(1) + bytes(broken) + b"$GNGGA,cut" + pvt(3) + pvt(4)[:50]
    )
    assert gnss.utc == pytest.approx(START + np.array([0.0, 0.1, 0.3]), abs=1e-6)
    assert gnss.rejected_count == 1
    assert any("1 NAV-PVT messages with a wrong checksum" in w.what for w in gnss.warnings)


def test_hpposllh_adds_the_digits_below_a_centimetre(tmp_path: Path) -> None:
    fine = UBXMessage(
        "NAV",
        "NAV-HPPOSLLH",
        GET,
        version=0,
        iTOW=295_278_100,
        lon=36.4902,
        lat=50.0431,
        height=151_608,
        hMSL=135_608,
        _HPlon=0.37e-7,
        _HPlat=-0.21e-7,
        _HPheight=0.4,
        hAcc=141,
        vAcc=250,
    ).serialize()
    gnss = read_ubx(tmp_path, pvt(0) + pvt(1) + bytes(fine))
    assert gnss.values["lon"][1] == pytest.approx(36.4902 + 0.37e-7, abs=1.1e-9)
    assert gnss.values["lat"][1] == pytest.approx(50.0431 - 0.21e-7, abs=1.1e-9)
    assert gnss.values["alt"][1] == pytest.approx(151.6084, abs=1e-9)


# --- RTKLIB ---

POS = """% program   : RTKLIB ver.2.4.3
% obs start : 2025/05/14 10:01:00.0 GPST (week2366 295260.0s)
% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,ns=# of satellites)
%  {scale}                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  \
sdne(m)  sdeu(m)  sdun(m) age(s)  ratio
"""
ROW = (
    "{time}   {lat:.9f}   {lon:.9f}   151.6080   {q}  12   0.0110   0.0120   0.0260" + 5 * "   0.0010" + "\n"
)


def pos_rows(times: list[str], q: int = 1) -> str:
    return "".join(
        ROW.format(time=time, lat=50.0431 + 1e-7 * k, lon=36.4902, q=q) for k, time in enumerate(times)
    )


def read_pos(tmp_path: Path, content: str) -> RawGnss:
    path = tmp_path / "gps.pos"
    path.write_text(content)
    assert chosen(GPS, path) is rtklib_pos
    return rtklib_pos.read(path, GPS, "gps", DATE)


def test_rtklib_solutions_in_utc_are_read(tmp_path: Path) -> None:
    times = [f"2025/05/14 10:01:{k // 10:02d}.{k % 10}00" for k in range(30)]
    gnss = read_pos(tmp_path, POS.format(scale="UTC ") + pos_rows(times))
    assert gnss.utc == pytest.approx(START + 0.1 * np.arange(30), abs=1e-6)
    assert gnss.values["lat"] == pytest.approx(50.0431 + 1e-7 * np.arange(30), abs=1e-9)
    assert gnss.values["alt"] == pytest.approx(151.608)
    assert gnss.values["quality"].tolist() == [4.0] * 30
    assert (gnss.values["sd_north"][0], gnss.values["sd_east"][0], gnss.values["sd_up"][0]) == (
        0.011,
        0.012,
        0.026,
    )


def test_rtklib_solutions_in_gps_time_are_eighteen_seconds_earlier(tmp_path: Path) -> None:
    gnss = read_pos(tmp_path, POS.format(scale="GPST") + pos_rows(["2025/05/14 10:01:18.000"]))
    assert gnss.utc.tolist() == pytest.approx([START])
    gnss = read_pos(tmp_path, POS.format(scale="GPST") + pos_rows(["2366 295278.000"], q=2))
    assert gnss.utc.tolist() == pytest.approx([START])
    assert gnss.values["quality"].tolist() == [5.0]


@pytest.mark.parametrize(
    ("day", "leap"),
    [("2005-12-31", 13), ("2006-01-02", 14), ("2012-06-30", 15), ("2017-01-02", 18), ("2026-01-01", 18)],
)
def test_leap_seconds_of_gps_time_follow_the_bulletins(day: str, leap: int) -> None:
    moment = dt.datetime.fromisoformat(day).replace(tzinfo=dt.UTC).timestamp() + 43200.0
    assert utc_of_gps_time(np.array([moment]))[0] == moment - leap


def test_a_cut_rtklib_line_is_dropped_with_its_number(tmp_path: Path) -> None:
    times = [f"2025/05/14 10:01:0{k}.000" for k in range(4)]
    lines = (POS.format(scale="UTC ") + pos_rows(times)).splitlines()
    lines[5] = lines[5][:30]
    gnss = read_pos(tmp_path, "\n".join(lines) + "\n")
    assert gnss.utc.size == 3
    assert [(w.row, w.what) for w in gnss.warnings] == [(6, "1 row of another length")]


def test_a_header_that_names_a_column_twice_is_refused(tmp_path: Path) -> None:
    content = POS.format(scale="UTC ").replace("sdn(m)", "sde(m)") + pos_rows(["2025/05/14 10:01:00.000"])
    with pytest.raises(RawError, match="one name"):
        read_pos(tmp_path, content)


# --- CSV of receivers and phones ---


def read_gnss_csv(tmp_path: Path, content: str, sensor: Gps = GPS) -> RawGnss:
    path = tmp_path / "gps.csv"
    path.write_text(content)
    assert chosen(sensor, path) is gnss_csv
    return gnss_csv.read(path, sensor, "gps", DATE)


TIMES = {
    "iso": lambda k: f"2025-05-14T10:01:{k // 10:02d}.{k % 10}Z",
    "iso with offset": lambda k: f"2025-05-14 13:01:{k // 10:02d}.{k % 10}+03:00",
    "seconds": lambda k: f"{START + k / 10:.1f}",
    "milliseconds": lambda k: f"{round(START * 1e3) + 100 * k}",
    "nanoseconds": lambda k: f"{round(START) * 10**9 + 10**8 * k}",
}


@pytest.mark.parametrize("form", TIMES)
def test_a_csv_of_positions_is_read_whatever_way_time_is_written(tmp_path: Path, form: str) -> None:
    rows = "".join(f"{TIMES[form](k)},50.0431,{36.4902 + k * 1e-6:.7f},151.6,2.5,90.0\n" for k in range(40))
    gnss = read_gnss_csv(tmp_path, "time,latitude,longitude,altitude,speed,bearing\n" + rows)
    assert gnss.utc == pytest.approx(START + 0.1 * np.arange(40), abs=1e-6)
    assert gnss.values["lon"] == pytest.approx(36.4902 + 1e-6 * np.arange(40))
    assert gnss.values["course"] == pytest.approx(0.0)
    assert gnss.values["quality"].tolist() == [1.0] * 40


def test_columns_and_host_times_of_a_csv_come_from_the_manifest(tmp_path: Path) -> None:
    sensor = Gps(
        kind="gps",
        file="gps.csv",
        position=(0.0, 0.0, 2.0),
        rate=1.0,
        columns={"t": "stamp", "lat": "B", "lon": "L", "alt": "H", "t_host_ns": "arrived"},
        units=Units(host_time="ms"),
    )
    rows = "".join(f"{1747216900000 + 1000 * k};{START + k};50,5;36,5;150,0\n" for k in range(5))
    gnss = read_gnss_csv(tmp_path, "arrived;stamp;B;L;H\n" + rows.replace(".0;", ";"), sensor)
    assert gnss.host_ns is not None
    assert gnss.host_ns.tolist() == [(1747216900000 + 1000 * k) * 10**6 for k in range(5)]
    assert gnss.values["lat"].tolist() == [50.5] * 5


def test_impossible_and_repeated_positions_are_dropped_with_their_rows(tmp_path: Path) -> None:
    rows = [f"{START + k},50.0,36.0,150.0" for k in range(10)]
    rows[3] = f"{START + 3},95.0,36.0,150.0"
    rows[4] = f"{START + 4},0.0,0.0,0.0"
    rows[6] = rows[5]
    rows[8] = f",{50.0},36.0,150.0"
    gnss = read_gnss_csv(tmp_path, "t,lat,lon,alt\n" + "\n".join(rows) + "\n")
    assert gnss.utc.tolist() == [START + k for k in (0, 1, 2, 5, 7, 9)]
    told = {(w.row, w.what) for w in gnss.warnings}
    assert told == {
        (10, "1 row without a usable time"),
        (5, "2 rows with an impossible position"),
        (8, "1 row of an instant already read"),
    }


def test_a_date_of_another_age_is_no_overflow(tmp_path: Path) -> None:
    rows = "1012-05-14T10:01:00.1Z,50.0,36.0\n" + "".join(f"{TIMES['iso'](k)},50.0,36.0\n" for k in range(5))
    assert read_gnss_csv(tmp_path, "time,latitude,longitude\n" + rows).utc[1:] == pytest.approx(
        START + 0.1 * np.arange(5), abs=1e-6
    )


def test_an_empty_sentence_log_is_refused() -> None:
    with pytest.raises(RawError, match="no usable GGA"):
        nmea.parse(b"", "gps.nmea", "gps", DATE)


# --- AgOpenGPS ---


def checked(body: str) -> str:
    total = 0
    for letter in body:
        total ^= ord(letter)
    return f"${body}*{total:02X}\r\n"


def test_agopengps_sentences_carry_position_speed_and_dual_heading() -> None:
    body = "PAOGI,100100.10,5002.5,N,03629.0,E,4,12,0.9,151.6,1.0,5.0,60.0,0.3,0.1,0.2,T"
    gnss = nmea.parse(checked(body).encode(), "gps.nmea", "gps", DATE)
    assert gnss.utc.tolist() == pytest.approx([START + 0.1])
    assert gnss.values["lat"][0] == pytest.approx(50.0 + 2.5 / 60)
    assert gnss.values["speed"][0] == pytest.approx(5.0 * 1852 / 3600)
    assert gnss.values["heading"][0] == pytest.approx(math.radians(30.0))
    single = nmea.parse(checked(body.replace("PAOGI", "PANDA")).encode(), "gps.nmea", "gps", DATE)
    assert np.isnan(single.values["heading"][0])  # PANDA's heading is the IMU's, not the antennas'
    assert any("geoid" in w.what for w in single.warnings)


# --- Gyroflow ---


def a_gcsv(rows: int = 50) -> str:
    head = "GYROFLOW IMU LOG\nversion,1.3\nid,x\norientation,YxZ\ntimestamp,1747216860\ntscale,0.001\n"
    head += "gscale,0.0012\nascale,0.0005\nt,gx,gy,gz,ax,ay,az\n"
    return head + "".join(f"{10 * k},{k},{-k},10,{k},{2 * k},2000\n" for k in range(rows))


def read_gcsv(tmp_path: Path, content: str) -> RawImu:
    path = tmp_path / "unit.gcsv"
    path.write_text(content)
    assert chosen(IMD, path) is gcsv
    return gcsv.read(path, IMD, "imd1", DATE)


def test_gyroflow_counts_are_scaled(tmp_path: Path) -> None:
    raw = read_gcsv(tmp_path, a_gcsv())
    k = np.arange(50)
    assert raw.host_ns.tolist() == [1747216860 * 10**9 + 10_000_000 * n for n in range(50)]
    assert raw.angular_velocity == pytest.approx(np.column_stack([k, -k, 0 * k + 10]) * 0.0012)
    assert raw.specific_force == pytest.approx(np.column_stack([k, 2 * k, 0 * k + 2000]) * 0.0005 * 9.80665)
    assert raw.rows[0] == 10


@pytest.mark.parametrize("broken", ["gscale,0.0012\n", "tscale,0.001\n"])
def test_a_gyroflow_file_without_a_scale_is_refused(tmp_path: Path, broken: str) -> None:
    with pytest.raises(RawError, match=f"no usable `{broken.split(',')[0]}`"):
        read_gcsv(tmp_path, a_gcsv().replace(broken, ""))


# --- Sensor Logger ---


def phone(
    tmp_path: Path, file: str, values: np.ndarray[tuple[int, int], np.dtype[np.float64]], shift: int = 0
) -> None:
    base = 1747216860 * 10**9
    rows = "".join(
        f"{base + shift + 10_000_000 * k},{k / 100:.4f},{z},{y},{x}\n"
        for k, (x, y, z) in enumerate(values.tolist())
    )
    (tmp_path / file).write_text("time,seconds_elapsed,z,y,x\n" + rows)


def test_a_phones_files_are_put_together(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    k = np.arange(100.0)[:, None]
    linear, gravity = rng.normal(0, 0.1, (100, 3)), np.tile([0.1, 0.2, 9.8], (100, 1))
    phone(tmp_path, "Accelerometer.csv", linear)
    phone(tmp_path, "Gravity.csv", gravity)
    phone(tmp_path, "Gyroscope.csv", k * [0.01, 0.02, -0.01], shift=-5_000_000)
    phone(tmp_path, "Magnetometer.csv", 0 * k + [20.0, 0.0, -40.0], shift=-5_000_000)
    path = tmp_path / "Accelerometer.csv"
    assert chosen(IMD, path) is sensor_logger
    raw = sensor_logger.read(path, IMD, "imd1", DATE)
    assert raw.specific_force == pytest.approx((linear + gravity)[:-1])  # the gyro ends half a step earlier
    assert raw.angular_velocity == pytest.approx(((k + 0.5) * [0.01, 0.02, -0.01])[:-1])
    assert raw.magnetic_field is not None
    assert raw.magnetic_field[0] == pytest.approx([20e-6, 0.0, -40e-6])


def test_a_phones_missing_gyroscope_is_named(tmp_path: Path) -> None:
    phone(tmp_path, "TotalAcceleration.csv", np.tile([0.0, 0.1, 9.8], (50, 1)))
    with pytest.raises(RawError, match=r"Gyroscope\.csv: is not beside TotalAcceleration\.csv"):
        sensor_logger.read(tmp_path / "TotalAcceleration.csv", IMD, "imd1", DATE)
