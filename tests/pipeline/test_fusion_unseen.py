"""What no state of the filter holds: lever arms, mounting, crab; against the geometry of the two bodies."""

from __future__ import annotations

import numpy as np
import pytest
from smts_validate.pipeline.fusion import output, settings
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.unseen import Doubt, modes_of, place_doubt, slope_pull
from smts_validate.sensors.manifest import GRAVITY, parse
from synthetic_motion import RUN_TOML

HEIGHT = 2.1  # m
REAR, HITCH, COM2 = 1.2, 0.9, 2.7  # m
YAWS = np.array([0.0, 0.5 * np.pi, 2.0])
STATE = len(s.KEPT)


def parameters() -> np.ndarray:
    """A roof antenna over the centre of mass, and a seeder's levers."""
    p = np.zeros(s.P_SIZE)
    p[s.P_ANT_Z], p[s.P_REAR], p[s.P_HITCH], p[s.P_COM2] = HEIGHT, REAR, HITCH, COM2
    return p


def smooth(covariance: np.ndarray | None = None, bend: float = 0.0) -> output.Smooth:
    """Standing at YAWS, the seeder bent away by `bend`."""
    x, none = np.zeros((YAWS.size, s.SIZE)), np.zeros(YAWS.size)
    x[:, s.YAW1], x[:, s.YAW2] = YAWS, YAWS - bend
    P = np.zeros((STATE, STATE)) if covariance is None else covariance
    return output.Smooth(x, np.tile(P, (YAWS.size, 1, 1)), none, none, none, none)


def bodies(antenna: np.ndarray, yaw1: np.ndarray, yaw2: np.ndarray, slope: float) -> np.ndarray:
    """Both centres of mass and yaws (2, N, 3) under an antenna (2,) that leans downhill: rigid bodies on a hitch."""
    first = antenna + HEIGHT * slope * np.column_stack([-np.sin(yaw1), np.cos(yaw1)])
    hitch = first - (REAR + HITCH) * np.column_stack([np.cos(yaw1), np.sin(yaw1)])
    second = hitch - COM2 * np.column_stack([np.cos(yaw2), np.sin(yaw2)])
    return np.stack([np.column_stack([first, yaw1]), np.column_stack([second, yaw2])])


def test_on_a_straight_row_the_ground_tells_the_tilt_and_the_mounting_is_no_doubt() -> None:
    assert place_doubt(parameters(), 4e-5, 4e-5) == pytest.approx(settings.LEVER_SD)
    assert place_doubt(parameters(), 4e-5, 9e-5) == pytest.approx(settings.LEVER_SD)


def test_where_the_gyros_tell_the_tilt_their_mounting_moves_a_roof_antenna() -> None:
    told = place_doubt(parameters(), 4e-5, 1e-8)
    assert told == pytest.approx(np.hypot(settings.LEVER_SD, settings.MOUNT_SD * HEIGHT), rel=1e-3)
    assert settings.LEVER_SD < place_doubt(parameters(), 4e-5, 2e-5) < told


@pytest.mark.parametrize("bend", [0.0, 0.4])
def test_a_field_steeper_than_taken_moves_both_bodies_as_their_geometry_says(bend: float) -> None:
    slope, pull = 1e-4, (0.15, 0.25)
    at, place = smooth(bend=bend), np.array([3.0, -7.0])
    taken = bodies(place, YAWS, YAWS - bend, 0.0)
    true = bodies(place, YAWS + pull[0] * slope, YAWS - bend + pull[1] * slope, slope)
    found = modes_of(at, parameters(), Doubt(place=0.0, steep=slope, pull=pull), np.zeros(YAWS.size))
    # one unknown: the antenna leans downhill and the tyres give way downhill, and the seeder swings the other way
    for body, modes in enumerate((found.tractor, found.seeder)):
        np.testing.assert_allclose(modes.sum(axis=1), (true - taken)[body], rtol=2e-4, atol=1e-8)
    assert np.linalg.norm(found.seeder[0, :, :2].sum(axis=0)) < np.linalg.norm(
        found.tractor[0, :, :2].sum(axis=0)
    )


def test_the_crab_of_the_known_slope_moves_the_seeder_by_both_bodies_yaws() -> None:
    pull, slope = (0.15, 0.25), 1e-4
    found = modes_of(smooth(), parameters(), Doubt(place=0.0, pull=pull), np.full(YAWS.size, slope))
    level = bodies(np.zeros(2), YAWS, YAWS, 0.0)
    crabbed = bodies(np.zeros(2), YAWS + pull[0] * slope, YAWS + pull[1] * slope, 0.0)
    np.testing.assert_allclose(found.seeder.sum(axis=1), (crabbed - level)[1], rtol=2e-4, atol=1e-8)
    np.testing.assert_allclose(found.tractor.sum(axis=1), (crabbed - level)[0], rtol=2e-4, atol=1e-8)


