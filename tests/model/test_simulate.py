"""Runs: order of convergence, an independent integrator, energy, symmetry, standstill, divergence,
batches."""

from __future__ import annotations

import ast
import dataclasses
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from model_samples import alone, frictionless, tandem, trailed
from scipy.integrate import solve_ivp
from smts_validate.model import dynamics
from smts_validate.model.dynamics import Instant
from smts_validate.model.inputs import (
    Controls,
    Driver,
    ForceSeries,
    InputError,
    coloured_noise,
    straight_path,
)
from smts_validate.model.machine import Machine, MachineError
from smts_validate.model.settings import SimulationSettings
from smts_validate.model.simulate import (
    SimulationError,
    halved_step_error,
    initial_state,
    simulate,
    simulate_batch,
)

ROLLING = initial_state(v=2.5)
RELAXED = {f"tyres.{axle}.relaxation_length": 0.5 for axle in ("front", "rear", "seeder")}


def weaving(seconds: float, spacing: float = 0.01, amplitude: float = 0.3) -> Controls:
    t = np.arange(0.0, seconds + spacing / 2, spacing)
    return Controls(t=t, speed=np.full(t.size, 2.5), steer=amplitude * np.sin(0.9 * t))


def rough(seconds: float, seed: int = 3) -> Controls:
    """Weaving over ground that pushes with kinks every 10 ms."""
    controls = weaving(seconds, amplitude=0.1)
    generator = np.random.default_rng(seed)
    sizes = (500.0, 800.0, 600.0, 300.0, 500.0, 600.0)
    columns = [coloured_noise(generator, controls.t.size, 0.01, sd, 0.2) for sd in sizes]
    return dataclasses.replace(controls, over_time=ForceSeries(0.01, np.stack(columns, axis=1)))


