"""A small made-up pass result for the tests of result and report: a weaving row with a known closed form."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from smts_validate.pipeline.campaign import read_record, summarise_campaign
from smts_validate.pipeline.campaign_settings import CampaignSettings
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion, Origin, SteerInput
from smts_validate.pipeline.result import PassResult, dump_json, write_result
from smts_validate.sensors import manifest as manifests
from smts_validate.sensors.draft_text import MACHINE, SEEDER

Floats = NDArray[np.float64]

AMPLITUDE = 0.06  # m, of the weave
WAVELENGTH = 22.0  # m
SPEED = 2.5  # m/s
DRAWBAR = 5.0  # m, between the two centres of mass
HEADING = 0.4  # rad, of the row from East
T0 = 1_747_303_260.0  # s, UTC

TOML = (
    """schema = 1
[run]
id = "sample-1"
field = "Lower <b>Meadow</b>"
direction = "east"
repeat = 2
variant = "b"
date = 2025-05-15
[operating]
speed = 2.5
tyre_pressure_mpa = 0.11
"""
    + MACHINE
    + """[sensors.imd1]
kind = "imd"
body = "tractor"
file = "imd1.csv"
position = [0.3, 0.0, -0.2]
rate = 100.0
[sensors.gps]
kind = "gps"
file = "gps.nmea"
position = [0.0, 0.0, 2.1]
rate = 10.0
[conditions]
soil_moisture_pct = { "0-5cm" = 21.4, "5-10cm" = 23.9 }
soil_hardness_mpa = { "0-5cm" = 1.1, "5-10cm" = 1.4 }
notes = "dry <script>alert(1)</script> & windy"
"""
)

SEEDER_TOML = (
    SEEDER
    + """[sensors.imd2]
kind = "imd"
body = "seeder"
file = "imd2.csv"
position = [0.0, 0.0, 0.2]
rate = 100.0
"""
)


@dataclass(frozen=True)
class SampleLine:
    """A straight line a to b in m ENU, as the rows' lines are."""

    a: Floats
    b: Floats

    def project(self, x: Floats, y: Floats) -> tuple[Floats, Floats]:
        along = (self.b - self.a) / np.hypot(*(self.b - self.a))
        dx, dy = x - self.a[0], y - self.a[1]
        return along[0] * dx + along[1] * dy, along[0] * dy - along[1] * dx


@dataclass(frozen=True)
class SampleRow:
    """A row as `pipeline.rows` describes it."""

    index: int
    line: SampleLine
    start: int
    stop: int
    direction: int = 1


def toml(seeder: bool = True) -> str:
    return TOML + (SEEDER_TOML if seeder else "")


def _covariance(n: int, sd: tuple[float, ...] = (0.02, 0.01, 0.001, 0.02, 0.02, 0.004)) -> Floats:
    """Diagonal in the row's frame, turned into ENU: 2 cm along, 1 cm across."""
    matrix = np.diag(np.square(sd))
    c, s = np.cos(HEADING), np.sin(HEADING)
    turn = np.eye(6)
    turn[:2, :2] = [[c, -s], [s, c]]
    return np.broadcast_to(turn @ matrix @ turn.T, (n, 6, 6)).copy()


def body(t: Floats, lag: float, amplitude: float) -> BodyMotion:
    """A body `lag` metres behind the tractor, weaving by `amplitude` about the row's line."""
    s = SPEED * (t - T0) - lag
    k = 2.0 * np.pi / WAVELENGTH
    across = amplitude * np.sin(k * s)
    slope = np.arctan(amplitude * k * np.cos(k * s))
    c, d = np.cos(HEADING), np.sin(HEADING)
    nan = np.full(t.size, np.nan)
    return BodyMotion(
        x=c * s - d * across, y=d * s + c * across, yaw=HEADING + slope, v=np.full(t.size, SPEED),
        v_lateral=np.zeros(t.size), yaw_rate=np.gradient(slope, t), covariance=_covariance(t.size),
        roll=nan, pitch=nan,
    )  # fmt: skip


def motion(seconds: float = 60.0, seeder: bool = True) -> Motion:
    t = T0 + np.arange(round(50 * seconds)) / 50.0
    k = 2.0 * np.pi / WAVELENGTH
    steer = -0.02 * np.sin(k * SPEED * (t - T0))
    draw_t = T0 + np.arange(0.0, seconds, 0.5)
    return Motion(
        t=t, origin=Origin(50.0, 36.5, 120.0), tractor=body(t, 0.0, AMPLITUDE),
        seeder=body(t, DRAWBAR, 0.8 * AMPLITUDE) if seeder else None,
        steer=steer, sd_steer=np.full(t.size, 0.002),
        steer_input=SteerInput(steer, np.full(t.size, 0.002), 5.0, 0.005, 0.01, "wheels"),
        innovations={
            f"gnss position, {axis}": {"t": t[::5], "value": np.sin(t[::5]), "used": np.ones(t[::5].size)}
            for axis in ("east", "north")
        },
        draw_t=draw_t, draws=np.zeros((4, draw_t.size, 6 if seeder else 3)), gnss_t=t[::5],
    )  # fmt: skip


