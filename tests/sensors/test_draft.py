"""A drafted run.toml: what is planted in the raw files must be found, and the draft must run."""

from __future__ import annotations

import datetime as dt
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from raw_samples import START, Plan, imu_lines, write_pass
from smts_validate.sensors import manifest
from smts_validate.sensors.draft import DraftError, draft_manifest
from smts_validate.sensors.draft_columns import guess_inertial, guess_steering
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.manifest import Imd, Manifest, Steer, Wds

VISIBLE = Path(__file__).resolve().parents[3] / "shared" / "examples" / "visible" / "raw" / "visible-1"
HEADER = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz"


def drafted(folder: Path) -> tuple[Manifest, list[str]]:
    text, reasons = draft_manifest(folder)
    return manifest.parse(text), reasons


def test_a_draft_of_a_pass_runs_as_it_is(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "field 1 (east)")
    (folder / "run.toml").unlink()
    text, reasons = draft_manifest(folder)
    (folder / "run.toml").write_text(text)
    log = read_pass(folder)
    assert log.manifest.run.id == "field-1-east-"
    assert log.manifest.run.date == dt.date(2025, 5, 14)
    assert log.manifest.sensors["imd1"].rate == 100.0
    assert log.manifest.sensors["gps"].rate == 10.0
    assert any("gravity along +z" in reason for reason in reasons)
    assert "hints" not in log.health["imd1"]