def plain_solution(machine: Machine, controls: Controls, t_out: np.ndarray, **options) -> np.ndarray:
    """The plain right-hand side under scipy's DOP853, restarted at every kink of the inputs."""
    settings, force = SimulationSettings(), controls.over_time
    slope = np.gradient(controls.speed, controls.t)

    def rate(t, state):
        disturbance = (0.0,) * 6
        if force is not None:
            disturbance = tuple(np.interp(t, controls.t, column) for column in force.values.T)
        steer, speed, acceleration = (
            float(np.interp(t, controls.t, series)) for series in (controls.steer, controls.speed, slope)
        )
        inputs = Instant(steer, speed, acceleration, disturbance)
        return dynamics.right_hand_side(machine, state, inputs, settings)

    state, states = ROLLING, [ROLLING]
    for start, stop in pairwise(t_out):
        state = solve_ivp(rate, (start, stop), state, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
        states.append(state)
    return np.array(states)


@pytest.mark.parametrize("make", [weaving, rough], ids=["smooth", "rough"])
def test_a_step_of_10_ms_agrees_with_dop853_on_the_plain_equations_within_a_micrometre(make):
    controls = make(1.0)
    expected = plain_solution(trailed(), controls, controls.t)
    run = simulate(trailed(), controls, ROLLING, controls.t)
    error = np.hypot(run.x1 - expected[:, 0], run.y1 - expected[:, 1])
    assert error.max() < 1e-6
    assert np.abs(run.yaw2 - expected[:, 3]).max() < 1e-6
    assert error.max() > 0.0  # not the same computation twice


@pytest.mark.parametrize(
    "machine", [trailed(), trailed().replace_parameters(RELAXED)], ids=["plain", "relaxed"]
)
def test_halving_the_step_divides_the_error_by_two_to_the_fourth(machine):
    controls = Controls(t=np.array([0.0, 8.0]), speed=2.5, steer=np.array([0.0, 0.4]))
    t = np.linspace(0.0, 8.0, 51)
    start = initial_state(v=2.5, yaw_rate1=0.1, yaw2=0.2)
    runs = [simulate(machine, controls, start, t, SimulationSettings(step=0.16 / n)) for n in (4, 8, 16, 64)]
    errors = [np.hypot(r.x2 - runs[-1].x2, r.y2 - runs[-1].y2).max() for r in runs[:-1]]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (orders > 3.6).all()
    assert (orders < 4.8).all()


def test_distance_disturbance_keeps_the_order_of_the_integrator():
    s = np.arange(0.0, 40.0, 0.5)
    smooth = np.stack([900.0 * np.sin(0.4 * s + k) for k in range(6)], axis=1)
    controls = Controls(t=np.array([0.0, 8.0]), speed=2.5, over_distance=ForceSeries(0.5, smooth))
    t = np.linspace(0.0, 8.0, 51)
    steps = (0.04, 0.02, 0.0025)
    runs = [simulate(trailed(), controls, ROLLING, t, SimulationSettings(step=h)) for h in steps]
    coarse, fine = (np.abs(r.y1 - runs[-1].y1).max() for r in runs[:-1])
    assert np.abs(runs[-1].y1).max() > 0.01
    assert fine < coarse < 1e-5


def test_halved_step_error_bounds_the_true_error_of_a_run():
    controls, t = weaving(8.0, spacing=0.08), np.linspace(0.0, 8.0, 101)
    settings = SimulationSettings(step=0.08)
    truth = simulate(trailed(), controls, ROLLING, t, SimulationSettings(step=0.0025))
    run = simulate(trailed(), controls, ROLLING, t, settings)
    true_error = np.hypot(run.x1 - truth.x1, run.y1 - truth.y1).max()
    estimate = halved_step_error(trailed(), controls, ROLLING, t, settings)
    assert estimate == pytest.approx(true_error, rel=0.3)


def test_adaptive_runge_kutta_and_cramers_rule_agree_with_fixed_steps():
    controls, t = weaving(10.0), np.linspace(0.0, 10.0, 501)
    fixed = simulate(trailed(), controls, ROLLING, t, SimulationSettings(step=0.0025))
    paper = SimulationSettings(integrator="dopri45", solver="cramer")
    adaptive = simulate(trailed(), controls, ROLLING, t, paper)
    assert np.hypot(adaptive.x1 - fixed.x1, adaptive.y1 - fixed.y1).max() < 1e-7
    assert np.abs(adaptive.yaw2 - fixed.yaw2).max() < 1e-7


def work_and_energy(machine: Machine, step: float) -> tuple[float, float]:
    """∫ Q·q̇ dt by Simpson's rule over a run, and the change of kinetic energy, J."""
    t = np.arange(0.0, 20.0 + step / 2, step)
    knots = np.array([0.0, 5.0, 15.0, 20.0])
    controls = Controls(t=knots, speed=2.5, steer=np.radians([0.0, 25.0, -25.0, 0.0]))
    run = simulate(machine, controls, ROLLING, t, SimulationSettings(step=step))
    cos, sin = np.cos(run.yaw1), np.sin(run.yaw1)
    velocity = cos * run.v1 - sin * run.v_lateral1, sin * run.v1 + cos * run.v_lateral1
    states = np.stack([run.x1, run.y1, run.yaw1, run.yaw2, *velocity, run.yaw_rate1, run.yaw_rate2], axis=1)
    power = []
    for now, state in zip(t, states, strict=True):
        inputs = Instant(float(np.interp(now, controls.t, controls.steer)), 2.5)
        power.append(dynamics.generalised_forces(machine, state, inputs) @ state[4:])
    power = np.array(power)
    work = step / 3.0 * (power[0] + power[-1] + 4.0 * power[1:-1:2].sum() + 2.0 * power[2:-1:2].sum())
    energies = [dynamics.kinetic_energy(machine, states[i]) for i in (0, -1)]
    return work, energies[1] - energies[0]


@pytest.mark.slow
def test_work_done_by_all_forces_is_the_change_of_kinetic_energy():
    gaps = []
    for step in (0.04, 0.02):
        work, energy = work_and_energy(trailed(), step)
        gaps.append(abs(work - energy))
    assert gaps[1] < 1e-2
    assert gaps[0] / gaps[1] > 10.0


@pytest.mark.parametrize("machine", [trailed(), tandem(), alone()], ids=["trailed", "tandem", "alone"])
def test_mirrored_steering_gives_the_mirrored_run(machine):
    values = {"seeder.draft_angle_deg": 0.0} if machine.seeder else {}
    machine, controls = machine.replace_parameters(values), weaving(10.0)
    left = simulate(machine, controls, ROLLING, controls.t)
    right = simulate(machine, dataclasses.replace(controls, steer=-controls.steer), ROLLING, controls.t)
    assert np.allclose(left.x1, right.x1, atol=1e-9)
    assert np.allclose(left.y1, -right.y1, atol=1e-9)
    assert np.abs(left.y1).max() > 1.0
    if machine.seeder:
        assert np.allclose(left.yaw2, -right.yaw2, atol=1e-9)


def test_turned_field_gives_the_turned_run():
    controls, turn = rough(10.0), 2.1
    east = simulate(trailed(), controls, ROLLING, controls.t)
    other = simulate(trailed(), controls, initial_state(yaw1=turn, v=2.5), controls.t)
    assert np.allclose(other.x2, np.cos(turn) * east.x2 - np.sin(turn) * east.y2, atol=1e-9)
    assert np.allclose(other.yaw1, east.yaw1 + turn, atol=1e-10)
    assert np.allclose(other.ay1, east.ay1, atol=1e-9)


def test_accelerations_of_both_bodies_are_the_derivatives_of_their_velocities():
    controls = weaving(10.0)
    fine = SimulationSettings(step=0.002)
    run = simulate(trailed(), controls, initial_state(v=2.5, yaw2=0.3), controls.t, fine)
    for n in ("1", "2"):
        x, y, yaw = (getattr(run, name + n) for name in ("x", "y", "yaw"))
        ax, ay = (np.gradient(np.gradient(series, run.t), run.t) for series in (x, y))
        lateral = np.cos(yaw) * ay - np.sin(yaw) * ax
        assert np.abs(lateral - getattr(run, "ay" + n))[50:-2].max() < 2e-3
        v = np.cos(yaw) * np.gradient(x, run.t) + np.sin(yaw) * np.gradient(y, run.t)
        assert np.abs(v - getattr(run, "v" + n))[50:-2].max() < 1e-3


def test_hitch_holds_the_bodies_together():
    controls, machine = rough(20.0), trailed()
    run = simulate(machine, controls, initial_state(v=2.5, yaw2=0.5), controls.t)
    l4, l5 = machine.tractor.hitch, machine.seeder.hitch_to_com
    front = run.x1 - l4 * np.cos(run.yaw1), run.y1 - l4 * np.sin(run.yaw1)
    back = run.x2 + l5 * np.cos(run.yaw2), run.y2 + l5 * np.sin(run.yaw2)
    assert np.abs(np.array(front) - np.array(back)).max() < 1e-12


def test_speed_is_held_on_the_straight_and_through_a_turn():
    t = np.arange(0.0, 30.0, 0.01)
    steer = np.where(t < 15.0, 0.0, 0.35)
    run = simulate(trailed(), Controls(t=t, speed=2.5, steer=steer), ROLLING, t)
    assert abs(run.v1[1400] - 2.5) < 1e-3
    assert abs(run.v1[-1] - 2.5) < 0.1


def test_rear_wheel_drive_moves_the_run_and_all_wheel_drive_does_not_stand_still():
    controls = weaving(10.0)
    everything = simulate(trailed(), controls, ROLLING, controls.t)
    rear = simulate(trailed().replace_parameters({"tractor.driven": "rear"}), controls, ROLLING, controls.t)
    assert 1e-3 < np.abs(everything.y1 - rear.y1).max() < 5.0
    assert everything.x1[-1] > 15.0


@pytest.mark.parametrize(
    "machine", [trailed(), trailed().replace_parameters(RELAXED)], ids=["plain", "relaxed"]
)
def test_machine_comes_to_rest_stays_there_and_starts_backwards(machine):
    t = np.arange(0.0, 25.0, 0.01)
    speed = np.interp(t, [0, 5, 8, 20, 23, 25], [2.5, 2.5, 0.0, 0.0, -1.0, -1.0])
    run = simulate(machine, Controls(t=t, speed=speed, steer=np.full(t.size, 0.2)), ROLLING, t)
    resting = (t > 11.0) & (t < 19.0)
    assert run.diverged_at is None
    assert np.ptp(run.x1[resting]) < 0.02
    assert np.abs(run.yaw_rate2[resting]).max() < 1e-3
    assert run.v1[-1] == pytest.approx(-1.0, abs=0.2)


def test_standing_machine_is_not_moved_by_steering():
    t = np.arange(0.0, 5.0, 0.01)
    run = simulate(trailed(), Controls(t=t, speed=0.0, steer=0.5 * np.sin(t)), initial_state(), t)
    assert np.hypot(run.x1, run.y1).max() < 1e-9


def test_tractor_alone_has_no_second_body_and_feels_no_force_on_one():
    controls = rough(5.0)
    half = controls.over_time.values.copy()
    half[:, 3:] = 0.0
    pushed = simulate(alone(), controls, ROLLING, controls.t)
    without = dataclasses.replace(controls, over_time=ForceSeries(0.01, half))
    calm = simulate(alone(), without, ROLLING, controls.t)
    assert pushed.x2 is None
    assert pushed.ay2 is None
    assert np.array_equal(pushed.y1, calm.y1)
    assert np.abs(pushed.y1).max() > 0.0


def test_disturbance_moves_the_body_by_impulse_over_mass():
    machine = frictionless(alone()).replace_parameters(
        {"tyres.front.cornering_stiffness": 1e-6, "tyres.rear.cornering_stiffness": 1e-6}
    )
    push = np.zeros((301, 6))
    push[100:201, 1], push[100:201, 2] = 480.0, 860.0
    t = np.linspace(0.0, 3.0, 301)
    run = simulate(machine, Controls(t=t, speed=0.0, over_time=ForceSeries(0.01, push)), initial_state(), t)
    assert run.yaw_rate1[-1] == pytest.approx(860.0 * 1.01 / 8600.0, rel=1e-6)
    assert np.hypot(run.v1, run.v_lateral1)[-1] == pytest.approx(480.0 * 1.01 / 4800.0, rel=2e-2)


def test_a_run_that_diverges_says_when_and_keeps_what_it_has():
    unstable = trailed().replace_parameters(
        {"tyres.rear.cornering_stiffness": 1e3, "tyres.rear.friction": 1e9, "tyres.front.friction": 1e9}
    )
    t = np.arange(0.0, 60.0, 0.01)
    spin = ForceSeries(1.0, np.array([[0.0, 0.0, 0.0, 0, 0, 0], [0.0, 0.0, 1e8, 0, 0, 0]]))
    controls = Controls(t=t, speed=10.0, steer=np.full(t.size, 0.3), over_time=spin)
    run = simulate(unstable, controls, initial_state(v=10.0), t, SimulationSettings(tyre_law="linear"))
    assert run.diverged_at is not None
    assert 0.0 < run.diverged_at < 60.0
    assert run.t[-1] < run.diverged_at <= run.t[-1] + 0.011
    assert np.isfinite(run.x1).all()


def test_batch_runs_equal_single_runs_with_their_own_start_offset_and_machine():
    controls = rough(20.0)
    machines = [trailed(), trailed().replace_parameters({"seeder.hitch_to_com": 3.2})]
    start = np.array([2.0, 5.0])
    batch = simulate_batch(
        machines, controls, np.stack([ROLLING, initial_state(v=2.5, y=0.4)]), 201, 0.02,
        start=start, steer_offset=[0.0, 0.01], steer_scale=[1.0, 0.9],
    )  # fmt: skip
    shifted = dataclasses.replace(controls, steer=0.9 * controls.steer + 0.01)
    t = start[1] + 0.02 * np.arange(201)
    single = simulate(machines[1], shifted, initial_state(v=2.5, y=0.4), t)
    assert np.allclose(batch.y2[1], single.y2, atol=1e-12)
    assert np.allclose(batch.t[1], t)
    assert not np.allclose(batch.y2[0], batch.y2[1], atol=0.1)


def test_batch_chooses_its_row_of_steering_and_of_disturbance():
    controls = weaving(4.0)
    two = np.stack([controls.steer, -controls.steer])
    force = np.zeros((2, 2, 6))
    force[1, :, 1] = 2000.0
    both = dataclasses.replace(controls, steer=two, over_distance=ForceSeries(100.0, force))
    batch = simulate_batch(
        trailed(), both, np.stack([ROLLING] * 3), 101, 0.02, steer_row=[0, 1, 0], force_row=[0, 0, 1]
    )
    assert batch.y1[0, -1] > 0.0 > batch.y1[1, -1]
    assert batch.y1[2, -1] > batch.y1[0, -1] + 0.02


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tractor.mass": -4800.0}, r"tractor\.mass is -4800\.0; it must be .* above 0"),
        ({"tractor.mass": float("nan")}, r"tractor\.mass is nan"),
        ({"tractor.front_axle": 0.0}, r"tractor\.front_axle is 0\.0; it must be .* above 0"),
        (
            {"tractor.hitch": 4.0, "seeder.com_to_axle": 30.0},
            r"seeder\.com_to_axle is 30 m, .* front wheels without load",
        ),
        ({"seeder.com_to_axle": -2.7}, r"com_to_axle is -2\.7 m, .* above -seeder\.hitch_to_com = -2\.7"),
        ({"tyres.rear.friction": 0.0}, r"tyres\.rear\.friction is 0\.0; it must be .* above 0"),
        ({"tyres.front.cornering_stifness": 1.0}, r"did you mean `cornering_stiffness`"),
        ({"tyre_pressure_mpa": 0.0}, r"tyre_pressure_mpa is 0\.0"),
        ({"seeder.com_to_axle.3": 0.1}, r"seeder\.com_to_axle\.3: unknown parameter"),
    ],
)
def test_impossible_machine_is_refused_in_one_line_that_names_parameter_and_bound(change, message):
    with pytest.raises(MachineError, match=message) as caught:
        trailed().replace_parameters(change)
    assert "\n" not in str(caught.value)