def rows(n: int, first: int = 250, last: int = 250) -> tuple[SampleRow, ...]:
    end = 1000.0 * np.array([np.cos(HEADING), np.sin(HEADING)])
    return (SampleRow(0, SampleLine(np.zeros(2), end), first, n - last),)


def simulated(fused: Motion, error: float = 1.1) -> dict[str, Floats]:
    """A model that weaves `error` times as much as the measured bodies, NaN outside the row."""
    inside = np.zeros(fused.t.size, dtype=bool)
    inside[250:-250] = True
    columns = {"steer": fused.steer, "window": np.floor(SPEED * (fused.t - T0) / 25.0)}
    for b, lag, amplitude in (("1", 0.0, AMPLITUDE), ("2", DRAWBAR, 0.8 * AMPLITUDE))[: len(fused.bodies)]:
        other = body(fused.t, lag, error * amplitude)
        columns |= {f"x{b}": other.x, f"y{b}": other.y, f"yaw{b}": other.yaw, f"v{b}": other.v,
                    f"yaw_rate{b}": other.yaw_rate}  # fmt: skip
    return {name: np.where(inside, values, np.nan) for name, values in columns.items()}


RESPONSES = {"deviation1": 7.07, "yaw1": 6.9, "deviation2": 7.1, "yaw2": 6.8}  # % of R95
GRID = 0.2  # m


def comparison(fused: Motion, model: dict[str, Floats]) -> dict[str, Floats]:
    """Columns as `findings.comparison_columns` leaves them, from the same closed form."""
    line = rows(fused.t.size)[0].line
    bodies = [b for b in "12" if f"x{b}" in model]
    s = np.arange(20.0, 110.0, GRID)
    found: dict[str, Floats] = {"row": np.zeros(s.size), "s": s}
    for b, moving in zip(bodies, fused.bodies, strict=True):
        own, n = line.project(moving.x, moving.y)
        inside = np.isfinite(model[f"x{b}"])
        _, n_model = line.project(model[f"x{b}"], model[f"y{b}"])
        pairs = {"n": (n, n_model), "yaw": (moving.yaw - HEADING, model[f"yaw{b}"] - HEADING)}
        found |= {f"t{b}": np.interp(s, own, fused.t), f"valid{b}": np.ones(s.size)}
        for quantity, (measured, simulated) in pairs.items():
            at = np.interp(s, own, measured)
            found |= {
                f"window{b}": np.floor(s / 25.0), f"{quantity}{b}": at,
                f"{quantity}{b}_simulated": np.interp(s, own[inside], simulated[inside]),
                f"{quantity}{b}_start": 1.2 * np.interp(s, own[inside], simulated[inside]),
                f"{quantity}{b}_null": np.zeros(s.size), f"sd_{quantity}{b}": np.full(s.size, 0.004),
                f"sd_input_{quantity}{b}": np.full(s.size, 0.003),
            }  # fmt: skip
    return found


