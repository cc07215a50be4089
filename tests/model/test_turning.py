"""Steady turning against the closed form, and the limit of stiff tyres against kinematic models of others."""

from __future__ import annotations

import numpy as np
import pytest
from model_samples import alone, frictionless, trailed
from scipy.integrate import solve_ivp
from smts_validate.model.inputs import Controls
from smts_validate.model.linear import linearise
from smts_validate.model.settings import SimulationSettings
from smts_validate.model.simulate import initial_state, simulate

GRAVITY = 9.80665
LINEAR = SimulationSettings(tyre_law="linear", ackermann=False)
SPEED, STEER = 2.5, 0.002


def axle_stiffness(machine) -> tuple[float, float]:
    ratio = np.sqrt(0.12 / 0.10)
    return tuple(2.0 * ratio * tyre.cornering_stiffness for tyre in (machine.tyres.front, machine.tyres.rear))


def bicycle_yaw_gain(machine, speed: float) -> float:
    """r/δ = v/(L + v²/g·(N_f/C_f − N_r/C_r)) with axle loads N, hitch load included.

    In steady turning both bodies have the lateral acceleration v·r, so lateral axle forces share it as
    vertical loads share g (the hitch passes on m2·v·r·l6/(l5 + l6) at the hitch, as it does of the weight).
    """
    loads, (front, rear) = machine.wheel_loads(), axle_stiffness(machine)
    gradient = 2.0 * (loads.front / front - loads.rear / rear) / GRAVITY
    return speed / (machine.tractor.wheelbase + gradient * speed**2)


@pytest.mark.parametrize(
    "machine", [frictionless(trailed()), frictionless(alone())], ids=["trailed", "alone"]
)
@pytest.mark.parametrize("speed", [1.0, 2.5, 6.0])
def test_steady_yaw_rate_of_a_small_steering_angle_is_that_of_the_closed_form(machine, speed):
    t = np.linspace(0.0, 60.0, 601)
    controls = Controls(t=t, speed=np.full(t.size, speed), steer=np.full(t.size, STEER))
    run = simulate(machine, controls, initial_state(v=speed), t, LINEAR)
    expected = bicycle_yaw_gain(machine, speed) * STEER
    assert run.yaw_rate1[-1] == pytest.approx(expected, rel=2e-4)
    if machine.seeder:
        assert run.yaw_rate2[-1] == pytest.approx(expected, rel=2e-4)


def test_steady_hitch_angle_is_that_of_the_closed_form():
    machine = frictionless(trailed())
    t = np.linspace(0.0, 60.0, 601)
    controls = Controls(t=t, speed=np.full(t.size, SPEED), steer=np.full(t.size, STEER))
    run = simulate(machine, controls, initial_state(v=SPEED), t, LINEAR)
    loads, (_, rear) = machine.wheel_loads(), axle_stiffness(machine)
    rate = bicycle_yaw_gain(machine, SPEED) * STEER
    lateral = SPEED * rate / GRAVITY
    rear_slip, seeder_slip = (
        2.0 * load * lateral / stiffness
        for load, stiffness in (
            (loads.rear, rear),
            (loads.seeder[0], 2.0 * machine.tyres.seeder.cornering_stiffness),
        )
    )
    behind_axle = machine.tractor.hitch - machine.tractor.rear_axle
    length = machine.seeder.hitch_to_com + machine.seeder.com_to_axle[0]
    expected = rear_slip - seeder_slip + rate * (behind_axle + length) / SPEED
    assert (run.yaw1 - run.yaw2)[-1] == pytest.approx(expected, rel=1e-3)


def test_linear_model_has_the_closed_forms_steady_gain():
    for speed in (1.0, 2.5, 6.0):
        for machine in (frictionless(trailed()), frictionless(alone())):
            gain = linearise(machine, speed, LINEAR).steady_gain("yaw_rate1", "steer")
            assert gain == pytest.approx(bicycle_yaw_gain(machine, speed), rel=1e-6)


