"""The search for what the data tell of noise levels and of the clocks' lag: against known tops and plain problems."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from fusion_samples import changed, make
from hypothesis import given
from hypothesis import strategies as st
from smts_validate.pipeline.fusion import fuse, tune
from smts_validate.pipeline.fusion.known import Known, build, levelled, prepare
from smts_validate.pipeline.fusion.settings import FusionSettings, Levels
from smts_validate.pipeline.twin_plan import preset
from smts_validate.pipeline.wheels import wheel_motions

OPTIONS = FusionSettings()
START = Levels()
NAMES = ("beta1", "forward", "wheel")


@lru_cache(maxsize=1)
def solved() -> tuple[Known, np.ndarray]:
    """A short pass with float spans, prepared, and its first smoothed path."""
    log = make(changed(preset("outage"), path__duration=40.0, gnss__floats=((15.0, 10.0),)), 5).log
    known = prepare(log, wheel_motions(log))
    path = fuse.solve(build(known, OPTIONS, START, 0.0), OPTIONS)[1].x
    return levelled(known, path), path


@pytest.mark.parametrize("name", [*fuse.NAMES, None])
def test_the_likelihood_of_levels_is_that_of_the_problem_built_at_them(name: str | None) -> None:
    known, path = solved()
    levels = replace(START, **{name: 1.7 * getattr(START, name)}) if name else START
    plain = fuse.score(fuse.cut(build(known, OPTIONS, levels, float(path[-1, 17])), 0, known.t.size, path))
    assert fuse.likelihood_of(known, OPTIONS, path, fuse.TUNED)(levels) == pytest.approx(plain, abs=1e-6)


@given(st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3), st.floats(-0.6, 0.6), st.floats(20.0, 500.0))
def test_the_top_of_a_likelihood_is_found_though_two_levels_are_coupled(
    top: list[float], coupling: float, sharpness: float
) -> None:
    away = np.eye(3)
    away[1, 2] = away[2, 1] = coupling

    def likelihood(levels: Levels) -> float:
        off = np.array([math.log(getattr(levels, n) / getattr(START, n)) for n in NAMES]) - top
        return -0.5 * sharpness * float(off @ away @ off)

    prior = np.eye(3) / math.log(tune.PRIOR_FACTOR) ** 2
    right = np.linalg.solve(sharpness * away + prior, sharpness * away @ np.array(top))
    found = tune.best_levels(START, NAMES, likelihood, likelihood)
    reached = [math.log(getattr(found, n) / getattr(START, n)) for n in NAMES]
    assert reached[0] == pytest.approx(right[0], abs=0.04)
    # coordinate by coordinate (Gauss-Seidel) the error falls by the coupling at each: thrice in two sweeps; a step that
    # is near enough is not taken
    left = abs(coupling) ** 3 * np.abs(right).max() + 0.07 * abs(coupling) + 0.04
    assert np.abs(np.array(reached) - right).max() < left


def test_levels_that_the_data_do_not_tell_stay_where_physics_puts_them() -> None:
    found = tune.best_levels(START, NAMES, *[lambda levels: 0.0] * 2)
    assert [getattr(found, n) for n in NAMES] == pytest.approx([getattr(START, n) for n in NAMES], rel=1e-9)


def test_a_level_does_not_leave_its_bounds() -> None:
    found = tune.best_levels(START, ("wheel",), *[lambda levels: -1e4 * math.log(levels.wheel)] * 2)
    assert found.wheel == pytest.approx(tune.BOUNDS["wheel"][0])


@given(st.floats(-0.22, 0.12))
def test_the_lag_is_found_between_the_places_where_it_was_tried(lag: float) -> None:
    found = tune.best_lag(lambda value: -0.5 * ((value - lag) / 0.005) ** 2, 0.05)
    assert found == pytest.approx(lag / (1.0 + (0.005 / 0.05) ** 2), abs=1e-6)


def test_a_lag_beyond_all_that_receivers_have_stays_at_the_last_one_tried() -> None:
    assert tune.best_lag(lambda value: -1e6 * (value - 1.0) ** 2, 0.05) == pytest.approx(tune.LAGS[-1])
