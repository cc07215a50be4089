"""Steering and wheel speed as a CAN bus's export holds them: any columns, any unit, many signals in a file."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest
from raw_samples import MANIFEST, START, Plan, write_pass
from smts_validate.sensors import manifest
from smts_validate.sensors.formats import speed_csv, steer_csv
from smts_validate.sensors.ingest import IngestError, read_pass
from smts_validate.sensors.log import read_log, write_log
from smts_validate.sensors.manifest import ManifestError, Speed, Steer
from smts_validate.sensors.plausibility import Finding, findings
from smts_validate.sensors.raw import RawError
from smts_validate.sensors.streams import FieldLog, GnssStream, ImuStream, SpeedStream, SteerStream

DATE = dt.date(2025, 5, 14)
LATE = 0.004  # s, of an arrival on the bus


def export(plan: Plan, header: str, columns: list[np.ndarray], rate: float = 20.0) -> str:
    """A table with Unix seconds by the logger's clock in front."""
    rows = zip(*(column.tolist() for column in columns), strict=True)
    lines = [
        ";".join([f"{START + plan.offset + LATE + k / rate:.6f}", *(f"{x:.9g}" for x in row)])
        for k, row in enumerate(rows)
    ]
    return "\n".join([header, *lines]) + "\n"


CAN = """[sensors.steer]
kind = "steer"
file = "can.csv"
columns = {{ t_host_ns = "Time", angle = "EstCurvature" }}
units = {{ angle = "deg", host_time = "s" }}
rate = 20.0
[sensors.rear_left]
kind = "speed"
wheel = "rear_left"
file = "can.csv"
columns = {{ t_host_ns = "Time", speed = "WheelSpeedRL" }}
units = {{ speed = "{rear}", host_time = "s" }}
rate = 20.0
[sensors.front_left]
kind = "speed"
wheel = "front_left"
file = "can.csv"
columns = {{ t_host_ns = "Time", speed = "{front}" }}
units = {{ speed = "rpm", host_time = "s" }}
rate = 20.0
"""


def bus_pass(folder: Path, rear: str = "km/h", front: str = "WheelSpeedFL") -> FieldLog:
    plan = Plan()
    k = np.arange(1150)
    columns = [
        3.0 * np.sin(k / 40.0),
        2.5 * 3.6 + 0.01 * (k % 7),
        60.0 * 2.5 / (2.0 * np.pi * 0.62) + 0.0 * k,
    ]
    table = export(plan, "Time;EstCurvature;WheelSpeedRL;WheelSpeedFL", columns)
    rest = CAN.format(rear=rear, front=front)
    return read_pass(write_pass(folder / "pass", Plan(rest=rest, extra={"can.csv": table})))


def test_one_export_holds_steering_and_wheels_each_in_its_unit(tmp_path: Path) -> None:
    log = bus_pass(tmp_path)
    k = np.arange(1150)
    steer, rear, front = log.of_type(SteerStream)["steer"], *log.of_type(SpeedStream).values()
    np.testing.assert_allclose(steer.angle, np.deg2rad(3.0 * np.sin(k / 40.0)), atol=1e-8)
    np.testing.assert_allclose(rear.speed, 2.5 + 0.01 * (k % 7) / 3.6, atol=1e-8)
    np.testing.assert_allclose(
        front.speed, 2.5, rtol=1e-8
    )  # its rotation times the radius of run.toml, 0.62 m
    np.testing.assert_allclose(steer.t - START - k / 20.0, np.median(steer.t - START - k / 20.0), atol=1e-4)
    np.testing.assert_allclose(steer.t, START + k / 20.0, atol=0.06)  # a receiver's latency is assumed


def test_speeds_survive_the_log_to_the_last_bit(tmp_path: Path) -> None:
    log = bus_pass(tmp_path)
    write_log(tmp_path / "a.mcap", log)
    again = read_log(tmp_path / "a.mcap")
    for name, stream in log.of_type(SpeedStream).items():
        np.testing.assert_array_equal(again.of_type(SpeedStream)[name].speed, stream.speed)
        np.testing.assert_array_equal(again.of_type(SpeedStream)[name].t, stream.t)
    assert list(again.streams) == list(log.streams)


def test_two_sensors_must_not_read_the_same_column(tmp_path: Path) -> None:
    with pytest.raises(ManifestError, match=r"both read 'can\.csv'"):
        bus_pass(tmp_path, front="WheelSpeedRL")


def test_a_column_that_is_not_there_is_refused_with_file_and_row(tmp_path: Path) -> None:
    with pytest.raises(IngestError, match=r"can\.csv, row 1: no column 'WheelSpeedFR'"):
        bus_pass(tmp_path, front="WheelSpeedFR")


@pytest.mark.parametrize(
    ("unit", "value", "speed", "turning"),
    [
        ("m/s", 2.5, 2.5, False),
        ("mm/s", 2500.0, 2.5, False),
        ("km/h", 9.0, 2.5, False),
        ("mph", 5.592340730136, 2.5, False),  # 1 mile = 1609.344 m
        ("rad/s", -3.0, -3.0, True),
        ("rpm", 30.0, np.pi, True),
    ],
)
def test_every_unit_of_speed(unit: str, value: float, speed: float, turning: bool, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "t_host_ns,speed\n" + "".join(f"{1747216800 + k}000000000,{value}\n" for k in range(9))
    )
    sensor = Speed.model_validate({"kind": "speed", "file": "a.csv", "rate": 1.0, "units": {"speed": unit}})
    raw = speed_csv.read(tmp_path / "a.csv", sensor, "a", DATE)
    np.testing.assert_allclose(raw.speed, speed, rtol=1e-12)
    assert raw.turning == turning


