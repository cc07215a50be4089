"""What a turn does to slip, and what the fusion states of it: against statics of a towed axle and simulated series."""

from __future__ import annotations

import math

import numpy as np
import pytest
from smts_validate.pipeline.fusion import kernels, output, problem, settings
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.motion import BodyMotion, SteerInput
from smts_validate.pipeline.fusion.steering import best_steering
from smts_validate.pipeline.fusion.unseen import Doubt, modes_of
from smts_validate.pipeline.twin_plan import preset
from smts_validate.sensors.manifest import Machine

DEG = np.pi / 180.0
STEP = 0.02
AXLE = 1.45
LONG_AXLE = 3.2  # m, hitch to the seeder's axle


def parameters() -> np.ndarray:
    """A parameter vector with a seeder whose tyres slip by 0.03 rad/(m/s²)."""
    p = np.zeros(s.P_SIZE)
    p[[s.P_SEEDER, s.P_TAU_SLIP, s.P_TAU_E, s.P_AXLE2]] = 1.0, 1.0, 40.0, LONG_AXLE
    p[s.P_TURN], p[s.P_TURN2], p[s.P_DRAG2] = 0.02, 0.03, 0.01
    return p


def lasting_sd(component: int, speed: float, rates: tuple[float, float], bend: float) -> float:
    """Stationary standard deviation (rad) of a turn's slip angle, by the drive of one step and its decay."""
    x, u, q = np.zeros(s.SIZE), np.zeros(s.U_SIZE), np.zeros(s.SIZE)
    F = np.eye(s.SIZE)
    x[[s.V, s.YAW1]], u[[s.U_WZ, s.U_W2]] = (speed, bend), rates
    kernels.process_noise(x, u, STEP, parameters(), q)
    kernels.fade(x, u, STEP, parameters(), F, x.copy())
    return math.sqrt(q[component] / (1.0 - F[component, component] ** 2)) / speed


def test_a_seeder_that_still_turns_behind_a_straightened_tractor_still_slips() -> None:
    # a tractrix: its yaw rate is V·sin(bend)/axle while the tractor's is none
    speed, bend = 2.0, 0.35
    rate = speed * math.sin(bend) / LONG_AXLE
    found = lasting_sd(s.TURN2, speed, (0.0, rate), bend)
    assert (
        found > 0.6 * 0.03 * speed * rate
    )  # most of what its tyres' compliance makes of its own acceleration
    assert lasting_sd(s.TURN2, speed, (0.0, 0.0), 0.0) == 0.0


@pytest.mark.parametrize("component", [s.TURN1, s.TURN2])
def test_far_beyond_a_weave_the_whole_acceleration_makes_slip(component: int) -> None:
    compliance = 0.02 if component == s.TURN1 else 0.03
    for lateral, least, most in ((0.1, 0.0, 0.0), (0.3, 0.7, 1.0), (1.2, 0.95, 1.0)):
        found = lasting_sd(component, 2.0, (0.5 * lateral, 0.5 * lateral), 0.0)
        assert least * compliance * lateral <= found <= most * compliance * lateral


def test_the_slip_of_a_turn_ends_with_each_bodys_own_turn() -> None:
    x, u, F = np.zeros(s.SIZE), np.zeros(s.U_SIZE), np.eye(s.SIZE)
    x[s.V], u[s.U_W2] = 2.0, 0.2
    kernels.fade(x, u, STEP, parameters(), F, x.copy())
    assert F[s.TURN1, s.TURN1] == pytest.approx(math.exp(-STEP))
    assert F[s.TURN2, s.TURN2] == pytest.approx(math.exp(-STEP / settings.TAU_TURN))


