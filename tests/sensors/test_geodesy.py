"""The tangent plane: against radii of curvature, round trips, and lines against plane geometry."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smts_validate.sensors.geodesy import Line, to_enu, to_geodetic

ORIGIN = SimpleNamespace(lat=50.0431, lon=36.4902, alt=148.5)
metres = st.floats(-2000.0, 2000.0)


def test_a_small_step_is_the_radii_of_curvature_times_the_angle() -> None:
    a, e2 = 6378137.0, 6.69437999014e-3
    sin2 = math.sin(math.radians(ORIGIN.lat)) ** 2
    meridian = a * (1 - e2) / (1 - e2 * sin2) ** 1.5 + ORIGIN.alt
    normal = a / math.sqrt(1 - e2 * sin2) + ORIGIN.alt
    step = 1e-5
    e, n, _ = to_enu([ORIGIN.lat + step, ORIGIN.lat], [ORIGIN.lon, ORIGIN.lon + step], [148.5, 148.5], ORIGIN)
    assert n[0] == pytest.approx(meridian * math.radians(step), rel=1e-6)
    assert e[1] == pytest.approx(normal * math.cos(math.radians(ORIGIN.lat)) * math.radians(step), rel=1e-6)


@given(metres, metres, st.floats(-100.0, 100.0))
def test_there_and_back_is_where_it_was(e: float, n: float, u: float) -> None:
    lat, lon, alt = to_geodetic([e], [n], [u], ORIGIN)
    back = to_enu(lat, lon, alt, ORIGIN)
    assert [float(x[0]) for x in back] == pytest.approx([e, n, u], abs=2e-6)


def test_the_callers_arrays_are_left_alone() -> None:
    given_arrays = [np.array([10.0, 20.0]), np.array([1.0, 2.0]), np.array([0.5, 0.5])]
    kept = [array.copy() for array in given_arrays]
    to_geodetic(*given_arrays, ORIGIN)
    to_enu(np.array([50.0]), np.array([36.0]), np.array([100.0]), ORIGIN)
    assert all(np.array_equal(a, b) for a, b in zip(given_arrays, kept, strict=True))


def test_an_unknown_position_stays_unknown() -> None:
    e, n, u = to_enu([np.nan, ORIGIN.lat], [np.nan, ORIGIN.lon], [np.nan, ORIGIN.alt], ORIGIN)
    assert np.isnan([e[0], n[0], u[0]]).all()
    assert [e[1], n[1], u[1]] == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)


def test_a_line_measures_along_and_to_the_left() -> None:
    line = Line(np.array([1.0, 1.0]), np.array([1.0, 11.0]))
    s, n = line.project(np.array([0.0, 3.0]), np.array([5.0, 1.0]))
    assert s == pytest.approx([4.0, 0.0])
    assert n == pytest.approx([1.0, -2.0])
    assert line.heading == pytest.approx(math.pi / 2)
    assert line.length == 10.0


@given(st.floats(-3.1, 3.1), metres, metres)
def test_turning_the_field_leaves_deviations_as_they_are(angle: float, x: float, y: float) -> None:
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    a, b, point = np.array([3.0, 4.0]), np.array([50.0, -20.0]), np.array([x, y])
    plain = Line(a, b).project(point[0], point[1])
    px, py = turn @ point
    turned = Line(turn @ a, turn @ b).project(px, py)
    assert np.allclose(plain, turned, atol=1e-9 * (1.0 + abs(x) + abs(y)))


@pytest.mark.parametrize("b", [[1.0, 1.0], [np.nan, 2.0], [1.0, 2.0, 3.0]])
def test_a_line_needs_two_distinct_points(b: list[float]) -> None:
    with pytest.raises(ValueError, match="two distinct finite points"):
        Line(np.array([1.0, 1.0]), np.array(b))
