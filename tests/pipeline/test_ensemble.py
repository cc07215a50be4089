"""Ensemble mode: statistics over random soils, never a point-wise figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smts_validate.pipeline.ensemble import (
    PLAN,
    EnsembleError,
    compare_statistics,
    ensemble_values,
    make_ensemble,
    pointwise_discrepancy,
    straightness_of,
)
from synthetic_motion import alone, machine_of, manifest_of

FEW = replace(PLAN, seeds=24)


def test_threads_that_share_the_runs_leave_every_run_as_it_is() -> None:
    plan = replace(FEW, seeds=20)
    one, two = (make_ensemble(machine_of(manifest_of()), 2.8, 40.0, plan, threads=n) for n in (1, 2))
    assert one.diverged == two.diverged
    for name, values in one.indices.items():
        assert values.size == 20
        np.testing.assert_array_equal(values, two.indices[name])


def test_asking_an_ensemble_for_a_point_wise_discrepancy_is_an_error() -> None:
    ensemble = make_ensemble(machine_of(manifest_of()), 2.8, 80.0, FEW)
    with pytest.raises(EnsembleError, match="point-wise"):
        pointwise_discrepancy(ensemble)


def test_a_run_of_the_ensemble_lies_inside_its_own_band() -> None:
    machine = machine_of(manifest_of())
    ensemble = make_ensemble(machine, 2.8, 100.0, FEW)
    other = make_ensemble(machine, 2.8, 100.0, replace(FEW, seed=99))
    measured = {name: [float(np.median(values))] for name, values in other.indices.items()}
    found = compare_statistics(ensemble, measured)
    assert len(found) == 16
    for item in found:
        assert item.low < item.measured < item.high
        assert 0.1 < item.share_below < 0.9
        assert item.ratio == pytest.approx(1.0, abs=0.35)


def test_twice_the_soil_makes_twice_the_swing() -> None:
    machine = machine_of(manifest_of())
    plain = make_ensemble(machine, 2.8, 80.0, FEW)
    doubled = replace(FEW, soil=replace(FEW.soil, level=2.0 * FEW.soil.level))
    rough = make_ensemble(machine, 2.8, 80.0, doubled)
    ratio = rough.indices["deviation1.r95"] / plain.indices["deviation1.r95"]
    assert np.median(ratio) == pytest.approx(2.0, rel=0.1)


def test_indices_follow_their_definitions() -> None:
    found = straightness_of(np.array([[1.0, -1.0, 3.0, 1.0]]))
    assert found["max_abs"] == pytest.approx([3.0])
    assert found["range"] == pytest.approx([4.0])
    assert found["rms"] == pytest.approx([np.sqrt(2.0)])


def test_a_tractor_alone_has_an_ensemble_of_its_own_two_responses() -> None:
    ensemble = make_ensemble(machine_of(alone(manifest_of())), 2.8, 80.0, FEW)
    assert {name.split(".")[0] for name in ensemble.indices} == {"deviation1", "yaw1"}


def test_what_was_assumed_stands_beside_the_figures() -> None:
    values = ensemble_values(
        make_ensemble(machine_of(manifest_of()), 2.8, 80.0, FEW), {"deviation1.r95": [0.1]}
    )
    assert values["runs"] == 24
    assert values["soil"]["force1"] == FEW.soil.force1
    assert [i["index"] for i in values["indices"]] == ["deviation1.r95"]
