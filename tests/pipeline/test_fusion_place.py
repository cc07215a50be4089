"""The doubt of place that no state of the filter holds."""

from __future__ import annotations

import numpy as np
import pytest
from smts_validate.pipeline.fusion import output, settings
from smts_validate.pipeline.fusion import state as s

HEIGHT = 2.1  # m


def parameters() -> np.ndarray:
    """A roof antenna over the centre of mass, everything else nought."""
    p = np.zeros(s.P_SIZE)
    p[s.P_ANT_Z] = HEIGHT
    return p


def test_on_a_straight_row_the_ground_tells_the_tilt_and_the_mounting_is_no_doubt() -> None:
    assert output.place_doubt(parameters(), 4e-5, 4e-5) == pytest.approx((settings.LEVER_SD,) * 2)
    assert output.place_doubt(parameters(), 4e-5, 9e-5) == pytest.approx((settings.LEVER_SD,) * 2)


def test_where_the_gyros_tell_the_tilt_their_mounting_moves_a_roof_antenna() -> None:
    told = output.place_doubt(parameters(), 4e-5, 1e-8)
    assert told == pytest.approx((np.hypot(settings.LEVER_SD, settings.MOUNT_SD * HEIGHT),) * 2, rel=1e-3)
    half = output.place_doubt(parameters(), 4e-5, 2e-5)
    assert settings.LEVER_SD < half[1] < told[1]


def test_a_field_of_unknown_steepness_leaves_the_track_in_doubt_to_the_side() -> None:
    ahead, left = output.place_doubt(parameters(), 4e-5, 4e-5, 0.01**2)
    assert ahead == pytest.approx(settings.LEVER_SD)
    assert left == pytest.approx(np.hypot(settings.LEVER_SD, 0.01 * HEIGHT))


def test_a_doubt_to_the_side_is_one_across_the_track() -> None:
    x = np.zeros((2, s.SIZE))
    x[:, s.YAW1] = [0.0, 2.0]
    none = np.zeros(2)
    at = output.Smooth(x, np.zeros((2, len(s.KEPT), len(s.KEPT))), none, none, none, none)
    for motion in (output.tractor_motion, output.seeder_motion):
        C = motion(at, parameters(), np.zeros((2, 1)), None, (0.01, 0.03)).covariance[:, :2, :2]
        for k, yaw in enumerate(x[:, s.YAW1]):
            ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
            assert ahead @ C[k] @ ahead == pytest.approx(0.01**2, rel=1e-6)
            assert left @ C[k] @ left == pytest.approx(0.03**2, rel=1e-6)


def test_the_draws_place_errs_along_the_tractors_axes_on_both_bodies_alike() -> None:
    nodes, count = 3, 4000
    x = np.zeros((nodes, s.SIZE))
    x[:, s.YAW1] = [0.0, 0.5 * np.pi, 2.0]
    none, still = np.zeros(nodes), np.zeros((nodes, 1))
    at = output.Smooth(x, np.zeros((nodes, len(s.KEPT), len(s.KEPT))), none, none, none, none)
    draws = output.body_draws(
        np.zeros((nodes, len(s.KEPT), count)),
        at,
        parameters(),
        True,
        (still, still),
        np.random.default_rng(0),
        (0.01, 0.01),
    )
    np.testing.assert_allclose(draws[:, :, :2], draws[:, :, 3:5], rtol=0, atol=1e-15)
    np.testing.assert_allclose(draws[:, :, :2].std(axis=0), 0.01, rtol=0.05)
    # ahead at yaw 0 is east, at a quarter turn north: one error of the machine, not one of the field
    np.testing.assert_allclose(draws[:, 0, 0], draws[:, 1, 1], rtol=0, atol=1e-15)
    np.testing.assert_allclose(draws[:, 0, 1], -draws[:, 1, 0], rtol=0, atol=1e-15)
