"""One campaign of each kind through raw files: twin, reading, fusion, replay, verdict."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from smts_validate.model.machine import Machine
from smts_validate.pipeline.adequacy import Verdict, judge_campaign
from smts_validate.pipeline.bounds import PassStatistics
from smts_validate.pipeline.compare import compare
from smts_validate.pipeline.fusion.fuse import fuse
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion, Origin, SteerInput
from smts_validate.pipeline.twin import make_pass, write_raw
from smts_validate.pipeline.twin_plan import DriverPlan, TwinPlan, preset
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.manifest import Manifest, parse

Floats = NDArray[np.float64]

PASSES = 4
THRESHOLD = 0.15
# A driver who weaves: without swing there is nothing to compare.
LIVELY = DriverPlan(weave_deg=2.5, weave_period=3.5)
GROSS = {f"tyres.{axle}.cornering_stiffness": 0.35 for axle in ("front", "rear", "seeder")} | {
    "seeder.hitch_to_com": 3.0
}
KINDS = {"true": ("benign", {}), "gross": ("benign", GROSS), "metre": ("metre_gps", {})}


def plan_of(kind: str, index: int) -> TwinPlan:
    """A pass of 50 s: one row of about 110 m, east and west in turn; `truth` holds how the true machine differs."""
    name, truth = KINDS[kind]
    base = preset(name)
    soil = replace(
        base.soil,
        side_force_tractor=300.0,
        side_force_seeder=300.0,
        yaw_moment_tractor=150.0,
        yaw_moment_seeder=200.0,
    )
    run = replace(
        base.run, id=f"{kind}-{index}", direction=("east", "west")[index % 2], repeat=1 + index // 2
    )
    return replace(
        base,
        run=run,
        place=replace(base.place, heading_deg=5.0 + 180.0 * (index % 2)),
        path=replace(base.path, duration=50.0, row_length=200.0),
        driver=LIVELY,
        soil=soil,
        truth=truth,
    )


def machine_of(manifest: Manifest) -> Machine:
    return Machine.from_mapping(manifest.machine.model_dump(), manifest.operating.tyre_pressure_mpa)


@cache
def campaign(kind: str, folder: Path) -> tuple[tuple[PassStatistics, ...], Verdict]:
    """Every pass from its raw files to its statistics, and the verdict over them."""
    found = []
    for index in range(PASSES):
        raw = folder / f"{kind}-{index}"
        write_raw(make_pass(plan_of(kind, index), 50 + index), raw)
        log = read_pass(raw)
        statistics = compare(fuse(log), machine_of(log.manifest), log.manifest).statistics
        assert statistics is not None
        found.append(statistics)
    return tuple(found), judge_campaign(found)


def exact_motion(kind: str, index: int) -> tuple[Motion, Manifest]:
    """The twin's truth as a motion without errors, with the true steering as input."""
    twin = make_pass(plan_of(kind, index), 50 + index)
    t, x1, y1, yaw1, _, x2, y2, yaw2, angle = twin.truth.T
    tiny = np.tile(1e-12 * np.eye(6), (t.size, 1, 1))
    nan = np.full(t.size, np.nan)

    def body(x: Floats, y: Floats, yaw: Floats) -> BodyMotion:
        yaw = np.unwrap(yaw)
        vx, vy = np.gradient(x, t), np.gradient(y, t)
        v, lateral = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
        return BodyMotion(x, y, yaw, v, lateral, np.gradient(yaw, t), tiny, nan, nan)

    small = np.full(t.size, 1e-5)
    place = twin.plan.place
    motion = Motion(
        t=t, origin=Origin(place.lat, place.lon, place.alt), tractor=body(x1, y1, yaw1),
        seeder=body(x2, y2, yaw2), steer=angle, sd_steer=small,
        steer_input=SteerInput(angle, small, 5.0, 1e-5, 1e-5, "sensor"), draw_t=t[::50],
        draws=1e-6 * np.random.default_rng(0).standard_normal((20, t[::50].size, 6)), gnss_t=t[::5],
    )  # fmt: skip
    return motion, parse(twin.manifest_text)


def real_discrepancy(kind: str) -> float:
    """The largest response's discrepancy with true inputs and without measuring error, over two passes."""
    logs = []
    for index in range(2):
        motion, manifest = exact_motion(kind, index)
        statistics = compare(motion, machine_of(manifest), manifest).statistics
        assert statistics is not None
        logs.append([np.log(np.sqrt(r.mse) / r.r95) for r in statistics.responses.values()])
    return float(np.exp(np.mean(logs, axis=0)).max())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("raw")


@pytest.mark.slow
def test_a_campaign_of_the_manifest_s_own_machine_comes_out_adequate_from_raw_files(folder: Path) -> None:
    assert real_discrepancy("true") < 0.5 * THRESHOLD
    passes, verdict = campaign("true", folder)
    assert verdict.value == "adequate", verdict.reasons
    assert all(p.tractor_testable for p in passes)


@pytest.mark.slow
def test_a_campaign_of_a_grossly_other_machine_comes_out_not_adequate_from_raw_files(folder: Path) -> None:
    assert real_discrepancy("gross") > 1.5 * THRESHOLD
    _, verdict = campaign("gross", folder)
    assert verdict.value == "not adequate", verdict.reasons


@pytest.mark.slow
def test_a_campaign_with_a_receiver_of_a_metre_comes_out_inconclusive_from_raw_files(folder: Path) -> None:
    _, verdict = campaign("metre", folder)
    assert verdict.value == "inconclusive"
    assert "small-swing" in verdict.codes
