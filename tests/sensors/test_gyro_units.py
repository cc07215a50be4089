"""A gyro in the wrong unit is named by its turning against the course, or by the size of its rotation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from raw_samples import START, Plan, imu_lines, write_pass
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.streams import GnssStream
from smts_validate.sensors.turning import TO_DEGREES, TO_RADIANS, turning_ratio, unit_hints

Floats = NDArray[np.float64]
IN_DEGREES = 'units = { gyro = "deg/s" }'
HEADER = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz"


def told(folder: Path, sensor: str = "imd1") -> list[str]:
    return [warning.what for warning in read_pass(folder).warnings if warning.sensor == sensor]


def in_degrees(folder: Path) -> Path:
    """The pass with rotations that were written in deg/s."""
    rows = [row.split(",") for row in imu_lines(Plan())]
    lines = [",".join([*row[:6], *(f"{np.degrees(float(x)):.5f}" for x in row[6:])]) for row in rows]
    (folder / "imd1.csv").write_text("\n".join([HEADER, *lines]) + "\n")
    return folder


def test_the_right_unit_is_not_doubted(tmp_path: Path) -> None:
    assert told(write_pass(tmp_path / "rad")) == []
    assert told(in_degrees(write_pass(tmp_path / "deg", Plan(imd1=IN_DEGREES)))) == []


def test_deg_s_taken_for_rad_s_are_named(tmp_path: Path) -> None:
    assert told(in_degrees(write_pass(tmp_path / "pass"))) == [TO_DEGREES]


def test_rad_s_taken_for_deg_s_are_named(tmp_path: Path) -> None:
    assert told(write_pass(tmp_path / "pass", Plan(imd1=IN_DEGREES))) == [TO_RADIANS]


def test_a_wheel_that_seems_to_stand_while_the_machine_drives_is_named(tmp_path: Path) -> None:
    wheel = '[sensors.wds1]\nkind = "wds"\nwheel = "rear_left"\nfile = "wds1.csv"\nrate = 100.0\n'
    rows = [row.split(",") for row in imu_lines(Plan())]
    spin = 2.5 / 0.8  # rad/s, of the sample's speed and rear wheel
    lines = [",".join([*row[:7], f"{spin + float(row[7]):.4f}", row[8]]) for row in rows]
    extra = {"wds1.csv": "\n".join([HEADER, *lines]) + "\n"}
    right = write_pass(tmp_path / "right", Plan(rest=wheel, extra=extra))
    assert told(right, "wds1") == []
    wrong = write_pass(tmp_path / "wrong", Plan(rest=wheel + IN_DEGREES, extra=extra))
    assert told(wrong, "wds1") == [TO_RADIANS]


def receiver(t: Floats, course: Floats, speed: float = 2.5) -> GnssStream:
    """A receiver that states course and speed."""
    blank = np.full(t.size, np.nan)
    values = dict.fromkeys(GnssStream.ARRAYS, blank)
    return GnssStream("gps", t, t, **(values | {"course": course, "speed": np.full(t.size, speed)}))


@pytest.mark.parametrize("late", [0.0, 1.3])
def test_the_ratio_is_that_of_the_scales_however_the_course_wraps(late: float) -> None:
    t = np.arange(0.0, 60.0, 0.1)
    course = 3.0 + 0.4 * np.sin(0.5 * t)  # passes ±pi
    fine = np.arange(0.0, 62.0, 0.01)
    rate = 0.2 * np.cos(0.5 * (fine - late)) + 0.01  # the derivative, and a bias
    gnss = receiver(START + t, (course + np.pi) % (2 * np.pi) - np.pi)
    for scale in (1.0, 57.3, 1 / 57.3):
        drove, ratio = turning_ratio(START + fine, scale * rate, gnss, late)
        assert drove
        assert ratio == pytest.approx(scale, rel=0.01)


def test_a_course_of_noise_tells_no_ratio() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    rng = np.random.default_rng(4)
    gnss = receiver(t, 0.02 * rng.standard_normal(t.size))
    assert turning_ratio(t, 0.01 * rng.standard_normal(t.size), gnss) == (True, None)


def test_a_machine_that_stands_did_not_drive() -> None:
    t = np.arange(0.0, 60.0, 0.1)
    assert turning_ratio(t, 0.0 * t, receiver(t, 0.0 * t, speed=0.1)) == (False, None)


@pytest.mark.parametrize(
    ("size", "drove", "stated_degrees", "hints"),
    [
        (0.04, True, False, ()),
        (0.04, True, True, ()),
        (0.04 * 57.3, True, False, (TO_DEGREES,)),
        (0.04 / 57.3, True, True, (TO_RADIANS,)),
        (0.04 / 57.3, True, False, ()),  # a unit that hardly turns was not scaled down by anyone
        (0.04 / 57.3, False, True, ()),  # it may have stood
    ],
)
def test_on_a_straight_row_the_size_of_all_rotation_tells(
    size: float, drove: bool, stated_degrees: bool, hints: tuple[str, ...]
) -> None:
    rotation = np.random.default_rng(5).normal(0.3, size / np.sqrt(3.0), (5000, 3))
    assert unit_hints(drove, None, rotation, stated_degrees) == hints
