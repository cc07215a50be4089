"""What every tyre law on the shelf must do; a new law is picked up by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from smts_validate.model.tyres import NAMES, TYRES, lateral_force, law_code

SLIPS = st.floats(-1.5, 1.5)
STIFFNESSES = st.floats(1e3, 1e6)
LIMITS = st.floats(1e2, 1e5)


@pytest.mark.parametrize("law", TYRES, ids=NAMES)
@given(slip=SLIPS, stiffness=STIFFNESSES, limit=LIMITS)
def test_force_opposes_the_slip_and_stays_within_adhesion(law, slip, stiffness, limit):
    force = law.lateral_force(slip, stiffness, limit)
    assert force * slip <= 0.0
    assert abs(force) <= limit * (1.0 + 1e-12)
    assert law.lateral_force(-slip, stiffness, limit) == -force


@pytest.mark.parametrize("law", TYRES, ids=NAMES)
def test_slope_at_small_slip_is_the_cornering_stiffness(law):
    force = law.lateral_force(1e-6, 6e4, 8e3)
    assert force == pytest.approx(-6e4 * 1e-6, rel=1e-4)


@pytest.mark.parametrize("law", TYRES, ids=NAMES)
def test_more_slip_never_gives_less_force_and_large_slip_gives_all_adhesion(law):
    slips = np.linspace(0.0, 1.5, 400)
    forces = np.array([-law.lateral_force(s, 6e4, 8e3) for s in slips])
    assert (np.diff(forces) >= -1e-9).all()
    assert forces[-1] == pytest.approx(8e3, rel=1e-4)


@pytest.mark.parametrize("law", TYRES, ids=NAMES)
@given(slip=SLIPS)
def test_dispatch_by_code_and_the_uncompiled_law_give_the_same_force(law, slip):
    plain = law.lateral_force(slip, 6e4, 8e3)
    assert lateral_force(law_code(law.NAME), slip, 6e4, 8e3) == pytest.approx(plain, rel=1e-12, abs=1e-300)


@pytest.mark.parametrize("law", TYRES, ids=NAMES)
def test_wheel_without_load_gives_no_force(law):
    assert law.lateral_force(0.3, 6e4, 0.0) == 0.0


def test_fiala_slides_from_three_limits_over_stiffness_on():
    law = TYRES[law_code("fiala")]
    edge = np.arctan(3.0 * 8e3 / 6e4)
    assert law.lateral_force(edge, 6e4, 8e3) == pytest.approx(-8e3)
    assert abs(law.lateral_force(0.8 * edge, 6e4, 8e3)) < 8e3


def test_fiala_is_the_brush_models_integral_of_a_parabolic_pressure():
    """Force of bristles that stick until friction lets go, summed along the contact patch."""
    law, stiffness, limit = TYRES[law_code("fiala")], 6e4, 8e3
    place = np.linspace(0.0, 1.0, 200_001)
    for slip in (0.02, 0.1, 0.2, 0.3):
        sticking = 2.0 * stiffness * np.tan(slip) * place
        sliding = 6.0 * limit * place * (1.0 - place)
        expected = np.trapezoid(np.minimum(sticking, sliding), place)
        assert -law.lateral_force(slip, stiffness, limit) == pytest.approx(expected, rel=1e-6)


def test_unknown_law_names_those_there_are():
    with pytest.raises(ValueError, match="linear, tanh, fiala"):
        law_code("pacejka")
