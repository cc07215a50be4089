"""M, h and Q against a symbolic derivation; compiled against plain; Cramer against elimination."""

from __future__ import annotations

import dataclasses

import lagrange_oracle as oracle
import numpy as np
import pytest
from model_samples import alone, frictionless, random_states, tandem, trailed
from smts_validate.model import _layout as at
from smts_validate.model import dynamics
from smts_validate.model._kernels import derivative
from smts_validate.model._packing import pack_controls, pack_machine, pack_options
from smts_validate.model._steering import load_inputs
from smts_validate.model.dynamics import Instant
from smts_validate.model.inputs import Controls, ForceSeries
from smts_validate.model.settings import SimulationSettings

DISTURBANCE = (300.0, -700.0, 900.0, -200.0, 400.0, -600.0)
PRINTED = SimulationSettings(equations="as_printed")


@pytest.mark.parametrize("state", random_states(20))
def test_mass_matrix_and_quadratic_terms_are_those_of_lagranges_equations(state):
    machine = trailed()
    mass, h = oracle.mass_matrix(machine, state), oracle.quadratic_terms(machine, state)
    assert np.abs(dynamics.mass_matrix(machine, state) - mass).max() < 1e-14 * np.abs(mass).max()
    assert np.abs(dynamics.quadratic_terms(machine, state) - h).max() < 1e-13 * max(np.abs(h).max(), 1.0)


@pytest.mark.parametrize("machine", [trailed(), tandem()], ids=["single axle", "tandem"])
@pytest.mark.parametrize("steer", [0.4, 0.0, -0.25])
def test_accelerations_are_those_of_the_symbolic_derivation_with_every_force(machine, steer):
    inputs = Instant(steer, 2.5, 0.3, DISTURBANCE)
    for state in random_states(20, seed=2):
        expected = oracle.accelerations(machine, state, steer, 2.5, 0.3, DISTURBANCE)
        found = dynamics.right_hand_side(machine, state, inputs)[4:]
        assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()


def compiled_right_hand_side(machine, state, inputs, settings, slips=None):
    """The kernel's rate of the state; slips fill the relaxed slip states."""
    force = ForceSeries(1.0, np.array([inputs.disturbance, inputs.disturbance]))
    speeds = inputs.speed + inputs.acceleration * np.array([-0.5, 0.5])
    controls = Controls(
        t=np.array([-0.5, 0.5]), speed=speeds, over_time=dataclasses.replace(force, start=-0.5)
    )
    tables = pack_controls(controls, 1.0)
    p, u, rate = pack_machine(machine, settings), np.zeros(at.INPUT_SIZE), np.zeros(at.FULL_SIZE)
    change = np.zeros(at.CHANGE_SIZE)
    change[at.SPEED_SCALE] = u[at.FORCE_FACTOR] = 1.0
    load_inputs(0.5, inputs.steer, p, change, tables, u)
    full = np.zeros(at.FULL_SIZE)
    full[:8] = state
    if slips is not None:
        full[at.SLIP : at.SLIP + len(slips)] = slips
    derivative(full, p, u, tables.distance_force[0], tables.spacing, pack_options(settings), rate)
    return rate[:8]


@pytest.mark.parametrize("machine", [trailed(), tandem(), alone()], ids=["trailed", "tandem", "alone"])
@pytest.mark.parametrize(
    "choice",
    [
        {},
        {"tyre_law": "linear"},
        {"tyre_law": "fiala"},
        {"equations": "as_printed"},
        {"solver": "cramer"},
        {"friction_ellipse": True},
        {"draft_direction": "axis"},
        {"ackermann": False},
        {"speed_time_constant": 2.0, "equations": "as_printed", "solver": "cramer", "tyre_law": "fiala"},
    ],
    ids=str,
)
def test_compiled_right_hand_side_equals_the_plain_one(machine, choice):
    settings = SimulationSettings(**choice)
    disturbance = DISTURBANCE if machine.seeder else (*DISTURBANCE[:3], 0.0, 0.0, 0.0)
    inputs = Instant(0.3, 2.5, -0.2, disturbance)
    for state in random_states(20, seed=3):
        if machine.seeder is None:
            state[[3, 7]] = 0.0
        plain = dynamics.right_hand_side(machine, state, inputs, settings)
        compiled = compiled_right_hand_side(machine, state, inputs, settings)
        assert np.abs(compiled - plain).max() < 1e-11 * np.abs(plain).max()