def test_another_loggers_table_is_understood_by_names_and_magnitudes(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    rows = [row.split(",") for row in imu_lines(Plan())]
    lines = ["Timestamp;Acc_X [g];Acc_Y [g];Acc_Z [g];Gyro X;Gyro Y;Gyro Z"]
    for row in rows:
        force = [float(x) / 9.80665 for x in row[3:6]]
        turn = [np.degrees(float(x)) for x in row[6:]]
        # mounted with x up: sensor x = body z, sensor y = body y, sensor z = -body x; rotations in deg/s
        cells = [force[2], force[1], -force[0], turn[2], turn[1], -turn[0]]
        lines.append(";".join([f"{int(row[0]) / 1e6:.3f}", *(f"{x:.6f}" for x in cells)]).replace(".", ","))
    (folder / "imd1.csv").write_text("\n".join(lines) + "\n")
    run, reasons = drafted(folder)
    unit = run.sensors["imd1"]
    assert isinstance(unit, Imd)
    assert unit.units.host_time == "ms"
    assert (unit.units.accel, unit.units.gyro) == ("g", "deg/s")
    assert unit.columns["gz"] == "Gyro Z"
    assert unit.rotation_deg == (0.0, -90.0, 0.0)
    assert any("gravity along +x" in reason for reason in reasons)


def test_a_unit_whose_gravity_turns_sits_in_a_wheel(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    t = np.arange(6000) / 100.0
    phase = -3.0 * t
    values = np.column_stack([-9.8 * np.sin(phase), 0 * t, 9.8 * np.cos(phase), 0 * t, 0 * t - 3.0, 0 * t])
    rows = [row.split(",")[:3] for row in imu_lines(Plan())]
    lines = [",".join([*row, *(f"{x:.5f}" for x in v)]) for row, v in zip(rows, values.tolist(), strict=True)]
    (folder / "wheel_rear_left.csv").write_text("\n".join([HEADER, *lines]) + "\n")
    run, _ = drafted(folder)
    unit = run.sensors["wds1"]
    assert isinstance(unit, Wds)
    assert unit.wheel == "rear_left"
    assert unit.rotation_deg == (0.0, 0.0, 180.0)


def test_a_steering_table_is_found_by_its_words(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    stamps = [f"{START + k / 20:.3f},{0.01 * (k % 9):.3f}" for k in range(1200)]
    (folder / "can.csv").write_text("time,steering_angle\n" + "\n".join(stamps) + "\n")
    run, _ = drafted(folder)
    unit = run.sensors["steer"]
    assert isinstance(unit, Steer)
    assert unit.rate == 20.0
    assert unit.units.host_time == "s"
    assert unit.columns == {"t_host_ns": "time", "angle": "steering_angle"}


@pytest.mark.parametrize(
    ("header", "speeds", "expected"),
    [
        ("WheelSpeedRL,WheelSpeedRR", 9.0, {"rear_left": "km/h", "rear_right": "km/h"}),
        (
            "wheel speed front left [rpm],rear_right_wheel_speed_kmh",
            9.0,
            {"front_left": "rpm", "rear_right": "km/h"},
        ),
        ("vehicle_speed,gear", 2.5, {None: "m/s"}),
        ("Wheel-based machine speed,x", 2500.0, {None: "mm/s"}),
        ("WheelBasedVehicleSpeed [km/h],x", 9.0, {None: "km/h"}),
        ("rrspeed (mph),FL_speed (m/s)", 5.0, {"front_left": "m/s", "rear_right": "mph"}),
        ("engine_speed_limit,throttle", 9.0, {}),
    ],
)
def test_speeds_of_a_bus_are_found_with_wheel_and_unit(
    tmp_path: Path, header: str, speeds: float, expected: dict[str | None, str]
) -> None:
    folder = write_pass(tmp_path / "pass")
    rows = [f"{START + k / 20:.3f},{0.5 * (k % 90) - 20:.1f},{speeds},{speeds}" for k in range(1180)]
    (folder / "can.csv").write_text(f"time,steering angle (deg),{header}\n" + "\n".join(rows) + "\n")
    run, reasons = drafted(folder)
    assert {s.wheel: s.units.speed for s in run.of_kind("speed").values()} == expected
    assert run.sensors["steer"].units.angle == "deg"
    assert {s.rate for s in run.of_kind("speed").values()} <= {20.0}
    assert len([r for r in reasons if "is a speed" in r]) == len(expected)
    (folder / "run.toml").write_text(draft_manifest(folder)[0])
    assert set(read_pass(folder).streams) == set(run.sensors)


def test_small_steering_angles_are_left_in_radians(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    rows = [f"{START + k / 20:.3f},{0.004 * (k % 90) - 0.2:.4f}" for k in range(1180)]
    (folder / "can.csv").write_text("time,steer\n" + "\n".join(rows) + "\n")
    assert drafted(folder)[0].sensors["steer"].units.angle == "rad"


def test_what_is_not_recognised_is_said_and_passed_over(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    (folder / "notes.txt").write_text("wet\n")
    (folder / "photo.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(range(256)))
    _, reasons = drafted(folder)
    assert {r for r in reasons if "not recognised" in r} == {
        "notes.txt: not recognised, passed over",
        "photo.jpg: not recognised, passed over",
    }


@pytest.mark.parametrize("missing", ["imd1.csv", "gps.nmea"])
def test_a_folder_without_the_least_sensors_is_refused_in_one_line(tmp_path: Path, missing: str) -> None:
    folder = write_pass(tmp_path / "pass")
    (folder / missing).unlink()
    with pytest.raises(DraftError, match="no file looks like the log of") as caught:
        draft_manifest(folder)
    assert "\n" not in str(caught.value)


def test_hostile_names_stay_inside_their_quotes(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / '..x"]\n[run]')
    (folder / "imd1.csv").rename(folder / 'imd"1\\.csv')
    run, _ = drafted(folder)
    assert run.sensors["imd1"].file == 'imd"1\\.csv'
    assert ".." not in run.run.id


ANGULAR, LINEAR = "angular_velocity", "linear_acceleration"
BRACKETS = [f"{word}.{axis}({unit})" for word, unit in (("Acc", "g"), ("Gyr", "deg/s")) for axis in "XYZ"]


@pytest.mark.parametrize(
    ("names", "gz", "units"),
    [
        ([f"{word}_{axis}" for word in ("accel", "gyro") for axis in "xyz"], "gyro_z", {}),
        (BRACKETS, "Gyr.Z(deg/s)", {"accel": "g", "gyro": "deg/s"}),
        ([f"{word}.{axis}" for word in (LINEAR, ANGULAR) for axis in "xyz"], "angular_velocity.z", {}),
        ([f"{axis}_{word}" for word in ("acc", "gyro") for axis in "xyz"], "z_gyro", {}),
    ],
)
def test_headers_of_other_loggers_are_understood(names: list[str], gz: str, units: dict[str, str]) -> None:
    columns, found, _ = guess_inertial(["time", *names])
    assert columns is not None
    assert columns["gz"] == gz
    assert found == units


def test_tables_of_other_things_are_not_taken_for_sensors() -> None:
    assert guess_inertial(("time", "temperature", "x", "y", "z"))[0] is None
    assert guess_steering(("time", "voltage"))[0] is None


@pytest.mark.skipif(not VISIBLE.exists(), reason="the example is not beside this checkout")
def test_the_examples_manifest_is_drafted_as_its_makers_wrote_it() -> None:
    run, _ = drafted(VISIBLE)
    truth = manifest.read(VISIBLE / "run.toml")[0]
    assert set(run.sensors) == set(truth.sensors)
    for name, sensor in truth.sensors.items():
        assert run.sensors[name].kind == sensor.kind
        assert run.sensors[name].rate == sensor.rate
        assert getattr(run.sensors[name], "body", "") == getattr(sensor, "body", "")
    assert run.run.date == truth.run.date
    assert run.sensors["imd3"].rotation_deg == (180.0, 0.0, 0.0)  # type: ignore[union-attr]


def test_init_writes_a_manifest_once_and_over_it_only_when_forced(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass")
    (folder / "run.toml").unlink()
    command = [sys.executable, "-m", "smts_validate.pipeline.cli", "init", str(folder)]
    first = subprocess.run([*command, "--json"], capture_output=True, text=True, check=True)
    assert any("gravity along +z" in reason for reason in json.loads(first.stdout)["reasons"])
    assert manifest.read(folder / "run.toml")[0].run.id == "pass"
    again = subprocess.run(command, capture_output=True, text=True, check=False)
    assert again.returncode == 1
    assert "--force" in again.stderr
    assert len(again.stderr.splitlines()) == 1
    assert subprocess.run([*command, "--force"], capture_output=True, check=False).returncode == 0
