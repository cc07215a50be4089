"""Seeded twins for the tests of fusion, and the errors of a fused motion against their truth."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
from smts_validate.pipeline.fusion.ground import STEEPEST
from smts_validate.pipeline.fusion.motion import BodyMotion, Motion, Origin
from smts_validate.pipeline.fusion.offsets import FACTOR
from smts_validate.pipeline.fusion.settings import ACCEL_BIAS, CRAB, LEVER_SD, SLOPE
from smts_validate.pipeline.twin import make_pass, write_raw
from smts_validate.pipeline.twin_plan import TwinPlan, preset, with_value
from smts_validate.sensors.geodesy import to_enu
from smts_validate.sensors.ingest import read_pass
from smts_validate.sensors.streams import FieldLog, GnssStream

PLACE = (50.041266, 36.485128, 148.5)
SETTLED = 2.0  # s left out at both ends
KINDS = ("benign", "bad_sensors", "outage", "headland")
AXLES = ("front", "rear", "seeder")
STIFFNESS = 0.4  # of the logarithm: cornering stiffness on soil is known to a factor of 1.5


@dataclasses.dataclass(frozen=True)
class Sample:
    """A twin's log and its truth: rows of t, x1, y1, yaw1, v1, x2, y2, yaw2, steer, ENU at `place`."""

    log: FieldLog
    truth: np.ndarray
    place: tuple[float, float, float]


def changed(plan: TwinPlan, **values: object) -> TwinPlan:
    """A plan with dotted keys changed; dots are written as double underscores."""
    for key, value in values.items():
        plan = with_value(plan, key.replace("__", "."), value)
    return plan


def plan_of(seed: int, slope: float | None = None, pulls: bool = True) -> tuple[str, TwinPlan]:
    """A seed's kind of pass and its plan, with all that the fusion only doubts drawn from the doubt that it states.

    slope : deviation of the ground's gradient, None: drawn; pulls : whether the weight's part along it pulls aside
    """
    rng = np.random.default_rng(seed)
    kind = KINDS[seed % len(KINDS)]
    heading, east, north, steep = rng.uniform(-180.0, 180.0), *rng.standard_normal(2), rng.uniform()
    offset = ACCEL_BIAS * FACTOR ** rng.standard_normal()
    if slope is None:  # half-Cauchy, as far as fields are sown
        slope = SLOPE * math.tan(steep * math.atan(STEEPEST / SLOPE))
    plan = changed(
        preset(kind),
        place__heading_deg=float(heading),
        soil__slope_east=float(east * slope),
        soil__slope_north=float(north * slope),
        soil__weight_pulls=pulls,
        errors__lever_arm=LEVER_SD,
        errors__accel_bias=float(offset),
    )
    stiffer = np.exp(STIFFNESS * rng.standard_normal(3))
    tyres = {f"tyres.{axle}.cornering_stiffness": float(f) for axle, f in zip(AXLES, stiffer, strict=True)}
    tractor, seeder = np.degrees(lasting_crab(plan) * rng.standard_normal(2))
    plan = changed(plan, soil__crab_tractor_deg=float(tractor), soil__crab_seeder_deg=float(seeder))
    return kind, dataclasses.replace(plan, truth={**plan.truth, **tyres})


def lasting_crab(plan: TwinPlan) -> np.ndarray:
    """Deviations (2,), rad, of the tractor's and the seeder's crab: the share of their slip that stays along a row."""
    front, rear, seeder = (plan.machine["tyres"][axle]["cornering_stiffness"] for axle in AXLES)
    forces = np.array([plan.soil.side_force_tractor, plan.soil.side_force_seeder])
    return CRAB * forces / (2.0 * np.array([front + rear, seeder]))


def make(plan: TwinPlan, seed: int) -> Sample:
    """A plan's pass, written raw and read back."""
    twin = make_pass(plan, seed)
    with tempfile.TemporaryDirectory() as folder:
        write_raw(twin, Path(folder) / "pass")
        log = read_pass(Path(folder) / "pass")
    place = plan.place
    return Sample(log, twin.truth, (place.lat, place.lon, place.alt))