def test_what_the_state_does_not_know_of_the_roll_is_a_crab_together_with_the_place_that_it_moves() -> None:
    # the antenna's place is known and the roll is not: place across and roll err together
    sd, pull = 0.004, (0.15, 0.25)
    P = np.zeros((STATE, STATE))
    k = output.K_ROLL
    P[k, k], P[output.K_Y, output.K_Y] = sd**2, (HEIGHT * sd) ** 2
    P[k, output.K_Y] = P[output.K_Y, k] = HEIGHT * sd**2
    at = smooth(P)
    modes = modes_of(at, parameters(), Doubt(place=0.0, pull=pull), np.zeros(YAWS.size))
    tractor = output.tractor_motion(at, parameters(), modes, None).covariance[0]
    seeder = output.seeder_motion(at, parameters(), modes, None).covariance[0]
    assert tractor[2, 2] == pytest.approx((pull[0] * sd) ** 2)
    assert seeder[2, 2] == pytest.approx((pull[1] * sd) ** 2)
    swung = HEIGHT - (REAR + HITCH) * pull[0] - COM2 * pull[1]
    assert seeder[1, 1] == pytest.approx((swung * sd) ** 2)
    assert seeder[1, 2] == pytest.approx(swung * pull[1] * sd**2)


def test_a_crab_that_stays_is_each_bodys_own() -> None:
    found = modes_of(smooth(), parameters(), Doubt(place=0.0, crab=(0.001, 0.002)), np.zeros(YAWS.size))
    C = np.einsum("nki,nkj->nij", found.seeder, found.seeder)[0]
    assert C[2, 2] == pytest.approx(0.002**2)
    assert C[1, 1] == pytest.approx(((REAR + HITCH) * 0.001) ** 2 + (COM2 * 0.002) ** 2)
    assert np.einsum("nki,nkj->nij", found.tractor, found.tractor)[0] == pytest.approx(
        np.diag([0, 0, 0.001**2])
    )


def test_the_seeders_pull_is_what_its_stated_weight_tyres_and_draft_give() -> None:
    machine = parse(RUN_TOML).machine
    assert slope_pull(machine)[0] == pytest.approx(GRAVITY * settings.COMPLIANCE)
    assert slope_pull(machine)[1] >= slope_pull(machine)[0]


def test_a_doubt_of_place_is_one_along_either_axis_of_both_bodies() -> None:
    at, p = smooth(), parameters()
    modes = modes_of(at, p, Doubt(place=0.01), np.zeros(YAWS.size))
    for motion in (output.tractor_motion, output.seeder_motion):
        C = motion(at, p, modes, None).covariance[:, :2, :2]
        np.testing.assert_allclose(C, np.tile(0.01**2 * np.eye(2), (YAWS.size, 1, 1)), rtol=1e-9, atol=1e-15)


def test_the_draws_place_errs_along_the_tractors_axes_on_both_bodies_alike() -> None:
    at, p, count = smooth(), parameters(), 4000
    modes = modes_of(at, p, Doubt(place=0.01), np.zeros(YAWS.size))
    draws = output.body_draws(
        np.zeros((YAWS.size, STATE, count)), at, p, True, modes, np.random.default_rng(0)
    )
    np.testing.assert_allclose(draws[:, :, :2], draws[:, :, 3:5], rtol=0, atol=1e-15)
    np.testing.assert_allclose(draws[:, :, :2].std(axis=0), 0.01, rtol=0.05)
    # ahead at yaw 0 is east, at a quarter turn north: one error of the machine, not one of the field
    np.testing.assert_allclose(draws[:, 0, 0], draws[:, 1, 1], rtol=0, atol=1e-15)
    np.testing.assert_allclose(draws[:, 0, 1], -draws[:, 1, 0], rtol=0, atol=1e-15)


def test_the_draws_scatter_by_the_stated_covariance_of_both_bodies_together() -> None:
    rng, count = np.random.default_rng(1), 40_000
    root = 0.01 * rng.standard_normal((STATE, STATE))
    at, p = smooth(root @ root.T, bend=0.2), parameters()
    doubt = Doubt(0.01, 0.0, 0.01, (0.004, 0.006), (0.15, 0.25))
    modes = modes_of(at, p, doubt, np.full(YAWS.size, 0.02))
    error = np.tile(root @ rng.standard_normal((STATE, count)), (YAWS.size, 1, 1))
    draws = output.body_draws(error, at, p, True, modes, rng)
    for body, motion in ((slice(0, 3), output.tractor_motion), (slice(3, 6), output.seeder_motion)):
        C = motion(at, p, modes, None).covariance[:, :3, :3]
        size = np.sqrt(np.einsum("nii->ni", C))
        seen = np.einsum("dni,dnj->nij", draws[:, :, body], draws[:, :, body]) / count
        np.testing.assert_allclose(
            seen / (size[:, :, None] * size[:, None, :]), C / (size[:, :, None] * size[:, None, :]), atol=0.03
        )
