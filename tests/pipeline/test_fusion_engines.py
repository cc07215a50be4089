"""Both engines against each other, and the smoother against the batch least-squares solution of the same problem."""

from __future__ import annotations

import numpy as np
import pytest
from fusion_samples import sample
from smts_validate.pipeline.fusion import engine_compiled, engine_filterpy, fuse, kernels, known
from smts_validate.pipeline.fusion import state as s
from smts_validate.pipeline.fusion.draws import posterior_errors
from smts_validate.pipeline.fusion.filtering import pack, unpack
from smts_validate.pipeline.fusion.prepare import STEP
from smts_validate.pipeline.fusion.problem import Problem
from smts_validate.pipeline.fusion.settings import FusionSettings, Levels
from smts_validate.pipeline.wheels import wheel_motions


@pytest.fixture(scope="module")
def whole() -> tuple[Problem, np.ndarray]:
    """The estimation problem of a twin and its smoothed path."""
    log = sample("benign", 0).log
    task = known.build(known.prepare(log, wheel_motions(log)), FusionSettings(), Levels(), -0.02)
    smooth = engine_compiled.run_smoother(task, engine_compiled.run_filter(task, None), None)
    return task, smooth.x


@pytest.mark.parametrize("linear", [False, True])
def test_both_engines_give_the_same_filter_and_smoother(
    whole: tuple[Problem, np.ndarray], linear: bool
) -> None:
    task, path = whole
    part = fuse.cut(task, 250, 650, path)
    lin = path[250:650] if linear else None
    a, b = engine_compiled.run_filter(part, lin), engine_filterpy.run_filter(part, lin)
    np.testing.assert_allclose(a.x, b.x, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(a.used, b.used)
    assert a.log_likelihood == pytest.approx(b.log_likelihood, abs=1e-6)
    c, d = engine_compiled.run_smoother(part, a, lin), engine_filterpy.run_smoother(part, b, lin)
    np.testing.assert_allclose(c.x, d.x, rtol=0, atol=1e-9)
    np.testing.assert_allclose(c.P, d.P, rtol=0, atol=1e-8)


def batch_least_squares(task: Problem, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smoothed states (N, SIZE) and their covariances by one dense least squares over start and noises.

    Every state is an affine function of the start and of all the noises; measurements and priors are rows.
    """
    n, q = task.t.size, task.measurements
    live = np.flatnonzero(np.diag(task.P0) > 0.0)
    blocks, constants = [np.eye(s.SIZE)[:, live]], [task.x0]
    scale = [np.sqrt(np.diag(task.P0)[live])]
    for k in range(1, n):
        F, var = np.eye(s.SIZE), np.empty(s.SIZE)
        there = kernels.transition(path[k - 1], task.step_inputs[k - 1], STEP, task.parameters, F)
        kernels.process_noise(path[k - 1], task.step_inputs[k - 1], STEP, task.parameters, var)
        driven = np.flatnonzero(var > 0.0)
        blocks.append(np.hstack([F @ blocks[-1], np.eye(s.SIZE)[:, driven]]))
        constants.append(there + F @ (constants[-1] - path[k - 1]))
        scale.append(np.sqrt(var[driven]))
    sd = np.concatenate(scale)
    width = sd.size
    full = [np.hstack([b, np.zeros((s.SIZE, width - b.shape[1]))]) * sd for b in blocks]
    rows, values = [np.eye(width)], [np.zeros(width)]
    for m in range(q.kind.size):
        k, H = q.node[m], np.zeros(s.SIZE)
        h = kernels.predict(q.kind[m], path[k], task.node_inputs[k], q.ahead[m], task.parameters, H)
        rows.append((H @ full[k] / np.sqrt(q.var[m]))[None])
        values.append(np.array([(q.z[m] - h - H @ (constants[k] - path[k])) / np.sqrt(q.var[m])]))
    A, y = np.vstack(rows), np.concatenate(values)
    information = A.T @ A
    best, covariance = np.linalg.solve(information, A.T @ y), np.linalg.inv(information)
    x = np.array([c + f @ best for c, f in zip(constants, full, strict=True)])
    return x, np.array([f @ covariance @ f.T for f in full])


def test_the_smoother_is_the_batch_least_squares_solution_of_a_linearised_pass(
    whole: tuple[Problem, np.ndarray],
) -> None:
    task, path = whole
    part = fuse.cut(task, 500, 540, path)
    lin = path[500:540]
    filtered = engine_compiled.run_filter(part, lin)
    assert filtered.used.all()
    smooth = engine_compiled.run_smoother(part, filtered, lin)
    x, P = batch_least_squares(part, lin)
    spread = np.sqrt(np.maximum(np.einsum("nii->ni", P), 1e-18))
    assert np.abs((smooth.x - x) / spread).max() < 1e-4
    kept = P[:, s.KEPT][:, :, s.KEPT]
    assert np.abs(smooth.P - kept).max() < 1e-6 * np.abs(kept).max()


def test_posterior_draws_have_the_smoothers_covariance(whole: tuple[Problem, np.ndarray]) -> None:
    task, path = whole
    part = fuse.cut(task, 500, 1000, path)
    lin = path[500:1000]
    filtered = engine_compiled.run_filter(part, lin)
    smooth = engine_compiled.run_smoother(part, filtered, lin)
    count = 400
    when, draws = posterior_errors(part, filtered, lin, count, seed=3)
    at = np.rint((when - part.t[0]) / STEP).astype(int)
    for index in range(5):
        ratio = draws[:, index].var(axis=1) / smooth.P[at, index, index]
        # χ² with 400 degrees of freedom, correlated over time: 5 standard deviations
        assert np.abs(ratio - 1.0).max() < 5.0 * np.sqrt(2.0 / count)
    middle = at.size // 2
    joint = np.cov(draws[middle][:5])
    stated = smooth.P[at[middle]][:5, :5]
    tolerance = 5.0 * np.sqrt(np.outer(np.diag(stated), np.diag(stated)) * 2.0 / count)
    assert (np.abs(joint - stated) < tolerance).all()


def test_packing_a_covariance_loses_nothing() -> None:
    rng = np.random.default_rng(0)
    A = rng.normal(size=(s.SIZE, s.SIZE))
    P, out = A @ A.T, np.empty((s.SIZE, s.SIZE))
    row = np.empty(engine_compiled.TRIANGLE)
    pack(P, row, s.SIZE)
    unpack(row, out, s.SIZE)
    np.testing.assert_array_equal(out, P)
