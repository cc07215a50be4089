"""The seeder behind an imposed tractor against the whole model."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from model_samples import alone, tandem, trailed
from smts_validate.model.inputs import Controls, ForceSeries
from smts_validate.model.simulate import SimulationError, initial_state, simulate
from smts_validate.model.trailed import imposed_from_body, simulate_trailed_batch

T = np.arange(0.0, 30.0, 0.01)
CONTROLS = Controls(t=T, speed=np.full(T.size, 2.5), steer=0.2 * np.sin(0.8 * T))


def impose(run):
    return imposed_from_body(run.t, run.x1, run.y1, run.yaw1, run.v1, run.v_lateral1, run.yaw_rate1)


@pytest.mark.parametrize("machine", [trailed(), tandem()], ids=["single axle", "tandem"])
def test_seeder_behind_the_simulated_tractor_moves_as_in_the_whole_model(machine):
    force = ForceSeries(
        0.5, np.stack([np.zeros(200)] * 4 + [800.0 * np.sin(np.arange(200) * 0.7)] * 2, axis=1)
    )
    whole = simulate(
        machine, dataclasses.replace(CONTROLS, over_distance=force), initial_state(v=2.5, yaw2=0.2), T
    )
    part = simulate_trailed_batch(
        machine, impose(whole), 0.2, 0.0, T.size, 0.01, start=0.0, over_distance=force
    ).run(0)
    assert np.abs(part.yaw2 - whole.yaw2).max() < 2e-4
    assert np.hypot(part.x2 - whole.x2, part.y2 - whole.y2).max() < 1e-3
    assert np.abs(whole.yaw1 - whole.yaw2).max() > 0.1


def test_windows_that_start_from_the_true_state_follow_the_truth():
    whole = simulate(trailed(), CONTROLS, initial_state(v=2.5), T)
    starts = np.array([3.0, 11.0, 20.0])
    at = np.rint(starts / 0.01).astype(int)
    windows = simulate_trailed_batch(
        trailed(), impose(whole), whole.yaw2[at], whole.yaw_rate2[at], 251, 0.02, start=starts
    )
    for window, first in enumerate(at):
        assert np.abs(windows.yaw2[window] - whole.yaw2[first : first + 501 : 2]).max() < 2e-4
    assert windows.steer.max() == 0.0


def test_tractor_alone_is_refused():
    whole = simulate(alone(), CONTROLS, initial_state(v=2.5), T)
    with pytest.raises(SimulationError, match="this machine has none"):
        simulate_trailed_batch(alone(), impose(whole), 0.0, 0.0, 11, 0.02, start=0.0)


def test_gaps_in_the_imposed_motion_are_refused():
    whole = simulate(trailed(), CONTROLS, initial_state(v=2.5), T)
    broken = whole.x1.copy()
    broken[7] = np.nan
    with pytest.raises(SimulationError, match="not finite"):
        imposed_from_body(whole.t, broken, whole.y1, whole.yaw1, whole.v1, whole.v_lateral1, whole.yaw_rate1)