def metrics(run: str = "sample-1", seeder: bool = True) -> dict[str, Any]:
    names = [n for n in RESPONSES if seeder or n.endswith("1")]
    channel = {
        "channel": "gps position", "count": 600, "rejected": 2, "dof": 2, "mean_nis": 1.97, "nis_low": 1.8,
        "nis_high": 2.2, "lag1_autocorrelation": 0.03, "consistent": True,
    }  # fmt: skip
    found: dict[str, Any] = {
        "schema": 1, "run": run,
        "verdict": {"value": "inconclusive", "scope": "pass", "reasons": ["one direction only"],
                    "codes": ["directions"], "threshold_percent": 15.0, "alpha": 0.05, "passes": 1,
                    "passes_needed": None},
        "discrepancy": {
            "trajectory": {"body1": 7.07, "body2": 7.1, "combined": 7.08, "interval": [4.0, 9.5]},
            "yaw": {"body1": 6.9, "body2": None, "combined": None, "interval": None},
        },
        "warnings": [
            {"sensor": "imd1", "file": "imd1.csv", "row": 12, "what": "time falls back", "effect": "dropped"}
        ],
        "health": {"imd1": {"samples": 6000, "rate_hz": 99.98, "gaps": 3, "longest_gap_s": 0.04}},
    }  # fmt: skip
    found["comparison"] = {
        "mode": "replay", "horizon": 25.0, "grid_step": GRID, "draws": 200, "excluded": [], "passed_over": [],
        "rows": [
            {"row": 0, "direction": "east", "line": "fitted", "length": 125.0, "coverage": 1.0, "windows": 5}
        ],
    }  # fmt: skip
    found["responses"] = {
        n: {"unit": "m", "percent": RESPONSES[n], "percent_null": 40.0, "interval": [4.0, 9.5], "rmse": 0.004,
            "rmse_null": 0.04, "r95": 0.12, "u": 0.003, "u_range": 0.003, "u_absolute": 0.01,
            "u_input": 0.002, "n_eff": 9.0,
            "n_eff_range": 12.0}
        for n in names
    }  # fmt: skip
    table = {n: RESPONSES[n] for n in names}
    found["disclosure"] = {
        key: {n: 2.0 * d for n, d in table.items()} for key in ("none", "start", "free", "null")
    }
    found["disclosure"]["bounded"] = table
    found["horizon_curve"] = [
        {"horizon": h, **{n: d * (h or 100.0) / 25.0 for n, d in table.items()}}
        for h in (10.0, 25.0, 50.0, None)
    ]
    scores = {"rmse": {"rmse": 0.004}, "nse": {"nse": 0.98}}
    found["companions"] = dict.fromkeys(names, scores)
    found["companions_null"] = dict.fromkeys(names, scores)
    found["attribution"] = {
        n: {"u_measuring": 0.004, "u_steering": 0.002, "u_start": 0.001, "u_parameters": 0.0, "u_val": 0.005,
            "share_within_2_u_val": 0.9, "rmse_known_uncertainty_q95": 0.006, "explained": True}
        for n in names
    }  # fmt: skip
    windows = [
        {"row": 0, "window": i, "offset": 0.001 * i, "heading_deg": 0.02, "steer_deg": -0.03, "chi2": 1.0 + i,
         "prior_weight": 1.0}
        for i in range(5)
    ]  # fmt: skip
    found["alignment"] = {"windows_within_bound": 1.0, "windows": windows}
    found["straightness"] = {n: {"max_abs": 0.07, "range": 0.13, "r95": 0.12, "rms": 0.04} for n in names}
    found["steering"] = {"source": "wheels", "testable": True, "sd_deg": 0.1, "correlation_time": 5.0,
                         "zero_sd_deg": 0.3, "scale_sd": 0.01}  # fmt: skip
    found["spectra"] = {}
    found["consistency"] = {"consistent": True, "channels": [channel]}
    noise = {"imd1": {"gyro": {"value": 1e-4, "unit": "rad/s/sqrt(Hz)", "source": "manifest"}}}
    calibration = {
        "lag": {"value": 0.1, "sd": 0.002, "unit": "s"},
        "wds1": {"tilt_x": {"value": -1e-3, "sd": 1e-4}},
    }
    found["fusion"] = {"noise": noise, "calibration": calibration}
    found["provenance"] = {
        "versions": {"smts-validate": "0.1.0"},
        "log_sha256": "ab" * 32,
        "options": {"engine": "compiled"},
    }
    return found


def pass_result(seeder: bool = True, seconds: float = 60.0) -> PassResult:
    text = toml(seeder)
    fused = motion(seconds, seeder)
    model = simulated(fused)
    return PassResult(
        manifest=manifests.parse(text), manifest_text=text, motion=fused, rows=rows(fused.t.size),
        simulated=model, metrics=metrics(seeder=seeder), comparison=comparison(fused, model),
    )  # fmt: skip


RUNS = {"a-east-1": ("east", 1), "a-east-2": ("east", 2), "a-west-1": ("west", 1), "a-west-2": ("west", 2)}


def campaign_pass(run: str, direction: str, repeat: int) -> PassResult:
    text = toml().replace('id = "sample-1"', f'id = "{run}"')
    text = text.replace('direction = "east"', f'direction = "{direction}"').replace(
        "repeat = 2", f"repeat = {repeat}"
    )
    made = pass_result()
    return replace(
        made, manifest=manifests.parse(text), manifest_text=text, metrics=metrics(run),
        simulated=simulated(made.motion, 1.0 + 0.02 * repeat),
    )  # fmt: skip


def campaign_folder(folder: Path) -> Path:
    """A batch's OUT of four passes, one left out, one failed; without its reports."""
    for run, (direction, repeat) in RUNS.items():
        write_result(folder / "passes" / run, campaign_pass(run, direction, repeat))
    settings = CampaignSettings(title="Spring <i>trials</i>", exclude={"a-west-2": "flat <b>tyre</b>"})
    records = [read_record(folder / "passes" / run) for run in RUNS]
    document = summarise_campaign(records, settings).document
    (folder / "campaign.json").write_text(dump_json(document), encoding="utf-8")
    failure = {"run": "a-east-9", "reason": "gps.nmea: no position in it"}
    (folder / "failures.json").write_text(json.dumps({"schema": 1, "failures": [failure]}), encoding="utf-8")
    return folder
