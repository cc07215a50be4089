"""A raw pass written by hand-made formulas, independent of the project's own simulator: truth is known."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from smts_validate.sensors.draft_text import MACHINE

Floats = NDArray[np.float64]
START = dt.datetime(2025, 5, 14, 10, 0, 0, tzinfo=dt.UTC).timestamp()
GRAVITY = 9.80665
LAT, LON, ALT, GEOID = 50.04, 36.49, 150.0, 16.0
METRES_A_DEGREE = 111_226.0  # of latitude, near 50° north, on the ellipsoid
METRES_A_DEGREE_EAST = 71_615.0
AXLE, ANTENNA = 1.15, (0.4, 0.0, 2.1)

MANIFEST = (
    """schema = 1
[run]
id = "{id}"
date = 2025-05-14
[operating]
speed = 2.5
tyre_pressure_mpa = 0.12
"""
    + MACHINE
    + """[sensors.imd1]
kind = "imd"
body = "tractor"
file = "imd1.csv"
position = [0.3, 0.0, -0.2]
rate = 100.0
{imd1}
[sensors.gps]
kind = "gps"
file = "gps.nmea"
position = [0.4, 0.0, 2.1]
rate = 10.0
{rest}
"""
)


@dataclass(frozen=True)
class Plan:
    """What the pass is like: how far the logger is ahead of UTC, latencies, drift of the unit's counter."""

    seconds: float = 60.0
    offset: float = 2.25
    gnss_latency: float = 0.08
    drift: float = 40e-6
    seed: int = 0
    imd1: str = ""
    rest: str = ""
    id: str = "sample"
    extra: dict[str, str] = field(default_factory=dict)


def yaw(t: Floats) -> Floats:
    """Heading of the tractor, rad."""
    return 0.25 * np.sin(2 * np.pi * t / 13.0) + 0.1 * np.sin(2 * np.pi * t / 4.7 + 1.0) + 0.002 * t


def yaw_rate(t: Floats) -> Floats:
    """Its derivative, by hand."""
    slow, fast = 2 * np.pi / 13.0, 2 * np.pi / 4.7
    return 0.25 * slow * np.cos(slow * t) + 0.1 * fast * np.cos(fast * t + 1.0) + 0.002


def antenna(t: Floats, speed: float = 2.5) -> tuple[Floats, Floats]:
    """East, north of the antenna; the rear axle's middle rolls without slip."""
    fine = np.arange(-1.0, t.max() + 1.0, 1e-3)
    east = np.concatenate([[0.0], np.cumsum(speed * np.cos(yaw(fine[:-1] + 5e-4)) * 1e-3)])
    north = np.concatenate([[0.0], np.cumsum(speed * np.sin(yaw(fine[:-1] + 5e-4)) * 1e-3)])
    ahead = AXLE + ANTENNA[0]
    return (
        np.interp(t, fine, east) + ahead * np.cos(yaw(t)),
        np.interp(t, fine, north) + ahead * np.sin(yaw(t)),
    )


def checked(body: str) -> str:
    """A sentence with `$` and checksum."""
    total = 0
    for letter in body:
        total ^= ord(letter)
    return f"${body}*{total:02X}"


def degrees_minutes(angle: float, digits: int) -> str:
    """ddmm.mmmmmmmm"""
    whole = int(angle)
    return f"{whole:0{digits}d}{(angle - whole) * 60.0:011.8f}"


def imu_lines(plan: Plan) -> list[str]:
    """Rows of imd1.csv, without header."""
    rng = np.random.default_rng(plan.seed)
    n = int(plan.seconds * 100)
    t = np.arange(n) / (100.0 * (1.0 + plan.drift))
    counter = (4_294_000_000 + np.rint(t * (1.0 + plan.drift) * 1e6).astype(np.int64)) % 2**32
    latency = 1e-3 + np.minimum(rng.gamma(1.2, 3e-3, n), 19e-3)
    host = np.rint((START + t + plan.offset + latency) * 1e9).astype(np.int64)
    noise = rng.normal(0.0, 1.0, (n, 6)) * [0.1, 0.1, 0.1, 0.002, 0.002, 0.002]
    rate = yaw_rate(t)
    values = noise + np.column_stack([0 * t, 2.5 * rate, GRAVITY + 0 * t, 0 * t, 0 * t, rate])
    return [
        f"{h},{c},{(65_000 + k) % 2**16}," + ",".join(f"{x:.6f}" for x in v)
        for k, (h, c, v) in enumerate(zip(host.tolist(), counter.tolist(), values.tolist(), strict=True))
    ]


def gps_lines(plan: Plan, prefix: bool = True) -> list[str]:
    """Sentences of gps.nmea: GGA, VTG and GST each 0.1 s."""
    rng = np.random.default_rng(plan.seed + 1)
    t = np.arange(0.0, plan.seconds, 0.1)
    east, north = antenna(t)
    step = 0.01
    ahead_e, ahead_n = antenna(t + step)
    course = np.degrees(np.arctan2(ahead_e - east, ahead_n - north)) % 360.0
    speed = np.hypot(ahead_e - east, ahead_n - north) / step * 3.6
    arrival = START + t + plan.offset + plan.gnss_latency + rng.gamma(2.0, 0.02, t.size)
    lines = []
    for k in range(t.size):
        moment = dt.datetime.fromtimestamp(START + t[k], tz=dt.UTC)
        clock = f"{moment:%H%M%S}.{round(t[k] * 10) % 10}0"
        lat = degrees_minutes(LAT + north[k] / METRES_A_DEGREE, 2)
        lon = degrees_minutes(LON + east[k] / METRES_A_DEGREE_EAST, 3)
        bodies = (
            f"GNGGA,{clock},{lat},N,{lon},E,4,16,0.8,{ALT - GEOID:.3f},M,{GEOID:.3f},M,1.0,0001",
            f"GNVTG,{course[k]:.2f},T,,M,{speed[k] / 1.852:.3f},N,{speed[k]:.3f},K,R",
            f"GNGST,{clock},0.017,0.013,0.013,0.0,0.011,0.012,0.026",
        )
        for order, body in enumerate(bodies):
            stamp = f"{round((arrival[k] + 0.005 * order) * 1e9)} " if prefix else ""
            lines.append(stamp + checked(body))
    return lines


def write_pass(folder: Path, plan: Plan | None = None, prefix: bool = True) -> Path:
    """run.toml, imd1.csv, gps.nmea and whatever the plan adds."""
    plan = plan or Plan()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.toml").write_text(MANIFEST.format(id=plan.id, imd1=plan.imd1, rest=plan.rest))
    header = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz"
    (folder / "imd1.csv").write_text("\n".join([header, *imu_lines(plan)]) + "\n")
    (folder / "gps.nmea").write_text("\r\n".join(gps_lines(plan, prefix)) + "\r\n")
    for name, text in plan.extra.items():
        (folder / name).write_text(text)
    return folder