def test_seeder_parameter_of_a_tractor_alone_is_refused():
    with pytest.raises(MachineError, match="no seeder"):
        alone().replace_parameters({"seeder.mass": 1.0})


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SimulationSettings(step=0.0), "settings.step is 0.0"),
        (lambda: SimulationSettings(tyre_law="magic"), "must be one of linear, tanh, fiala"),
        (lambda: SimulationSettings(equations="right"), "settings.equations is 'right'"),
        (lambda: Controls(t=np.array([0.0, 0.0]), speed=1.0), "increasing"),
        (lambda: Controls(t=np.array([0.0, 1.0]), speed=np.array([1.0, np.nan])), "not finite"),
        (lambda: ForceSeries(0.1, np.zeros((4, 5))), "6 columns"),
        (lambda: simulate(trailed(), weaving(1.0), ROLLING, np.array([0.0, 0.1, 0.3])), "equally spaced"),
        (lambda: simulate(trailed(), weaving(1.0), ROLLING * np.nan, np.array([0.0, 0.1])), "initial"),
    ],
)
def test_unusable_input_is_refused_in_one_line(make, message):
    with pytest.raises((InputError, SimulationError, ValueError), match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_parameters_are_read_back_by_the_names_they_are_replaced_by():
    machine = tandem().replace_parameters({"seeder.com_to_axle.1": 1.1, "tyre_pressure_mpa": 0.2})
    assert machine.seeder.com_to_axle == (0.1, 1.1)
    assert machine.parameter("seeder.com_to_axle") == pytest.approx(0.6)
    assert machine.parameter("tyre_pressure_mpa") == 0.2


def test_static_loads_carry_the_whole_weight_and_no_moment():
    for machine in (trailed(), tandem()):
        loads, t, s = machine.wheel_loads(), machine.tractor, machine.seeder
        weight = 9.80665 * (t.mass + s.mass)
        assert 2.0 * (loads.front + loads.rear + sum(loads.seeder)) == pytest.approx(weight)
        axles = zip(loads.seeder, s.com_to_axle, strict=True)
        about_hitch = sum(2.0 * n * (s.hitch_to_com + a) for n, a in axles)
        assert about_hitch == pytest.approx(9.80665 * s.mass * s.hitch_to_com)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ({"force_row": [0, 2]}, "force_row must lie between 0 and 0"),
        ({"steer_row": [0, 1]}, "steer_row must lie between 0 and 0"),
        ({"machines": [trailed()] * 3}, "machines has 3 entries for 2 runs"),
        ({"machines": [trailed(), alone()]}, "all have a seeder or none"),
        ({"initial": ROLLING}, r"initial has shape \(8,\)"),
    ],
)
def test_batches_that_do_not_fit_together_are_refused(choice, message):
    arguments = {"machines": trailed(), "initial": np.stack([ROLLING] * 2)} | choice
    with pytest.raises(SimulationError, match=message):
        simulate_batch(controls=rough(1.0), samples=3, spacing=0.1, **arguments)


