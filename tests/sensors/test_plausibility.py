"""Hints on wrong mountings, units and clocks: made wrong, they must be named; made right, not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from raw_samples import MANIFEST, START, Plan, imu_lines, write_pass
from scipy.spatial.transform import Rotation
from smts_validate.sensors import manifest
from smts_validate.sensors.health import health_of
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.plausibility import best_upright, findings, time_offset
from smts_validate.sensors.streams import GnssStream, WheelStream

HEADER = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz"


def rewritten(folder: Path, change: object, name: str = "imd1.csv") -> None:
    """imd1.csv with its six readings changed by a function of an (N, 6) array."""
    rows = [row.split(",") for row in imu_lines(Plan())]
    values = change(np.array([[float(x) for x in row[3:]] for row in rows]))  # type: ignore[operator]
    lines = [
        ",".join([*row[:3], *(f"{x:.6f}" for x in v)]) for row, v in zip(rows, values.tolist(), strict=True)
    ]
    (folder / name).write_text("\n".join([HEADER, *lines]) + "\n")


def hints(folder: Path, sensor: str = "imd1") -> list[str]:
    """What health says about a sensor; the same must stand in the warnings."""
    log = read_pass(folder)
    told: list[str] = log.health[sensor].get("hints", [])
    assert told == [w.what for w in log.warnings if w.sensor == sensor and "run.toml" in w.effect]
    json.dumps(log.health, allow_nan=False)
    return told


def test_a_pass_that_is_as_its_manifest_says_raises_no_hint(tmp_path: Path) -> None:
    assert hints(write_pass(tmp_path / "pass")) == []


@pytest.mark.parametrize(
    ("scale", "told"),
    [(1 / 9.80665, "look like g"), (1000 / 9.80665, "look like mg"), (0.5, "mean specific force is 4.9")],
)
def test_wrong_units_of_acceleration_are_recognised(tmp_path: Path, scale: float, told: str) -> None:
    folder = write_pass(tmp_path / "pass")
    rewritten(folder, lambda v: v * np.repeat([scale, 1.0], 3))
    assert any(told in hint for hint in hints(folder))


@pytest.mark.parametrize(
    ("turned", "axis", "fits"),
    [((180, 0), "-z", "[180, 0, yaw]"), ((90, 0), "+y", "[90, 0, yaw]"), ((0, -90), "+x", "[0, -90, yaw]")],
)
def test_a_mounting_that_the_manifest_does_not_tell_is_seen_in_gravity(
    tmp_path: Path, turned: tuple[int, int], axis: str, fits: str
) -> None:
    folder = write_pass(tmp_path / "pass")
    to_sensor = Rotation.from_euler("ZYX", [0, turned[1], turned[0]], degrees=True).as_matrix()
    rewritten(folder, lambda v: np.hstack([v[:, :3] @ to_sensor, v[:, 3:] @ to_sensor]))
    told = hints(folder)
    assert len(told) == 1
    assert f"along the sensor's {axis}" in told[0]
    assert fits in told[0]


def test_the_same_mounting_told_in_the_manifest_is_no_fault(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass", Plan(imd1="rotation_deg = [180.0, 0.0, 0.0]"))
    rewritten(folder, lambda v: v * [1, -1, -1, 1, -1, -1])
    assert hints(folder) == []


WHEEL = """[sensors.wds1]
kind = "wds"
wheel = "rear_left"
file = "wds1.csv"
rate = 100.0
"""


def wheel_pass(tmp_path: Path, spin_of: object) -> Path:
    """A pass whose wheel unit turns as given, over time; the machine drives at 2.5 m/s on 0.8 m wheels."""
    folder = write_pass(tmp_path / "pass", Plan(rest=WHEEL))
    t = np.arange(6000) / (100.0 * (1.0 + 40e-6))
    spin = spin_of(t)  # type: ignore[operator]
    phase = np.cumsum(spin[:, 1]) * 0.01

    def turned(
        v: np.ndarray[tuple[int, int], np.dtype[np.float64]],
    ) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
        gravity = 9.80665 * np.column_stack([-np.sin(phase), 0 * phase, np.cos(phase)])
        return np.hstack([gravity + 0.1, spin + 0.001 * v[:, :3]])

    rewritten(folder, turned, "wds1.csv")
    return folder


def test_the_receivers_latency_is_seen_in_wheels_that_speed_up(tmp_path: Path) -> None:
    """The machine of the samples never changes its speed, so speed and spin are written here."""
    t = np.arange(0.0, 40.0, 0.01)
    speed = 2.5 * (1.0 - np.exp(-t / 4.0)) + 0.3 * np.sin(t)
    zeros, utc = np.zeros((t.size, 3)), t[::10]
    spin = np.column_stack([0 * t, speed / 0.8, 0 * t])
    wheel = WheelStream("wds1", t + 0.037, t + 0.05, zeros + 1.0, spin)
    arrays = dict.fromkeys(GnssStream.ARRAYS, np.zeros(utc.size)) | {"speed": speed[::10]}
    gnss = GnssStream("gps", utc, utc + 0.1, **arrays)
    run = manifest.parse(MANIFEST.format(id="x", imd1="", rest=WHEEL))
    found = findings(run, {"wds1": wheel, "gps": gnss})
    assert found["gps"].facts["latency_by_wheels_s"] == pytest.approx(0.1 - 0.037, abs=0.003)
    assert found["wds1"].hints == ()


def spin_about(axis: int, rate: float) -> object:
    return lambda t: np.outer(np.full(t.size, rate), np.eye(3)[axis])


def test_a_rolling_wheel_gives_its_radius_and_no_hint(tmp_path: Path) -> None:
    folder = wheel_pass(tmp_path, spin_about(1, 2.5 / 0.8))
    assert hints(folder, "wds1") == []
    health = read_pass(folder).health["wds1"]
    assert health["share_on_axle"] > 0.99
    assert health["rolling_radius_m"] == pytest.approx(0.8, rel=0.03)


@pytest.mark.parametrize(
    ("axis", "rate", "told"),
    [
        (1, -2.5 / 0.8, "turns backwards"),
        (0, 2.5 / 0.8, "most about the sensor's x"),
        (1, 2.5 / 0.5, "imply a rolling radius of 0.5"),
    ],
)
def test_a_wheels_unit_that_does_not_fit_is_named(tmp_path: Path, axis: int, rate: float, told: str) -> None:
    assert any(told in hint for hint in hints(wheel_pass(tmp_path, spin_about(axis, rate)), "wds1"))


def test_a_wheels_spin_in_degrees_is_recognised_or_refused(tmp_path: Path) -> None:
    slow = wheel_pass(tmp_path / "slow", spin_about(1, float(np.degrees(2.05 / 0.8))))
    assert any("look like deg/s" in hint for hint in hints(slow, "wds1"))
    fast = wheel_pass(tmp_path / "fast", spin_about(1, float(np.degrees(2.5 / 0.8))))
    with pytest.raises(ValueError, match=r"beyond what such a unit can read .* check the file, or `columns`"):
        read_pass(fast)


SECOND = """[sensors.imd2]
kind = "imd"
body = "tractor"
file = "imd2.csv"
position = [0.0, 0.0, 0.0]
rate = 100.0
"""


def test_a_second_unit_on_the_body_with_a_late_clock_is_seen(tmp_path: Path) -> None:
    folder = write_pass(tmp_path / "pass", Plan(rest=SECOND))
    rows = [row.split(",") for row in imu_lines(Plan(seed=5))]
    late = [",".join([str(int(row[0]) + 300_000_000), *row[1:]]) for row in rows]
    (folder / "imd2.csv").write_text("\n".join([HEADER, *late]) + "\n")
    log = read_pass(folder)
    check = log.health["imd2"]["clock_check"]
    assert check["against"] == "imd1"
    assert check["offset_s"] == pytest.approx(0.3, abs=0.005)
    assert any("0.30 s after that of imd1" in hint for hint in log.health["imd2"]["hints"])


@given(st.floats(-0.9, 0.9), st.sampled_from([1.0, -1.0]))
def test_an_offset_between_two_signals_is_found_to_a_few_milliseconds(lag: float, sign: float) -> None:
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 30.0, 0.01)
    knots = np.convolve(rng.normal(size=400), np.ones(5) / 5, mode="same")

    def signal(
        at: np.ndarray[tuple[int], np.dtype[np.float64]],
    ) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
        return np.interp(at, np.arange(400) * 0.1 - 5.0, knots)

    found, alike = time_offset(t, sign * signal(t - lag), t, signal(t))
    assert found == pytest.approx(lag, abs=5e-3)
    assert alike == pytest.approx(sign, abs=0.05)


def test_signals_without_anything_in_common_time_give_no_offset() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    assert time_offset(t, np.sin(t), t + 9.0, np.sin(t)) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("mean", "fits"),
    [([0, 0, 9.8], (0, 0)), ([0, 0, -9.8], (180, 0)), ([0, -9.8, 0.3], (-90, 0)), ([-9.8, 0, 0], (0, 90))],
)
def test_the_quarter_turn_that_stands_a_unit_upright(mean: list[float], fits: tuple[int, int]) -> None:
    assert best_upright(np.array(mean, dtype=np.float64)) == fits


def test_health_read_again_keeps_what_only_the_raw_files_told(tmp_path: Path) -> None:
    log = read_pass(write_pass(tmp_path / "pass"))
    again = health_of(log)
    assert again == log.health
    assert again["imd1"]["drift_ppm"] == pytest.approx(40.0, abs=3.0)
    assert again["imd1"]["counter_wraps"] == 1
    assert again["imd1"]["start"] == pytest.approx(START, abs=0.1)
    assert again["gps"]["quality"] == {"4": 600}
    assert again["gps"]["quality_over_time"] == [[0.0, 4.0]]
