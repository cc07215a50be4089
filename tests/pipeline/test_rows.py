"""Rows: where they begin and end, which line serves them, what is passed over."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion, Origin
from smts_validate.pipeline.rows import find_rows, fit_line, runs, serving_line, survey
from smts_validate.sensors.geodesy import Line, to_geodetic
from smts_validate.sensors.manifest import Line as ManifestLine
from smts_validate.sensors.manifest import Manifest
from synthetic_motion import manifest_of

Floats = NDArray[np.float64]
ORIGIN = Origin(50.04, 36.48, 150.0)
STEP = 0.02
SPEED = 2.8


def driven(curvature: Floats, speed: Floats, heading: float = 0.0) -> Motion:
    """A tractor that follows a curvature (1/m) at a speed (m/s), both a sample each 1/50 s."""
    yaw = heading + np.concatenate(([0.0], np.cumsum(STEP * (curvature * speed)[:-1])))
    x = np.concatenate(([0.0], np.cumsum(STEP * (speed * np.cos(yaw))[:-1])))
    y = np.concatenate(([0.0], np.cumsum(STEP * (speed * np.sin(yaw))[:-1])))
    t = 1.7e9 + STEP * np.arange(yaw.size)
    nan, zero = np.full(t.size, np.nan), np.zeros(t.size)
    body = BodyMotion(
        x, y, yaw, speed, zero, curvature * speed, np.tile(1e-4 * np.eye(6), (t.size, 1, 1)), nan, nan
    )
    empty = np.zeros((0, 2, 3))
    return Motion(t, ORIGIN, body, None, nan, nan, None, t[:2], empty, t[::5])


def straight(metres: float, speed: float = SPEED) -> Floats:
    return np.zeros(round(metres / (speed * STEP)))


def turn(radius: float = 6.0, angle: float = np.pi) -> Floats:
    return np.full(round(angle * radius / (SPEED * STEP)), 1.0 / radius)


def at_speed(curvature: Floats) -> Floats:
    return np.full(curvature.size, SPEED)


def with_line(motion: Motion, a: tuple[float, float], b: tuple[float, float]) -> Manifest:
    """The manifest with an AB line through two ENU points of the motion's plane."""
    lat, lon, _ = to_geodetic(np.array([a[0], b[0]]), np.array([a[1], b[1]]), np.zeros(2), motion.origin)
    line = ManifestLine(a=(float(lat[0]), float(lon[0])), b=(float(lat[1]), float(lon[1])))
    return manifest_of().model_copy(update={"line": line})


def test_two_rows_with_a_turn_between_are_found_in_opposite_directions() -> None:
    curvature = np.concatenate((straight(100.0), turn(), straight(80.0)))
    rows = find_rows(driven(curvature, at_speed(curvature)), manifest_of())
    assert [r.index for r in rows] == [0, 1]
    assert [r.direction for r in rows] == ["east", "west"]
    assert rows[0].length == pytest.approx(100.0, abs=3.0)
    assert rows[1].length == pytest.approx(80.0, abs=3.0)
    assert abs(rows[1].line.heading) == pytest.approx(np.pi, abs=0.01)


def test_a_row_begins_where_nine_tenths_of_the_speed_are_held() -> None:
    ramp = np.linspace(0.0, SPEED, 500)
    speed = np.concatenate((ramp, np.full(2000, SPEED)))
    (row,) = find_rows(driven(np.zeros(speed.size), speed), manifest_of())
    assert row.start == pytest.approx(450, abs=5)
    assert row.stop == speed.size


def test_a_stretch_that_is_too_short_is_passed_over_with_its_reason() -> None:
    curvature = np.concatenate((straight(40.0), turn(), straight(100.0)))
    found = survey(driven(curvature, at_speed(curvature)), manifest_of())
    assert len(found.rows) == 1
    (short,) = found.passed_over
    assert short.length == pytest.approx(40.0, abs=3.0)
    assert "60 m" in short.reason


def test_a_row_that_weaves_like_the_paper_s_first_version_is_one_row() -> None:
    # 5.8° of yaw range and 0.11 m of deviation: a wave of 7 m that bends by 0.046 1/m, yet the track is
    # straight.
    k = 2.0 * np.pi / 7.0
    s = SPEED * STEP * np.arange(2000)
    curvature = np.concatenate((-0.05 * k * k * np.sin(k * s), turn(), straight(80.0)))
    rows = find_rows(driven(curvature, at_speed(curvature), float(np.arctan(0.05 * k))), manifest_of())
    assert [r.direction for r in rows] == ["east", "west"]
    assert rows[0].length == pytest.approx(111.0, abs=4.0)


def test_a_turn_alone_holds_no_row() -> None:
    curvature = turn(angle=6.0 * np.pi)
    assert find_rows(driven(curvature, at_speed(curvature)), manifest_of()) == ()


