"""Our model against a motion simulated by others: the example pass that lies beside the checkout, where
there is one.

Its truth comes from an independent implementation of the same equations (who made it and how is not ours to
say); tolerances: derivatives of a truth written with 5 decimals at 50 Hz start each window.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from smts_validate.model.inputs import Controls
from smts_validate.model.machine import Machine
from smts_validate.model.simulate import initial_state, simulate_batch

EXAMPLE = Path(__file__).resolve().parents[3] / "shared" / "examples" / "visible"
SPACING, WINDOW = 0.02, 451  # s, samples: 9 s, about 25 m


@pytest.fixture(scope="module")
def example():
    if not EXAMPLE.is_dir():
        pytest.skip("no examples beside the checkout")
    manifest = tomllib.loads(next(EXAMPLE.glob("raw/*/run.toml")).read_text())
    machine = Machine.from_mapping(manifest["machine"], manifest["operating"]["tyre_pressure_mpa"])
    return machine, pd.read_csv(EXAMPLE / "truth.csv")


def deviations(machine: Machine, truth: pd.DataFrame) -> tuple[float, float]:
    """Rms lateral error of both bodies, m, over windows of 9 s that start from the truth."""
    t = truth["t"].to_numpy() - truth["t"].iloc[0]
    x1, y1, yaw1, x2, y2, yaw2, steer = (
        truth[name].to_numpy() for name in ("x1", "y1", "yaw1", "x2", "y2", "yaw2", "steer")
    )
    vx, vy, rate1, rate2 = (np.gradient(series, t) for series in (x1, y1, yaw1, yaw2))
    v, sideways = np.cos(yaw1) * vx + np.sin(yaw1) * vy, np.cos(yaw1) * vy - np.sin(yaw1) * vx
    first = np.arange(400, t.size - WINDOW, 200)
    start = initial_state(*(s[first] for s in (x1, y1, yaw1, yaw2, v, sideways, rate1, rate2)))
    runs = simulate_batch(
        machine, Controls(t=t, speed=v, steer=steer), start, WINDOW, SPACING, start=t[first]
    )
    at = first[:, None] + np.arange(WINDOW)
    errors = []
    for x, y, run_x, run_y in ((x1, y1, runs.x1, runs.y1), (x2, y2, runs.x2, runs.y2)):
        across = np.cos(yaw1[at]) * (run_y - y[at]) - np.sin(yaw1[at]) * (run_x - x[at])
        errors.append(float(np.sqrt(np.mean(across**2))))
    return errors[0], errors[1]


def test_windows_of_the_example_follow_its_truth_within_millimetres(example):
    machine, truth = example
    assert max(deviations(machine, truth)) < 0.002


def test_another_split_of_the_traction_or_softer_tyres_do_not(example):
    machine, truth = example
    right = max(deviations(machine, truth))
    for change in ({"tractor.driven": "rear"}, {"tyres.front.cornering_stiffness": 25e3}):
        assert max(deviations(machine.replace_parameters(change), truth)) > 3.0 * right