def test_a_heavy_seeder_on_soft_tyres_slips_as_its_axle_load_says() -> None:
    machine = Machine.model_validate(preset("headland").machine)
    assert machine.seeder is not None
    assert machine.tyres.seeder is not None
    soft = machine.tyres.seeder.model_copy(update={"cornering_stiffness": 2.0e4})
    heavy = machine.model_copy(update={"tyres": machine.tyres.model_copy(update={"seeder": soft})})
    # moments about the hitch at slip angle β: tyres' 2·n·C·β·(l5 + l6) and the draft's part aside, F·β·l5, hold m·a·l5
    l5, axles = machine.seeder.hitch_to_com, machine.seeder.axles
    slip = problem.compliances(heavy)[1]
    tyres = 2 * len(axles) * 2.0e4 * slip * (l5 + sum(axles) / len(axles))
    assert tyres + machine.seeder.draft * slip * l5 == pytest.approx(machine.seeder.mass * l5)
    assert problem.compliances(heavy)[0] == settings.COMPLIANCE
    stiff = machine.tyres.seeder.model_copy(update={"cornering_stiffness": 1.0e7})
    firm = machine.model_copy(update={"tyres": machine.tyres.model_copy(update={"seeder": stiff})})
    assert problem.compliances(firm)[1] == settings.COMPLIANCE


def test_the_lateral_velocities_doubt_is_that_of_both_parts_of_the_slip() -> None:
    # one error of 3 cm/s in the slip of a turn and the same in the fast slip are one lateral velocity's error
    p = parameters()
    x, none = np.zeros((1, s.SIZE)), np.zeros(1)
    variances = []
    for part in (s.SLIP1, s.TURN1):
        P = np.zeros((1, len(s.KEPT), len(s.KEPT)))
        P[0, s.KEPT.index(part), s.KEPT.index(part)] = 0.03**2
        at = output.Smooth(x, P, none, none, none, none)
        nothing = modes_of(at, p, Doubt(place=0.0), none)
        variances.append(output.tractor_motion(at, p, nothing, None).covariance[0, 4, 4])
        variances.append(output.seeder_motion(at, p, nothing, None).covariance[0, 4, 4])
    np.testing.assert_allclose(variances, 0.03**2, rtol=1e-9)


def turned_by(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half a turn between two straights, its angle integrated from gyros whose scales differ by 0.7 % (1 sigma):
    the best angle's error, its stated deviation, and the given series' error."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 50.0, STEP)
    speed, radius = 1.8, 9.0
    turning = (t > 15.0) & (t < 15.0 + np.pi * radius / speed)
    true = np.where(turning, np.arctan(AXLE / radius), 0.0)
    rate = speed * np.tan(true) / AXLE
    yaw = np.cumsum(rate) * STEP
    zero = 0.3 * DEG
    wrong = zero * rng.standard_normal() + 0.007 * rng.standard_normal() * yaw
    given = SteerInput(true + wrong, np.full(t.size, 0.05 * DEG), 20.0, zero, 0.01, "wheels")
    none = np.zeros(t.size)
    path = true + 0.1 * DEG * np.convolve(rng.standard_normal(t.size + 99), np.ones(100) / 10.0, "valid")
    covariance = np.zeros((t.size, 6, 6))
    body = BodyMotion(
        none, none, yaw, np.full(t.size, speed), none, speed * np.tan(path) / AXLE, covariance, none, none
    )
    best = best_steering(t, body, given, AXLE, 0.002, none)
    return best.angle - true, best.sd, wrong


def test_gyros_of_different_scale_do_not_leave_the_steering_askew_after_a_turn() -> None:
    after = slice(1700, None)  # 34 s: the second straight
    runs = [turned_by(seed) for seed in range(12)]
    askew = np.sqrt(np.mean([np.mean((w[after] - w[:700].mean()) ** 2) for _, _, w in runs]))
    left = np.sqrt(np.mean([np.mean(e[after] ** 2) for e, _, _ in runs]))
    assert left < 0.2 * askew
    assert np.mean([np.mean((e / sd) ** 2) for e, sd, _ in runs]) < 2.0
