"""The filter's model functions against numerical derivatives and against their uncompiled selves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smts_validate.pipeline.fusion import filtering, kernels
from smts_validate.pipeline.fusion import state as s

STEP = 0.02
DOUBT = np.full(s.SIZE, 0.01)  # about how far each component is off once the filter runs
DOUBT[[s.X, s.Y, s.EX, s.EY]] = 0.1
DOUBT[[s.BGX, s.BGY, s.BGZ, s.BGZ2]] = 0.002
DOUBT[[s.SCALE1, s.SCALE2]] = 0.005
DOUBT[s.LAG] = 0.005
RATES = (s.VEL_X, s.VEL_Y, s.HITCH, s.ACCEL_Y, s.WHEEL)


def parameters() -> np.ndarray:
    p = np.zeros(s.P_SIZE)
    p[[s.P_REAR, s.P_ANT_X, s.P_ANT_Y, s.P_ANT_Z, s.P_SWAY]] = 1.15, 0.2, -0.1, 2.1, 0.4
    p[[s.P_HITCH, s.P_AXLE2, s.P_COM2, s.P_TAU_SLIP, s.P_TAU_E]] = 0.9, 3.0, 2.7, 1.0, 40.0
    p[s.P_ACTIVE] = s.SIZE
    p[[s.P_ANT2_X, s.P_ANT2_Y, s.P_ANT2_Z, s.P_SEEDER, s.P_TILT]] = 0.1, 0.2, 1.5, 1.0, 1.0
    return p


def random_state(rng: np.random.Generator) -> np.ndarray:
    x = rng.normal(size=s.SIZE) * 0.01
    x[[s.X, s.Y]] = rng.normal(size=2) * 50.0
    x[[s.YAW1, s.YAW2]] = rng.uniform(-3.0, 3.0) + np.array([0.0, rng.normal() * 0.2])
    x[s.V] = rng.uniform(-3.0, 3.0)
    return x


def random_node(rng: np.random.Generator) -> np.ndarray:
    node = np.zeros(s.N_SIZE)
    node[[s.U_WX, s.U_WY, s.U_WZ, s.U_W2]] = rng.normal(size=4) * 0.1
    node[[s.U_FX, s.U_FY]] = rng.normal(size=2) * 0.5
    node[[s.N_ROLL2, s.N_PITCH2]] = rng.normal(size=2) * 0.03
    return node


def numerical(f, x: np.ndarray, h: float = 1.0e-6) -> np.ndarray:
    """Central differences of f (scalar or vector) by each component of x, last axis."""
    columns = []
    for i in range(x.size):
        d = np.zeros(x.size)
        d[i] = h
        columns.append((f(x + d) - f(x - d)) / (2.0 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("seed", range(5))
def test_transition_jacobian_is_the_derivative_of_the_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, p = random_state(rng), parameters()
    u = np.zeros(s.U_SIZE)
    u[: s.U_W2 + 1] = random_node(rng)[: s.U_W2 + 1]
    F = np.eye(s.SIZE)
    kernels.transition(x, u, STEP, p, F)
    found = numerical(lambda v: kernels.transition(v, u, STEP, p, np.eye(s.SIZE)), x)
    # position leaves out what the step's own change of speed and turn does to it: g·dt²/2
    assert np.abs(F - found).max() < 10.0 * STEP**2


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", range(s.KINDS))
def test_measurement_rows_are_the_derivatives_of_what_is_expected(kind: int, seed: int) -> None:
    rng = np.random.default_rng(100 * kind + seed)
    x, p, node = random_state(rng), parameters(), random_node(rng)
    H = np.zeros(s.SIZE)
    kernels.predict(kind, x, node, 0.004, p, H)
    found = numerical(lambda v: kernels.predict(kind, v, node, 0.004, p, np.zeros(s.SIZE)), x)
    # what is left out, times how far the state may be off, must not matter: a millimetre, or 5 mm/s, or 0.3 mrad
    assert np.abs((H - found) * DOUBT).max() < (0.005 if kind in RATES else 0.001)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_compiled_model_functions_equal_their_uncompiled_selves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, p, node = random_state(rng), parameters(), random_node(rng)
    u = np.zeros(s.U_SIZE)
    u[: s.U_W2 + 1] = node[: s.U_W2 + 1]
    F, G = np.eye(s.SIZE), np.eye(s.SIZE)
    np.testing.assert_allclose(
        kernels.transition(x, u, STEP, p, F), kernels.transition.py_func(x, u, STEP, p, G), rtol=0, atol=1e-12
    )
    np.testing.assert_allclose(F, G, rtol=0, atol=1e-13)
    for kind in range(s.KINDS):
        H, K = np.zeros(s.SIZE), np.zeros(s.SIZE)
        a = kernels.predict(kind, x, node, 0.004, p, H)
        b = kernels.predict.py_func(kind, x, node, 0.004, p, K)
        assert a == pytest.approx(b, abs=1e-11)
        np.testing.assert_allclose(H, K, rtol=0, atol=1e-12)


def test_every_nonzero_of_the_transition_stands_in_the_sparsity_pattern() -> None:
    listed = {tuple(e) for e in kernels.PATTERN}
    rng = np.random.default_rng(0)
    for _ in range(10):
        u = np.zeros(s.U_SIZE)
        u[: s.U_W2 + 1] = random_node(rng)[: s.U_W2 + 1]
        F = np.eye(s.SIZE)
        kernels.transition(random_state(rng), u, STEP, parameters(), F)
        off = F - np.diag(np.diag(F))
        assert {tuple(map(int, e)) for e in np.argwhere(off != 0.0)} <= listed


def test_sparse_propagation_equals_the_dense_product() -> None:
    rng = np.random.default_rng(1)
    F = np.eye(s.SIZE)
    for i, j in kernels.PATTERN:
        F[i, j] = rng.normal()
    A = rng.normal(size=(s.SIZE, s.SIZE))
    P, q = A @ A.T, rng.uniform(size=s.SIZE)
    expected = F @ P @ F.T + np.diag(q)
    filtering.propagate(P, F, q, np.empty_like(F), np.empty_like(F), s.SIZE)
    np.testing.assert_allclose(P, expected, rtol=1e-12, atol=1e-10)


def test_a_standing_machine_neither_moves_nor_turns_whatever_its_gyros_say() -> None:
    x, u = np.zeros(s.SIZE), np.zeros(s.U_SIZE)
    x[[s.YAW1, s.YAW2, s.ROLL]] = 1.0, 0.9, 0.02
    u[[s.U_WZ, s.U_W2, s.U_FX, s.U_REST]] = 0.3, -0.2, 2.0, 1.0
    after = kernels.transition(x, u, STEP, parameters(), np.eye(s.SIZE))
    np.testing.assert_array_equal(after, x)


def test_an_antenna_on_a_rolled_tractor_sways_by_height_times_roll() -> None:
    x, p, node = np.zeros(s.SIZE), parameters(), np.zeros(s.N_SIZE)
    p[[s.P_ANT_X, s.P_ANT_Y, s.P_SWAY]] = 0.0
    x[s.ROLL] = np.radians(1.0)  # left side up: the mast leans to the right, which is south when heading east
    north = kernels.predict(s.FIXED_Y, x, node, 0.0, p, np.zeros(s.SIZE))
    assert north == pytest.approx(-2.1 * np.sin(np.radians(1.0)), abs=1e-12)
