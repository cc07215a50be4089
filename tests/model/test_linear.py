"""Modes, critical speed and frequency responses against closed forms and against time simulation."""

from __future__ import annotations

import numpy as np
import pytest
from model_samples import alone, frictionless, tandem, trailed
from smts_validate.model.inputs import Controls
from smts_validate.model.linear import critical_speed, linearise, require_stable
from smts_validate.model.machine import MachineError
from smts_validate.model.settings import SimulationSettings
from smts_validate.model.simulate import initial_state, simulate

LINEAR = SimulationSettings(tyre_law="linear", ackermann=False)
RELAXED = {f"tyres.{axle}.relaxation_length": 0.6 for axle in ("front", "rear", "seeder")}


def bicycle_state_matrix(machine, speed: float) -> np.ndarray:
    """Textbook single-track state matrix of (lateral velocity, yaw rate), e.g. Rajamani, chapter 2."""
    t, ratio = machine.tractor, np.sqrt(1.2)
    cf, cr = (2.0 * ratio * tyre.cornering_stiffness for tyre in (machine.tyres.front, machine.tyres.rear))
    lf, lr, m, j, v = t.front_axle, t.rear_axle, t.mass, t.yaw_inertia, speed
    return np.array(
        [
            [-(cf + cr) / (m * v), (cr * lr - cf * lf) / (m * v) - v],
            [(cr * lr - cf * lf) / (j * v), -(cf * lf**2 + cr * lr**2) / (j * v)],
        ]
    )


@pytest.mark.parametrize("speed", [1.0, 2.8, 12.0])
def test_tractor_alone_has_the_textbook_state_matrix(speed):
    machine = frictionless(alone())
    found = linearise(machine, speed, LINEAR).A
    expected = bicycle_state_matrix(machine, speed)
    # the wheels' half track couples yaw to the slip angle in second order only
    assert np.abs(found - expected).max() < 1e-6 * np.abs(expected).max()


def oversteering():
    """Rear tyres too soft for the load: understeer gradient negative."""
    return frictionless(alone()).replace_parameters(
        {"tyres.rear.cornering_stiffness": 30e3, "tyres.front.cornering_stiffness": 90e3}
    )


def test_critical_speed_of_an_oversteering_tractor_is_that_of_the_closed_form():
    machine = oversteering()
    loads, ratio = machine.wheel_loads(), np.sqrt(1.2)
    front, rear = (tyre.cornering_stiffness * ratio for tyre in (machine.tyres.front, machine.tyres.rear))
    gradient = (loads.front / front - loads.rear / rear) / 9.80665
    assert gradient < 0.0
    assert critical_speed(machine, LINEAR) == pytest.approx(
        np.sqrt(-machine.tractor.wheelbase / gradient), rel=1e-5
    )


def test_understeering_tractor_has_no_critical_speed():
    assert critical_speed(frictionless(alone()), LINEAR) is None


def test_speed_above_the_critical_is_refused_with_the_bound():
    machine = oversteering()
    bound = critical_speed(machine, LINEAR)
    require_stable(machine, 0.95 * bound, LINEAR)
    with pytest.raises(
        MachineError, match=rf"speed is .*below the critical speed of {bound:.2f} m/s"
    ) as caught:
        require_stable(machine, 1.05 * bound, LINEAR)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_small_disturbance_dies_below_the_critical_speed_and_grows_above(factor):
    machine = oversteering()
    speed = factor * critical_speed(machine, LINEAR)
    t = np.linspace(0.0, 20.0, 401)
    run = simulate(machine, Controls(t=t, speed=speed), initial_state(v=speed, yaw_rate1=1e-6), t, LINEAR)
    assert bool(abs(run.yaw_rate1[-1]) > 2e-6) is (factor > 1.0)


@pytest.mark.parametrize("machine", [trailed(), tandem(), trailed().replace_parameters(RELAXED)])
def test_small_motion_follows_the_eigenvalues(machine):
    """exp(A·t) of a small start equals the nonlinear run."""
    machine = machine.replace_parameters({"seeder.draft_angle_deg": 0.0})
    model, t = linearise(machine, 2.5), np.linspace(0.0, 2.0, 201)
    slips = len(model.states) - 4
    rate, sideways = 1e-4, 2e-4
    start = initial_state(v=2.5, v_lateral=sideways, yaw_rate1=rate, yaw_rate2=-rate, yaw2=-5e-5)
    run = simulate(machine, Controls(t=t, speed=2.5), start, t, SimulationSettings(step=0.0025))
    values, vectors = np.linalg.eig(model.A)
    x0 = np.concatenate(([sideways, rate, -rate, 5e-5], start_slips(machine, slips, sideways, rate)))
    modal = np.linalg.solve(vectors, x0.astype(complex))
    motion = (vectors @ (modal[:, None] * np.exp(values[:, None] * t))).real
    assert np.abs(motion[0] - run.v_lateral1).max() < 2e-3 * sideways
    assert np.abs(motion[1] - run.yaw_rate1).max() < 2e-3 * rate
    assert np.abs(motion[3] - (run.yaw1 - run.yaw2)).max() < 2e-3 * 5e-5


def start_slips(machine, count: int, sideways: float, rate: float) -> np.ndarray:
    """Slip angles of the wheels at the start, by the velocity of each contact point."""
    if count == 0:
        return np.zeros(0)
    t, s = machine.tractor, machine.seeder
    front, rear = sideways + rate * t.front_axle, sideways - rate * t.rear_axle
    hitch = sideways - rate * t.hitch + 2.5 * 5e-5
    axle = hitch + rate * (s.hitch_to_com + s.com_to_axle[0])
    return np.repeat([front, rear, axle], 2) / 2.5


@pytest.mark.parametrize("frequency", [0.1, 0.8])
def test_frequency_response_is_what_a_sinusoidal_run_shows(frequency):
    machine, model = trailed(), linearise(trailed(), 2.5)
    t = np.arange(0.0, 40.0, 0.01)
    controls = Controls(t=t, speed=np.full(t.size, 2.5), steer=1e-3 * np.sin(2 * np.pi * frequency * t))
    run = simulate(machine, controls, initial_state(v=2.5), t)
    late = t >= 20.0
    basis = np.exp(-2j * np.pi * frequency * t[late])
    response = model.frequency_response(frequency)[0, :, 0]
    for name, series in (
        ("yaw_rate1", run.yaw_rate1),
        ("yaw_rate2", run.yaw_rate2),
        ("lateral_acceleration1", run.ay1),
        ("lateral_acceleration2", run.ay2),
    ):
        found = (series[late] * basis).sum() / (controls.steer[late] * basis).sum()
        assert abs(found - response[model.outputs.index(name)]) < 3e-3 * abs(response).max()


def test_without_relaxation_the_slow_machine_has_no_oscillating_mode_and_with_it_it_has():
    assert not any(mode.oscillates for mode in linearise(trailed(), 2.5).modes())
    relaxed = linearise(trailed().replace_parameters(RELAXED), 2.5)
    assert any(mode.oscillates for mode in relaxed.modes())
    assert relaxed.least_damping() < linearise(trailed(), 2.5).least_damping()


def test_speed_of_zero_is_refused():
    with pytest.raises(MachineError, match=r"speed is 0\.0; it must be .* above 0"):
        linearise(trailed(), 0.0)
