"""Steering and wheel speed as a CAN bus's export holds them: any columns, any unit, many signals in a file."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np
import pytest
from raw_samples import START, Plan, write_pass
from smts_validate.sensors.formats import speed_csv, steer_csv
from smts_validate.sensors.ingest import IngestError, read_pass
from smts_validate.sensors.log import read_log, write_log
from smts_validate.sensors.manifest import ManifestError, Speed, Steer
from smts_validate.sensors.raw import RawError
from smts_validate.sensors.streams import FieldLog, SpeedStream, SteerStream

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
