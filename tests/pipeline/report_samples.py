"""A small made-up pass result for the tests of result and report: a weaving row with a known closed form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion, Origin, SteerInput
from smts_validate.pipeline.result import PassResult
from smts_validate.sensors import manifest as manifests

Floats = NDArray[np.float64]

AMPLITUDE = 0.06  # m, of the weave
WAVELENGTH = 22.0  # m
SPEED = 2.5  # m/s
DRAWBAR = 5.0  # m, between the two centres of mass
HEADING = 0.4  # rad, of the row from East
T0 = 1_747_303_260.0  # s, UTC

TOML = """schema = 1
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
[machine.tractor]
mass = 5200.0
yaw_inertia = 9500.0
front_track = 1.90
rear_track = 1.80
front_axle = 1.45
rear_axle = 1.15
hitch = 2.05
cog_height = 1.0
front_wheel_radius = 0.62
rear_wheel_radius = 0.80
[machine.tyres.front]
cornering_stiffness = 6.0e4
friction = 0.6
rolling_resistance = 0.08
[machine.tyres.rear]
cornering_stiffness = 9.0e4
friction = 0.6
rolling_resistance = 0.08
[sensors.imd1]
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

SEEDER_TOML = """
[machine.seeder]
mass = 3300.0
yaw_inertia = 5200.0
hitch_to_com = 3.0
com_to_axle = 0.35
track = 3.60
cog_height = 0.9
wheel_radius = 0.50
draft = 9000.0
[machine.tyres.seeder]
cornering_stiffness = 4.0e4
friction = 0.6
rolling_resistance = 0.08
[sensors.imd2]
kind = "imd"
body = "seeder"
file = "imd2.csv"
position = [0.0, 0.0, 0.2]
rate = 100.0
"""


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


def metrics(run: str = "sample-1") -> dict[str, Any]:
    return {
        "schema": 1, "run": run,
        "verdict": {"value": "inconclusive", "scope": "pass", "reasons": ["one direction only"]},
        "discrepancy": {
            "trajectory": {"body1": 7.07, "body2": 7.1, "combined": 7.08, "interval": [4.0, 9.5]},
            "yaw": {"body1": 6.9, "body2": None, "combined": None, "interval": None},
        },
        "warnings": [
            {"sensor": "imd1", "file": "imd1.csv", "row": 12, "what": "time falls back", "effect": "dropped"}
        ],
        "health": {},
    }  # fmt: skip


def pass_result(seeder: bool = True, seconds: float = 60.0) -> PassResult:
    text = toml(seeder)
    fused = motion(seconds, seeder)
    return PassResult(
        manifest=manifests.parse(text), manifest_text=text, motion=fused, rows=rows(fused.t.size),
        simulated=simulated(fused), metrics=metrics(),
    )  # fmt: skip