@lru_cache(maxsize=8)
def sample(name: str, seed: int) -> Sample:
    """A preset's pass, made once a session."""
    return make(preset(name), seed)


def enu_between(motion: Motion, place: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Turn (3, 3) and shift (3,) that bring the motion's plane to the truth's, by ECEF (WGS-84)."""
    a, e2 = 6378137.0, 6.69437999014e-3

    def ecef(lat: float, lon: float, alt: float) -> np.ndarray:
        n = a / np.sqrt(1.0 - e2 * np.sin(lat) ** 2)
        return np.array(
            [
                (n + alt) * np.cos(lat) * np.cos(lon),
                (n + alt) * np.cos(lat) * np.sin(lon),
                (n * (1.0 - e2) + alt) * np.sin(lat),
            ]
        )

    def axes(lat: float, lon: float) -> np.ndarray:
        return np.array(
            [
                [-np.sin(lon), np.cos(lon), 0.0],
                [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)],
                [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)],
            ]
        )

    o = motion.origin
    here = (np.radians(o.lat), np.radians(o.lon))
    there = (np.radians(place[0]), np.radians(place[1]))
    turn = axes(*there) @ axes(*here).T
    return turn, axes(*there) @ (ecef(*here, o.alt) - ecef(*there, place[2]))


def errors(motion: Motion, of: Sample) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Error and stated deviation of lateral and along (m) and yaw (rad) of each body, steering (rad)."""
    truth = of.truth
    use = (motion.t > truth[0, 0] + SETTLED) & (motion.t < truth[-1, 0] - SETTLED)
    turn, shift = enu_between(motion, of.place)
    out = {}
    for body, (b, columns) in enumerate(zip(motion.bodies, ((1, 2, 3), (5, 6, 7)), strict=False), 1):
        yaw = np.interp(motion.t, truth[:, 0], np.unwrap(truth[:, columns[2]]))
        place = np.column_stack([b.x, b.y, np.zeros(b.x.size)]) @ turn.T + shift
        dx, dy = (place[:, i] - np.interp(motion.t, truth[:, 0], truth[:, columns[i]]) for i in (0, 1))
        turned = b.yaw - yaw
        turned -= 2.0 * np.pi * np.round(np.median(turned) / (2.0 * np.pi))
        c, s = np.cos(yaw), np.sin(yaw)
        out[f"lateral{body}"] = (-s * dx + c * dy)[use], _sd(b, -s, c)[use]
        out[f"along{body}"] = (c * dx + s * dy)[use], _sd(b, c, s)[use]
        out[f"yaw{body}"] = turned[use], b.sd(2)[use]
    steer = motion.steer - np.interp(motion.t, truth[:, 0], truth[:, 8])
    known = use & np.isfinite(steer)
    out["steer"] = steer[known], motion.sd_steer[known]
    return out


def _sd(b: BodyMotion, east: np.ndarray, north: np.ndarray) -> np.ndarray:
    C = b.covariance
    return np.sqrt(east**2 * C[:, 0, 0] + 2.0 * east * north * C[:, 0, 1] + north**2 * C[:, 1, 1])


def receiver_slow_error(of: Sample) -> np.ndarray:
    """Lateral error of the receiver itself, slower than 5 s, m: its positions less the truth's untilted antenna."""
    name, g = next(iter(of.log.of_type(GnssStream).items()))
    ahead, left, _ = of.log.manifest.sensors[name].position
    x, y, _ = to_enu(g.lat, g.lon, g.alt, Origin(*of.place))
    truth = of.truth
    yaw = np.interp(g.t, truth[:, 0], np.unwrap(truth[:, 3]))
    c, s = np.cos(yaw), np.sin(yaw)
    dx = x - np.interp(g.t, truth[:, 0], truth[:, 1]) - ahead * c + left * s
    dy = y - np.interp(g.t, truth[:, 0], truth[:, 2]) - ahead * s - left * c
    window = max(int(5.0 / np.median(np.diff(g.t))), 1)
    slow = np.convolve(c * dy - s * dx, np.ones(window) / window, mode="same")
    return slow[(g.t > truth[0, 0] + SETTLED) & (g.t < truth[-1, 0] - SETTLED)]


def rms(values: np.ndarray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