def test_times_in_utc_seconds_give_the_run_of_times_from_zero():
    controls, utc = rough(20.0), 1_747_303_260.0
    shifted = dataclasses.replace(
        controls, t=utc + controls.t, over_time=dataclasses.replace(controls.over_time, start=utc)
    )
    starts = np.array([0.0, 7.34])
    state = np.stack([ROLLING] * 2)
    one = simulate_batch(trailed(), controls, state, 500, 0.02, start=starts)
    other = simulate_batch(trailed(), shifted, state, 500, 0.02, start=utc + starts)
    assert np.abs(one.y2 - other.y2).max() < 1e-5
    assert np.abs(other.t - utc - one.t).max() < 1e-6


UNCOMPILED = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from test_simulate import DRIVEN, RELAXED, initial_state, simulate, trailed
machine = trailed().replace_parameters(RELAXED)
run = simulate(machine, DRIVEN, initial_state(y=0.3, v=2.5), np.arange(0.0, 0.4, 0.02))
print([float(v[-1]) for v in (run.x1, run.y2, run.yaw_rate2, run.ay1, run.steer)])
"""
DRIVEN = dataclasses.replace(rough(1.0), driver=Driver(delay=0.05), path=straight_path())


@pytest.mark.slow
def test_compiled_run_equals_its_uncompiled_self():
    machine = trailed().replace_parameters(RELAXED)
    run = simulate(machine, DRIVEN, initial_state(y=0.3, v=2.5), np.arange(0.0, 0.4, 0.02))
    done = subprocess.run(
        [sys.executable, "-c", UNCOMPILED, str(Path(__file__).parent)],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    plain = ast.literal_eval(done.stdout)
    compiled = [run.x1[-1], run.y2[-1], run.yaw_rate2[-1], run.ay1[-1], run.steer[-1]]
    assert run.steer[-1] != 0.0
    assert plain == pytest.approx(compiled, rel=1e-9)