def test_a_buss_not_available_is_left_out_and_counted(tmp_path: Path) -> None:
    values = [2.5, 2.5, 65.535, "", "nan", 2.5, 2.5, 2.5, 2.5]  # ISO 11783: 0xFFFF of 0.001 m/s is no value
    (tmp_path / "a.csv").write_text(
        "t_host_ns,speed\n" + "".join(f"{1747216800 + k}000000000,{v}\n" for k, v in enumerate(values))
    )
    raw = speed_csv.read(tmp_path / "a.csv", Speed(kind="speed", file="a.csv", rate=1.0), "a", DATE)
    assert raw.rows.tolist() == [2, 3, 7, 8, 9, 10]
    assert [w.what for w in raw.warnings] == [
        "2 rows with an empty or non-numeric value",
        "1 row with a speed beyond 50 m/s (taken as m/s)",
    ]


def test_degrees_taken_for_radians_are_told_of(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "t_host_ns,angle\n" + "".join(f"{1747216800 + k}000000000,{5 + k}\n" for k in range(9))
    )
    with pytest.raises(RawError, match=r'taken as rad; units = \{ angle = "deg" \}'):
        steer_csv.read(tmp_path / "a.csv", Steer(kind="steer", file="a.csv", rate=1.0), "a", DATE)


# --- what the readings say of the manifest ---

WEAVE = np.arange(0.0, 60.0, 0.02)
SPEED = 2.5 + 0.8 * np.sin(WEAVE / 5.0)
ANGLE = 0.12 * np.sin(WEAVE / 2.0)
BASE = 1.45 + 1.15  # of MANIFEST's tractor


def told(kind: str, keys: str, values: np.ndarray, late: float = 0.0) -> Finding:
    """What is found of a bus's signal beside a machine that weaves and changes its speed."""
    rest = f'[sensors.bus]\nkind = "{kind}"\nfile = "a.csv"\nrate = 50.0\n{keys}\n'
    run = manifest.parse(MANIFEST.format(id="x", imd1="", rest=rest))
    utc, zeros = WEAVE[::5], np.zeros(WEAVE.size)
    arrays = dict.fromkeys(GnssStream.ARRAYS, np.zeros(utc.size)) | {"speed": SPEED[::5]}
    turning = np.column_stack([zeros, zeros, SPEED * np.tan(ANGLE) / BASE])
    made = SpeedStream if kind == "speed" else SteerStream
    streams = {
        "imd1": ImuStream("imd1", WEAVE, WEAVE, np.tile([0.0, 0.0, 9.81], (WEAVE.size, 1)), turning),
        "gps": GnssStream("gps", utc, utc + 0.1, **arrays),
        "bus": made("bus", WEAVE + late, WEAVE + late, values),
    }
    return findings(run, streams)["bus"]


@pytest.mark.parametrize(
    ("keys", "factor", "hint"),
    [
        ("", 1.0, None),
        ("", 1.05, None),  # a radius
        ("", 3.6, "look like km/h, not m/s"),
        ('units = { speed = "km/h" }', 1 / 3.6, "look like m/s, not km/h"),
        ("", 1000.0, "look like mm/s"),
        ("", 1 / 0.44704, "look like mph"),
        ("", 1 / 0.8, "look like rad/s"),  # of the rear wheel, 0.8 m
        ('wheel = "front_left"', 1 / 0.62, "look like rad/s"),
        ("", 60 / (2 * np.pi * 0.8), "look like rpm"),
        ("", 6.0, "reads 6.00 times the speed over ground"),
    ],
)
def test_a_speed_in_another_unit_is_named(keys: str, factor: float, hint: str | None) -> None:
    found = told("speed", keys, factor * SPEED)
    assert found.facts["speed_ratio"] == pytest.approx(factor, rel=0.01)
    assert (hint is None) == (found.hints == ())
    assert hint is None or hint in found.hints[0]


@pytest.mark.parametrize(
    ("keys", "factor", "hint"),
    [
        ("", 1.0, None),
        ("", 180.0 / np.pi, 'set units = { angle = "deg" }'),
        ('units = { angle = "deg" }', np.pi / 180.0, 'remove angle = "deg"'),
        ("", -1.0, "must be positive to the left"),
        ("", 17.0, "perhaps the steering wheel's"),
    ],
)
def test_a_steering_angle_that_does_not_explain_the_turning_is_named(
    keys: str, factor: float, hint: str | None
) -> None:
    found = told("steer", keys, factor * ANGLE)
    assert found.facts["steering_ratio"] == pytest.approx(abs(factor), rel=0.05)
    assert (hint is None) == (found.hints == ())
    assert hint is None or hint in found.hints[0]


@pytest.mark.parametrize(("kind", "values"), [("speed", SPEED), ("steer", ANGLE)])
def test_a_late_signal_of_the_bus_is_seen_and_told_of(kind: str, values: np.ndarray) -> None:
    found = told(kind, "", values, late=0.4)
    assert found.facts["clock_check"]["offset_s"] == pytest.approx(0.4, abs=0.02)
    assert any("0.40 s after" in hint and "check the clocks" in hint for hint in found.hints)