def test_a_bend_of_more_than_ten_degrees_ends_a_row_however_gentle() -> None:
    gentle = np.full(round(60.0 / (SPEED * STEP)), np.deg2rad(30.0) / 60.0)
    curvature = np.concatenate((straight(120.0), gentle, straight(120.0)))
    rows = find_rows(driven(curvature, at_speed(curvature)), manifest_of())
    assert len(rows) == 2
    assert min(r.length for r in rows) > 115.0
    motion = driven(curvature, at_speed(curvature))
    for row in rows:
        off = motion.tractor.yaw[row.samples] - row.line.heading
        assert np.abs(off).max() <= np.deg2rad(10.0)


@given(st.floats(-np.pi, np.pi), st.floats(-3.0, 3.0))
def test_turning_the_field_turns_the_lines_and_changes_no_row(heading: float, weave: float) -> None:
    k = 2.0 * np.pi / 20.0
    s = SPEED * STEP * np.arange(2500)
    curvature = -0.01 * weave / 3.0 * k * np.sin(k * s)
    plain = find_rows(driven(curvature, at_speed(curvature)), manifest_of())
    turned = find_rows(driven(curvature, at_speed(curvature), heading), manifest_of())
    assert [(r.start, r.stop) for r in plain] == [(r.start, r.stop) for r in turned]
    change = turned[0].line.heading - plain[0].line.heading - heading
    assert (change + np.pi) % (2.0 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-9)
    assert turned[0].length == pytest.approx(plain[0].length, abs=1e-6)


def test_the_manifest_s_line_serves_a_row_in_either_direction_of_travel() -> None:
    motion = driven(straight(100.0), at_speed(straight(100.0)))
    for a, b in (((-10.0, 0.5), (150.0, 1.5)), ((150.0, 1.5), (-10.0, 0.5))):
        (row,) = find_rows(motion, with_line(motion, a, b))
        assert row.source == "manifest"
        assert row.line.heading == pytest.approx(np.arctan2(1.0, 160.0), abs=1e-4)


@pytest.mark.parametrize(("offset", "angle"), [(2.6, 0.0), (0.0, 6.0)])
def test_a_manifest_line_too_far_off_does_not_serve(offset: float, angle: float) -> None:
    motion = driven(straight(100.0), at_speed(straight(100.0)))
    rise = 50.0 * np.tan(np.deg2rad(angle))
    (row,) = find_rows(motion, with_line(motion, (0.0, offset - rise), (100.0, offset + rise)))
    assert row.source == "fitted"


def test_the_fitted_line_is_orthogonal_least_squares_and_does_not_care_for_axes() -> None:
    generator = np.random.default_rng(2)
    s = np.linspace(0.0, 100.0, 400)
    x, y = s + generator.normal(0, 0.3, s.size), 0.4 * s + generator.normal(0, 0.3, s.size)
    line = fit_line(x, y)
    # Independent: principal direction from the closed form ½·atan2(2·Sxy, Sxx − Syy).
    c = np.cov(x, y)
    assert line.heading == pytest.approx(0.5 * np.arctan2(2.0 * c[0, 1], c[0, 0] - c[1, 1]), abs=1e-12)
    _, n = line.project(x, y)
    assert np.mean(n) == pytest.approx(0.0, abs=1e-12)
    swapped = fit_line(y, x)
    assert swapped.heading == pytest.approx(np.pi / 2.0 - line.heading, abs=1e-12)


def norris() -> tuple[Floats, Floats]:
    """NIST StRD Norris: the data follow the line with 60 in its head; x is the second column."""
    lines = (Path(__file__).parent.parent / "oracles" / "nist_strd" / "Norris.dat").read_text().splitlines()
    y, x = np.array([[float(v) for v in line.split()] for line in lines[60:] if line.strip()]).T
    return x, y


def test_the_fitted_line_on_nist_norris_is_near_the_certified_regression() -> None:
    x, y = norris()
    line = fit_line(x[np.argsort(x)], y[np.argsort(x)])
    # Certified ordinary regression slope 1.00211681802045; with residual sd 0.88 on a range of 1000 the
    # orthogonal
    # line differs from it in the seventh digit.
    assert np.tan(line.heading) == pytest.approx(1.00211681802045, rel=2e-5)


def test_a_line_serves_by_its_own_distance_even_when_given_backwards() -> None:
    fitted = Line(np.array([0.0, 0.0]), np.array([100.0, 0.0]))
    given_line = Line(np.array([100.0, 1.9]), np.array([0.0, 1.9]))
    x = np.linspace(0.0, 100.0, 50)
    served = serving_line(given_line, fitted, x, np.zeros(50))
    assert served is not fitted
    assert served.heading == pytest.approx(0.0, abs=1e-12)


def test_runs_of_a_mask_are_its_unbroken_stretches() -> None:
    mask = np.array([True, True, False, True, False, False, True])
    assert runs(mask) == [(0, 2), (3, 4), (6, 7)]
    assert runs(np.zeros(3, dtype=bool)) == []