def stiff_and_narrow(factor: float):
    """Hitch on the rear axle and wheels close together, as in the single-track model; stiffness times
    factor."""
    base = frictionless(trailed())
    names = ("tyres.front", "tyres.rear", "tyres.seeder")
    values = {f"{name}.cornering_stiffness": 5e4 * factor for name in names}
    values |= {f"{name}.friction": 100.0 for name in names}
    values |= {"tractor.front_track": 1e-3, "tractor.rear_track": 1e-3, "seeder.track": 1e-3}
    return base.replace_parameters(values | {"tractor.hitch": base.tractor.rear_axle})


def commonroad_trailer(machine, controls: Controls, t: np.ndarray) -> np.ndarray:
    """Rear axle's x, y, yaw and the hitch angle of the kinematic single-track model with on-axle trailer of
    commonroad-vehicle-models (M. Althoff and G. Würsching, TUM), integrated by scipy."""
    from vehiclemodels.parameters_vehicle4 import parameters_vehicle4
    from vehiclemodels.vehicle_dynamics_kst import vehicle_dynamics_kst

    p = parameters_vehicle4()
    p.a, p.b = machine.tractor.front_axle, machine.tractor.rear_axle
    p.trailer.l_wb = machine.seeder.hitch_to_com + machine.seeder.com_to_axle[0]

    def rate(now, x):
        steer = float(np.interp(now, controls.t, controls.steer))
        f = vehicle_dynamics_kst([x[0], x[1], steer, SPEED, x[2], x[3]], [0.0, 0.0], p)
        return [f[0], f[1], f[4], f[5]]

    start = [-machine.tractor.rear_axle, 0.0, 0.0, 0.0]
    return solve_ivp(rate, (t[0], t[-1]), start, t_eval=t, rtol=1e-10, atol=1e-12).y


def test_stiff_tyres_approach_the_kinematic_tractor_and_trailer_of_commonroad():
    t = np.linspace(0.0, 12.0, 241)
    fine = np.linspace(0.0, 12.0, 1201)
    controls = Controls(t=fine, speed=SPEED, steer=0.25 * np.sin(0.5 * fine))
    gaps = []
    for factor in (1.0, 10.0, 100.0):
        machine = stiff_and_narrow(factor)
        expected = commonroad_trailer(machine, controls, t)
        settings = SimulationSettings(step=0.005, ackermann=False, speed_time_constant=0.02)
        l3 = machine.tractor.rear_axle
        run = simulate(machine, controls, initial_state(v=SPEED), t, settings)
        x, y = run.x1 - l3 * np.cos(run.yaw1), run.y1 - l3 * np.sin(run.yaw1)
        gaps.append(np.hypot(x - expected[0], y - expected[1]).max())
        assert np.abs(run.yaw2 - run.yaw1 - expected[3]).max() < 0.05 / factor + 2e-4
    assert gaps[0] > gaps[1] > gaps[2]
    assert gaps[2] < 5e-3
    assert np.abs(expected[1]).max() > 1.0


def test_low_speed_turning_circle_is_ackermanns():
    machine = frictionless(alone())
    t = np.linspace(0.0, 100.0, 1001)
    steer = 0.3
    controls = Controls(t=t, speed=np.full(t.size, 0.5), steer=np.full(t.size, steer))
    run = simulate(machine, controls, initial_state(v=0.5), t)
    rear_radius = run.v1[-1] / run.yaw_rate1[-1]
    k = machine.tractor.front_track / machine.tractor.wheelbase
    half = np.arctan(k / 2) - np.arcsin(k * np.cos(2 * steer) / np.sqrt(4 + k * k))
    inner = steer + half / 2
    expected = machine.tractor.wheelbase / np.tan(inner) + machine.tractor.front_track / 2
    assert rear_radius == pytest.approx(expected, rel=2e-3)
