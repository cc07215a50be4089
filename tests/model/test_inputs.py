"""Noise, paths and the driver."""

from __future__ import annotations

import numpy as np
import pytest
from model_samples import trailed
from smts_validate.model.inputs import (
    Controls,
    Driver,
    ForceSeries,
    InputError,
    coloured_noise,
    path_from_curvature,
    straight_path,
)
from smts_validate.model.settings import SimulationSettings
from smts_validate.model.simulate import initial_state, simulate


def test_noise_has_the_stated_spread_and_correlation_and_follows_its_seed():
    noise = coloured_noise(np.random.default_rng(5), 400_000, 0.05, 3.0, 0.8)
    again = coloured_noise(np.random.default_rng(5), 400_000, 0.05, 3.0, 0.8)
    assert np.array_equal(noise, again)
    assert noise.std() == pytest.approx(3.0, rel=0.03)
    for lag in (4, 16):
        correlation = np.mean(noise[lag:] * noise[:-lag]) / 9.0
        assert correlation == pytest.approx(np.exp(-lag * 0.05 / 0.8), abs=0.03)


def test_noise_is_stationary_from_its_first_sample():
    first = [coloured_noise(np.random.default_rng(seed), 3, 0.05, 2.0, 5.0)[0] for seed in range(4000)]
    assert np.std(first) == pytest.approx(2.0, rel=0.05)


def test_path_of_constant_curvature_is_a_circle():
    path = path_from_curvature(np.full(1001, 0.1), 0.02)
    assert np.hypot(path.x, path.y - 10.0) == pytest.approx(10.0, rel=1e-6)
    assert path.yaw[-1] == pytest.approx(2.0)


def drive(path, driver, start, seconds=40.0, speed=2.5, step=0.01):
    t = np.arange(0.0, seconds, 0.02)
    controls = Controls(t=t, speed=np.full(t.size, speed), driver=driver, path=path)
    return simulate(trailed(), controls, start, t, SimulationSettings(step=step))


def test_driver_brings_the_machine_onto_a_slanting_line():
    heading = 2.3
    across = np.array([-np.sin(heading), np.cos(heading)])
    start = initial_state(x=5.0 + across[0], y=7.0 + across[1], yaw1=heading, v=2.5)
    machine = trailed().replace_parameters({"seeder.draft_angle_deg": 0.0})
    t = np.arange(0.0, 40.0, 0.02)
    controls = Controls(t=t, speed=2.5, driver=Driver(), path=straight_path(5.0, 7.0, heading))
    run = simulate(machine, controls, start, t)
    offset = (run.x1 - 5.0) * across[0] + (run.y1 - 7.0) * across[1]
    assert offset[0] == pytest.approx(1.0)
    assert abs(offset[-1]) < 1e-3
    assert run.v1[-1] > 2.4


def test_driver_follows_a_headland_turn_and_stays_within_his_limits():
    curvature = np.interp(np.arange(0.0, 90.0, 0.25), [0, 20, 24, 48, 52, 90], [0, 0, 0.1, 0.1, 0, 0])
    path = path_from_curvature(curvature, 0.25)
    driver = Driver(preview=4.0, max_rate=0.4, max_angle=0.5)
    run = drive(path, driver, initial_state(v=2.0), seconds=42.0, speed=2.0)
    offset = np.hypot(run.x1[:, None] - path.x, run.y1[:, None] - path.y).min(axis=1)
    assert offset.max() < 1.0
    assert np.abs(run.steer).max() <= 0.5 + 1e-12
    assert np.abs(np.diff(run.steer)).max() <= 0.4 * 0.02 + 1e-9
    assert run.yaw1[-1] == pytest.approx(path.yaw[-1], abs=0.1)


def test_driver_answers_after_his_delay():
    for delay in (0.1, 0.33, 0.6):
        run = drive(
            straight_path(), Driver(delay=delay, lag=0.0, max_rate=100.0), initial_state(v=2.5, y=1.0)
        )
        first = run.t[np.flatnonzero(run.steer != 0.0)[0]]
        assert delay - 0.02 <= first <= delay + 0.041


def test_longer_delay_damps_less():
    quick, slow = (
        drive(straight_path(), Driver(preview=5.0, delay=delay), initial_state(v=2.5, y=0.5)).y1
        for delay in (0.1, 0.9)
    )
    assert np.abs(slow[500:1200]).max() > 3.0 * np.abs(quick[500:1200]).max()


def test_drivers_decisions_do_not_depend_on_the_integration_step():
    coarse, fine = (
        drive(straight_path(), Driver(), initial_state(v=2.5, y=0.5), step=step) for step in (0.02, 0.005)
    )
    assert np.abs(coarse.y1 - fine.y1).max() < 1e-5
    assert np.abs(coarse.steer - fine.steer).max() < 1e-5


def test_steering_table_is_added_to_what_the_driver_does():
    t = np.arange(0.0, 20.0, 0.02)
    bias = np.full(t.size, 0.02)
    controls = Controls(t=t, speed=2.5, driver=Driver(), path=straight_path(), steer=bias)
    machine = trailed().replace_parameters({"seeder.draft_angle_deg": 0.0})
    run = simulate(machine, controls, initial_state(v=2.5), t)
    assert run.steer[0] == pytest.approx(0.02)
    assert run.y1[-1] > 0.05
    assert abs(run.steer[-1]) < 0.005


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Driver(preview=0.0), r"driver\.preview is 0\.0"),
        (lambda: Driver(delay=float("nan")), r"driver\.delay is nan"),
        (lambda: Controls(t=np.array([0.0, 1.0]), speed=1.0, driver=Driver()), "needs controls.path"),
        (lambda: ForceSeries(0.0, np.zeros((2, 6))), "spacing is 0.0"),
        (lambda: coloured_noise(np.random.default_rng(0), 3, 0.1, 1.0, 0.0), "correlation is 0.0"),
        (
            lambda: drive(straight_path(), Driver(period=0.015), initial_state(v=1.0)),
            "driver.period is 0.015 s",
        ),
    ],
)
def test_impossible_inputs_are_refused_in_one_line(make, message):
    with pytest.raises((InputError, ValueError), match=message) as caught:
        make()
    assert "\n" not in str(caught.value)