def test_relaxed_slips_take_the_place_of_rolling_ones_in_both_right_hand_sides():
    lengths = {f"tyres.{axle}.relaxation_length": 0.6 for axle in ("front", "rear", "seeder")}
    machine, slips = trailed().replace_parameters(lengths), [0.02, -0.03, 0.01, 0.05, -0.04, 0.03]
    inputs, settings = Instant(0.1, 2.5), SimulationSettings()
    for state in random_states(10, seed=4):
        plain = dynamics.right_hand_side(machine, state, inputs, settings, slips)
        compiled = compiled_right_hand_side(machine, state, inputs, settings, slips)
        assert np.abs(compiled - plain).max() < 1e-11 * np.abs(plain).max()


def test_determinant_has_the_closed_form_that_never_vanishes():
    machine = trailed()
    t, s = machine.tractor, machine.seeder
    for state in random_states(20, seed=5):
        sine = np.sin(state[2] - state[3])
        both, product = t.mass + s.mass, t.mass * s.mass
        levers = t.yaw_inertia * s.hitch_to_com**2 + s.yaw_inertia * t.hitch**2
        closed = (
            both**2 * t.yaw_inertia * s.yaw_inertia
            + both * product * levers
            + (product * t.hitch * s.hitch_to_com * sine) ** 2
        )
        assert np.linalg.det(dynamics.mass_matrix(machine, state)) == pytest.approx(closed, rel=1e-10)
        assert closed > 0.0


def test_as_printed_differs_by_the_missing_cosine_and_the_missing_quadratic_terms_only():
    machine, state = trailed(), random_states(1, seed=6)[0]
    difference = dynamics.mass_matrix(machine, state, PRINTED) - dynamics.mass_matrix(machine, state)
    product = machine.seeder.mass * machine.tractor.hitch * machine.seeder.hitch_to_com
    expected = np.zeros((4, 4))
    expected[2, 3] = product * (1.0 - np.cos(state[2] - state[3]))
    assert np.allclose(difference, expected, atol=1e-9)
    assert not dynamics.quadratic_terms(machine, state, PRINTED).any()


@pytest.mark.parametrize("state", random_states(10, seed=7))
def test_kinetic_energy_changes_at_the_power_of_the_forces(state):
    machine, inputs = trailed(), Instant(0.3, 2.5, 0.1, DISTURBANCE)
    rate = dynamics.right_hand_side(machine, state, inputs)
    power = dynamics.generalised_forces(machine, state, inputs) @ state[4:]
    assert oracle.energy_rate(machine, state, rate[4:]) == pytest.approx(power, rel=1e-9)


def test_equations_as_printed_break_the_energy_balance_of_free_motion():
    machine, state = frictionless(trailed()), np.array([0.0, 0.0, 0.0, -0.8, 3.0, 0.5, 0.7, -0.5])
    exact = SimulationSettings()
    for settings, holds in ((exact, True), (PRINTED, False)):
        free = -dynamics.quadratic_terms(machine, state, settings)
        accelerations = np.linalg.solve(dynamics.mass_matrix(machine, state, settings), free)
        power = oracle.energy_rate(machine, state, accelerations)
        assert (abs(power) < 1e-9 * dynamics.kinetic_energy(machine, state)) is holds


def test_mirrored_state_and_steering_give_mirrored_accelerations():
    machine = trailed().replace_parameters({"seeder.draft_angle_deg": 0.0})
    mirror = np.array([1.0, -1.0, -1.0, -1.0] * 2)
    turned = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    for state in random_states(10, seed=8):
        one = dynamics.right_hand_side(machine, state, Instant(0.2, 2.5, 0.0, DISTURBANCE))
        other = dynamics.right_hand_side(
            machine, state * mirror, Instant(-0.2, 2.5, 0.0, tuple(np.array(DISTURBANCE) * turned))
        )
        assert np.abs(other - one * mirror).max() < 1e-12 * np.abs(one).max()


def test_front_angles_meet_on_the_rear_axles_line():
    steer = np.linspace(-0.7, 0.7, 29)
    left, right = dynamics.ackermann_angles(steer, 1.9, 2.5)
    turning = steer != 0.0
    cotangents = 1.0 / np.tan(right[turning]) - 1.0 / np.tan(left[turning])
    assert cotangents == pytest.approx(1.9 / 2.5, rel=1e-9)
    assert (left + right) / 2.0 == pytest.approx(steer, abs=1e-15)
