"""The best steering angle and its stated deviation, against simulated truth."""

from __future__ import annotations

import numpy as np
import pytest
from smts_validate.pipeline.fusion.motion import BodyMotion, SteerInput
from smts_validate.pipeline.fusion.steering import UNDERSTEER, Steering, best_steering
from smts_validate.sensors.manifest import GRAVITY

DEG = np.pi / 180.0
AXLE = 1.45
STEP = 0.02


def gauss_markov(n: int, sd: float, tau: float, rng: np.random.Generator) -> np.ndarray:
    """A first-order process of a standard deviation and a correlation time (s), (n,)."""
    keep, out = np.exp(-STEP / tau), np.empty(n)
    out[0] = sd * rng.standard_normal()
    push = sd * np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
    for k in range(1, n):
        out[k] = keep * out[k - 1] + push[k]
    return out


def body_of(angle: np.ndarray, speed: float) -> BodyMotion:
    """A body whose front axle's velocity points `angle` (N,) off its heading, known exactly; it does not slip aside."""
    n, none = angle.size, np.zeros(angle.size)
    rate = speed * np.tan(angle) / AXLE
    covariance = np.zeros((n, 6, 6))
    return BodyMotion(none, none, none, np.full(n, speed), none, rate, covariance, none, none)


def straight(seed: int, slip: float, zero_sd: float = 0.3 * DEG) -> tuple[Steering, np.ndarray]:
    """A steered row of a minute whose front wheels slip by `slip` rad: the best angle and its error."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, STEP)
    true = gauss_markov(t.size, 0.8 * DEG, 1.5, rng)
    noise = 0.02 * DEG
    given = SteerInput(
        true + zero_sd * rng.standard_normal() + noise * rng.standard_normal(t.size), np.full(t.size, noise), 0.0,
        zero_sd, 0.0, "sensor",
    )  # fmt: skip
    body = body_of(true - gauss_markov(t.size, slip, 1.0, rng), 2.5)
    best = best_steering(t, body, given, AXLE, 0.002, np.zeros(t.size))
    return best, best.angle - true


@pytest.mark.parametrize("slip", [0.2 * DEG, 0.5 * DEG, 1.0 * DEG])
def test_the_front_wheels_slip_is_learnt_from_the_pass(slip: float) -> None:
    found = [straight(seed, slip)[0] for seed in range(6)]
    assert all(best.learnt for best in found)
    assert np.median([best.slip for best in found]) == pytest.approx(slip, rel=0.35)


@pytest.mark.parametrize("slip", [0.1 * DEG, 0.6 * DEG])
def test_on_a_row_the_angles_error_is_as_large_as_stated(slip: float) -> None:
    ratio = []
    for seed in range(40):
        best, error = straight(100 + seed, slip)
        ratio.append(np.mean((error / best.sd) ** 2))
    # a pass's error is little more than one draw of the zero: the mean of 40 squares is known to a quarter
    assert 0.5 < np.mean(ratio) < 1.5


def test_a_turn_alone_says_little_of_the_zero() -> None:
    # in a turn the front wheels slip to one side all along: half a degree of it is not the sensor's zero
    t = np.arange(0.0, 16.0, STEP)
    speed, radius = 1.6, 9.0
    path = np.full(t.size, np.arctan(AXLE / radius))
    given = SteerInput(path + 0.5 * DEG, np.full(t.size, 0.03 * DEG), 0.0, 0.3 * DEG, 0.01, "sensor")
    bend = np.full(t.size, 0.35)  # rad, of a seeder behind a tractor on that radius
    best = best_steering(t, body_of(path, speed), given, AXLE, 0.002, bend)
    true = given.angle  # the zero is none
    assert np.abs(best.angle - true).max() < 2.0 * best.sd.min()
    assert np.abs(best.angle - true).max() < 0.4 * DEG


def test_without_wheels_and_sensor_the_slip_of_the_front_wheels_is_the_doubt() -> None:
    t = np.arange(0.0, 10.0, STEP)
    best = best_steering(t, body_of(np.zeros(t.size), 2.5), None, AXLE, 0.002, np.zeros(t.size))
    assert not best.learnt
    np.testing.assert_allclose(best.sd, best.slip, rtol=1e-9)
    assert best.slip >= 0.002  # the front tyres, narrower and steered, slip at least as much as the rear ones
    standing = best_steering(t, body_of(np.zeros(t.size), 0.1), None, AXLE, 0.002, np.zeros(t.size))
    assert np.isnan(standing.sd).all()


def sloping(seed: int, there_and_back: bool) -> tuple[np.ndarray, np.ndarray]:
    """Error of the best angle and its deviation on a cross slope of 5 % where front tyres give way more or less."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 60.0, STEP)
    slope = np.where(t < 30.0, 0.05, -0.05 if there_and_back else 0.05)
    understeer = UNDERSTEER * rng.standard_normal()
    true = gauss_markov(t.size, 0.5 * DEG, 1.5, rng)
    noise, zero_sd = 0.02 * DEG, 1.0 * DEG
    given = SteerInput(
        true + zero_sd * rng.standard_normal() + noise * rng.standard_normal(t.size), np.full(t.size, noise), 0.0,
        zero_sd, 0.0, "sensor",
    )  # fmt: skip
    slipping = gauss_markov(t.size, 0.1 * DEG, 1.0, rng) + understeer * GRAVITY * slope
    tilted = (slope, np.full(t.size, 0.001))
    best = best_steering(t, body_of(true - slipping, 2.5), given, AXLE, 0.002, np.zeros(t.size), tilted)
    return best.angle - true, best.sd


def test_on_a_slope_the_angle_errs_by_what_front_tyres_give_way_more_and_says_so() -> None:
    ratio = [np.mean((error / sd) ** 2) for error, sd in (sloping(seed, False) for seed in range(40))]
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.5)
    one_way = np.median([sd for _, sd in (sloping(seed, False) for seed in range(5))])
    both_ways = np.median([sd for _, sd in (sloping(seed, True) for seed in range(5))])
    assert both_ways < 0.3 * one_way  # the slope changes sides with the heading, a zero does not
    assert np.median([np.std(error) for error, _ in (sloping(seed, True) for seed in range(5))]) < 0.1 * DEG
