"""The estimation problem of one pass as arrays: inputs, measurements, starting state. Both engines solve it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ...sensors.geodesy import to_enu
from ...sensors.manifest import GRAVITY, Gps, Machine, Manifest, Seeder, Tractor
from ...sensors.streams import FieldLog, GnssStream
from . import settings as physics
from . import state as s
from .epochs import Epochs
from .ground import Slope, rough_mean, rough_pitch, standstills, undulation
from .motion import Origin
from .prepare import STEP, BodyInputs
from .rolling import WheelSpeed
from .settings import Levels

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EVERY_TILT = 2  # nodes between tilt and hitch measurements: 25 Hz
LEVEL_EVERY = 50
HITCH_FLOOR = 0.001  # m/s, white part of the seeder's lateral velocity
SLOWEST_COURSE = 0.5  # m/s: below it a receiver's course is noise
DRIVE_WINDOW = 51  # nodes: acceleration by the wheels is a slope over 1 s
STILL_SD = 0.005  # m/s
REST_GYRO_SD = 0.0003  # rad/s, least noise of a 20 ms mean at rest
FIXED = (4.0,)
AZIMUTH_FREE = 1.0  # rad: nothing is known of a magnetometer's constant error

Part = tuple[Ints, Ints, Floats, Floats, Floats]  # kind, node, value, variance, seconds ahead of the node


@dataclass(frozen=True)
class Measurements:
    """Scalar measurements sorted by node: kind, node, value, variance, seconds from the node to UTC validity."""

    kind: Ints
    node: Ints
    z: Floats
    var: Floats
    ahead: Floats

    def starts(self, nodes: int) -> Ints:
        """First measurement of each node, and the end: (nodes + 1,)."""
        return np.searchsorted(self.node, np.arange(nodes + 1)).astype(np.int64)


@dataclass(frozen=True)
class Problem:
    """Everything the engines need; see `state` for columns."""

    t: Floats
    step_inputs: Floats
    node_inputs: Floats
    measurements: Measurements
    inject: Floats
    parameters: Floats
    x0: Floats
    P0: Floats


def origin_of(log: FieldLog) -> Origin:
    """Origin of the plane: the first position of the first receiver, on its altitude."""
    for stream in log.of_type(GnssStream).values():
        ok = np.flatnonzero(np.isfinite(stream.lat) & (stream.quality > 0))
        if ok.size:
            i = int(ok[0])
            alt = float(stream.alt[i]) if np.isfinite(stream.alt[i]) else 0.0
            return Origin(float(stream.lat[i]), float(stream.lon[i]), alt)
    raise ValueError("gps: no position in the whole pass; check the receiver, or leave the pass out")


def epochs_of(log: FieldLog, origin: Origin) -> list[Epochs]:
    """All receivers' epochs in the plane, the tractor's first; without GST by fix quality and HDOP."""
    out: list[Epochs] = []
    streams = log.of_type(GnssStream)
    names = sorted(
        streams, key=lambda n: (log.manifest.of_kind("gps")[n].body != "tractor", streams[n].t.size == 0)
    )
    for name in names:
        gps: Gps = log.manifest.of_kind("gps")[name]
        g = streams[name]
        ok = np.isfinite(g.lat) & np.isfinite(g.lon) & (g.quality > 0) & (np.abs(g.lat) < 89.9)
        alt = np.where(np.isfinite(g.alt), g.alt, origin.alt)[ok]
        x, y, z = to_enu(g.lat[ok], g.lon[ok], alt, origin)
        sd, stated = _stated_sd(g)
        moving = g.speed > SLOWEST_COURSE
        first = gps.body == "tractor" and not any(e.first for e in out)
        out.append(
            Epochs(
                name, gps.body, first, g.t[ok], x, y, np.where(np.isfinite(g.alt[ok]), z, np.nan), sd[ok],
                np.isin(g.quality, FIXED)[ok],
                np.where(moving, g.speed * np.cos(g.course), np.nan)[ok],
                np.where(moving, g.speed * np.sin(g.course), np.nan)[ok],
                g.heading[ok], stated, g.speed[ok],
            )
        )  # fmt: skip
    return out


def _stated_sd(g: GnssStream) -> tuple[Floats, bool]:
    """Horizontal standard deviation of a component, m: from GST, else by quality times HDOP."""
    stated = np.sqrt(0.5 * (g.sd_east**2 + g.sd_north**2))
    hdop = np.clip(np.where(np.isfinite(g.hdop), g.hdop, 1.0), 0.7, 10.0)
    table = np.array([physics.UNSTATED.get(int(q), 5.0) for q in np.nan_to_num(g.quality)])
    known = np.isfinite(stated) & (stated > 0.0)
    return np.where(known, np.maximum(stated, 0.003), table * hdop), bool(known.mean() > 0.5)


def sway(body: Tractor | Seeder) -> float:
    """Height of a body's CoM above the axis it rolls about, m: 0 when the manifest states no roll centre."""
    return 0.0 if body.roll_centre is None else body.cog_height - body.roll_centre


def compliances(machine: Machine) -> tuple[float, float]:
    """Standard deviations, rad/(m/s²), of what a lateral force per mass makes the rear and the seeder's axle slip.

    COMPLIANCE; the seeder's few tyres, where the manifest's mass on them over their stated stiffness is more, that.
    """
    seeder, tyres = machine.seeder, machine.tyres.seeder
    if seeder is None or tyres is None:
        return physics.COMPLIANCE, physics.COMPLIANCE
    # about the hitch tyres and draft, which pulls against the way, hold the weight's part
    holding = 2.0 * len(seeder.axles) * tyres.cornering_stiffness
    arm = seeder.hitch_to_com + float(np.mean(seeder.axles))
    stated = seeder.mass * seeder.hitch_to_com / (holding * arm + seeder.draft * seeder.hitch_to_com)
    return physics.COMPLIANCE, max(physics.COMPLIANCE, stated)


def parameters_of(
    manifest: Manifest, epochs: Sequence[Epochs], one: BodyInputs, two: BodyInputs | None
) -> Floats:
    """Parameter vector of the kernels at the starting levels."""
    p = np.zeros(s.P_SIZE)
    tractor, seeder = manifest.machine.tractor, manifest.machine.seeder
    p[s.P_REAR] = tractor.rear_axle
    main = next(e for e in epochs if e.first)
    p[[s.P_ANT_X, s.P_ANT_Y, s.P_ANT_Z]] = manifest.of_kind("gps")[main.name].position
    p[s.P_SWAY] = sway(tractor)
    p[s.P_HITCH] = tractor.hitch - tractor.rear_axle
    p[s.P_TAU_SLIP], p[s.P_COMPLIANCE], p[s.P_TAU_E] = (
        physics.TAU_SLIP,
        physics.COMPLIANCE_FAST,
        physics.TAU_GNSS,
    )
    p[s.P_GYRO1], p[s.P_ACCEL] = one.gyro_noise, one.accel_noise
    p[s.P_KAPPA_WALK], p[s.P_KAPPA_DRIVE] = physics.WHEEL_WALK, physics.WHEEL_DRIVE
    p[s.P_TURN], p[s.P_TURN2] = compliances(manifest.machine)
    p[s.P_ACTIVE] = active(epochs)
    p[s.P_BIAS_WALK], p[s.P_TILT] = physics.BIAS_WALK, 1.0
    if seeder is not None and two is not None:
        p[s.P_SEEDER], p[s.P_GYRO2] = 1.0, two.gyro_noise
        p[s.P_AXLE2] = seeder.hitch_to_com + float(np.mean(seeder.axles))
        p[s.P_COM2] = seeder.hitch_to_com
        tools = max(physics.TOOLS, abs(p[s.P_AXLE2] - p[s.P_COM2]))
        p[s.P_DRAG2] = physics.DRAG * tools / p[s.P_AXLE2]
        p[s.P_SWAY2] = sway(seeder)
    second = [e for e in epochs if e is not main]
    if second:
        p[[s.P_ANT2_X, s.P_ANT2_Y, s.P_ANT2_Z]] = manifest.of_kind("gps")[second[0].name].position
    return p


def active(epochs: Sequence[Epochs]) -> int:
    """Number of leading state components that a pass needs: second receivers, float spans and headings come last."""
    if len(epochs) > 1:
        return s.SIZE
    if not all(e.fixed.all() for e in epochs):
        return s.FY + 1
    return s.SEEDER_HEADING + 1 if any(np.isfinite(e.heading).any() for e in epochs) else s.ALWAYS


def with_levels(p: Floats, levels: Levels, epochs: Sequence[Epochs]) -> Floats:
    """Parameters at other levels: slips, and the slow share of the receivers' stated deviations."""
    p = p.copy()
    p[s.P_FORWARD] = levels.forward * p[s.P_ACCEL]
    p[s.P_BETA1], p[s.P_BETA2] = levels.beta1, levels.beta2
    main = next(e for e in epochs if e.first)
    p[s.P_SD_E] = _slow(main.sd[main.fixed], levels.white_fixed)
    p[s.P_SD_F] = _slow(main.sd[~main.fixed], levels.white_float)
    second = [e for e in epochs if e is not main]
    p[s.P_SD_G] = _slow(second[0].sd, levels.white_second) if second else 0.0
    return p


def _slow(sd: Floats, white: float) -> float:
    """Slow part of a stated deviation whose white part is `white` of it; at least half of it, unseen or not."""
    return float(np.median(sd)) * math.sqrt(max(1.0 - white * white, 0.25)) if sd.size else 0.0


def inputs_of(
    one: BodyInputs,
    yaw_rate2: Floats | None,
    gap2: Floats | None,
    still: NDArray[np.bool_],
    wheel: WheelSpeed | None,
) -> Floats:
    """Step inputs (N-1, U_SIZE); a step is at rest when both its nodes are."""
    u = np.zeros((one.step_rate.shape[0], s.U_SIZE))
    u[:, s.U_WX : s.U_WZ + 1], u[:, s.U_FX : s.U_FY + 1] = one.step_rate, one.step_force[:, :2]
    u[:, s.U_GAP1] = one.gap
    u[:, s.U_REST] = still[1:] & still[:-1]
    if yaw_rate2 is not None and gap2 is not None:
        u[:, s.U_W2], u[:, s.U_GAP2] = yaw_rate2, gap2
    if wheel is not None and wheel.speed.size > DRIVE_WINDOW:
        slope = savgol_filter(np.nan_to_num(wheel.speed), DRIVE_WINDOW, 1, deriv=1, delta=STEP)
        u[:, s.U_DRIVE] = np.abs(slope[1:])
    return u


def nodes_of(one: BodyInputs, yaw_rate2: Floats | None, roll2: Floats, pitch2: Floats) -> Floats:
    """Node inputs (N, N_SIZE)."""
    nodes = np.zeros((one.node_rate.shape[0], s.N_SIZE))
    nodes[:, s.U_WX : s.U_WZ + 1], nodes[:, s.U_FX : s.U_FY + 1] = one.node_rate, one.node_force[:, :2]
    if yaw_rate2 is not None:
        nodes[:, s.U_W2] = yaw_rate2
    nodes[:, s.N_ROLL2], nodes[:, s.N_PITCH2] = roll2, pitch2
    return nodes


def measurements_of(
    t: Floats, epochs: Sequence[Epochs], nodes: Floats, still: NDArray[np.bool_], wheel: WheelSpeed | None,
    levels: Levels, p: Floats, lag: float, yaw: tuple[Floats, Floats | None], slow: NDArray[np.bool_],
    ground: Sequence[Part],
) -> Measurements:  # fmt: skip
    """All scalar measurements in the order of nodes; `lag` places GNSS epochs beside their nearest node.

    yaw : approximate yaws on the grid, by which receivers' headings are unwrapped
    slow : nodes where the machine creeps: its wheels' slip is not small against its speed there
    ground : of the slope under the machine, from `ground_parts`
    """
    parts: list[Part] = [*ground]
    for e in epochs:
        parts += _gnss(t, e, levels, lag, yaw, nodes, p)
    parts += _motion(nodes, still | slow, still, levels, p, wheel)
    parts += _rest(nodes, still, p)
    return sorted_parts(parts)


def sorted_parts(parts: Sequence[Part]) -> Measurements:
    """All parts' measurements in the order of nodes, within a node of kinds."""
    kind, node, z, var, ahead = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((kind, node))
    return Measurements(kind[order], node[order], z[order], var[order], ahead[order])


def with_azimuths(
    q: Measurements, azimuths: Sequence[tuple[int, Ints, Floats, float]], lag: float
) -> Measurements:
    """With magnetic azimuths (kind, node, rad, variance) at the nodes themselves, which are `lag` ahead of UTC."""
    if not azimuths:
        return q
    parts = [_part(kind, node, z, var, -lag) for kind, node, z, var in azimuths]
    return sorted_parts([(q.kind, q.node, q.z, q.var, q.ahead), *parts])


def _part(kind: int, node: Ints, z: Floats, var: Floats | float, ahead: Floats | float = 0.0) -> Part:
    n = node.size
    return (
        np.full(n, kind, dtype=np.int64), node.astype(np.int64), np.asarray(z, dtype=np.float64),
        np.broadcast_to(np.asarray(var, dtype=np.float64), n).copy(),
        np.broadcast_to(np.asarray(ahead, dtype=np.float64), n).copy(),
    )  # fmt: skip


def _gnss(
    t: Floats,
    e: Epochs,
    levels: Levels,
    lag: float,
    yaw: tuple[Floats, Floats | None],
    nodes: Floats,
    p: Floats,
) -> list[Part]:
    node = np.rint((e.t + lag - t[0]) / STEP).astype(np.int64)
    inside = (node >= 0) & (node < t.size)
    node, ahead = node[inside], (e.t - t[0])[inside] - node[inside] * STEP
    x, y, sd, fixed = e.x[inside], e.y[inside], e.sd[inside], e.fixed[inside]
    vx, vy, heading = e.vx[inside], e.vy[inside], e.heading[inside]
    parts = []
    if e.first:
        for kind, use, share in (
            (s.FIXED_X, fixed, levels.white_fixed), (s.FLOAT_X, ~fixed, levels.white_float)
        ):  # fmt: skip
            var = (share * sd[use]) ** 2
            parts += [
                _part(kind, node[use], x[use], var, ahead[use]),
                _part(kind + 1, node[use], y[use], var, ahead[use]),
            ]
        ok = np.isfinite(vx) & np.isfinite(vy)
        dvx, dvy = _swing(node[ok], (ahead[ok] + lag) / STEP, nodes, yaw[0], p)
        vx[ok], vy[ok] = vx[ok] - dvx, vy[ok] - dvy
        parts += [
            _part(s.VEL_X, node[ok], vx[ok], levels.velocity**2),
            _part(s.VEL_Y, node[ok], vy[ok], levels.velocity**2),
        ]
    else:
        kind = s.THIRD_X if e.body == "tractor" else s.SECOND_X
        var = (levels.white_second * sd) ** 2
        parts += [_part(kind, node, x, var, ahead), _part(kind + 1, node, y, var, ahead)]
    path = yaw[0] if e.body == "tractor" else yaw[1]
    ok = np.isfinite(heading)
    if ok.any() and path is not None:
        near = heading[ok] + 2.0 * math.pi * np.round((path[node[ok]] - heading[ok]) / (2.0 * math.pi))
        kind = s.HEADING1 if e.body == "tractor" else s.HEADING2
        parts.append(_part(kind, node[ok], near, physics.HEADING_SD**2, ahead[ok]))
    return parts


def _swing(node: Ints, ahead: Floats, nodes: Floats, yaw: Floats, p: Floats) -> tuple[Floats, Floats]:
    """What the antenna's velocity about the body changes from the node to the epoch, m/s east and north.

    A roof antenna swings at 0.2 m/s within a fifth of a second: 10 ms matter. Small tilt; `ahead` in nodes.
    """
    rates = nodes[:, s.U_WX : s.U_WZ + 1]
    other = np.clip(node + np.sign(ahead).astype(np.int64), 0, nodes.shape[0] - 1)
    change = (rates[other] - rates[node]) * np.abs(ahead)[:, None]
    height = p[s.P_TILT] * (p[s.P_ANT_Z] + p[s.P_SWAY])
    along = height * change[:, 1] - p[s.P_ANT_Y] * change[:, 2]
    across = (p[s.P_REAR] + p[s.P_ANT_X]) * change[:, 2] - height * change[:, 0]
    c, sn = np.cos(yaw[node]), np.sin(yaw[node])
    return along * c - across * sn, along * sn + across * c


def _motion(
    nodes: Floats,
    slow: NDArray[np.bool_],
    still: NDArray[np.bool_],
    levels: Levels,
    p: Floats,
    wheel: WheelSpeed | None,
) -> list[Part]:
    every = np.arange(0, nodes.shape[0], EVERY_TILT)
    moving = every[~slow[every]]
    noise = (levels.lateral * p[s.P_ACCEL]) ** 2 / STEP
    parts = [_part(s.ACCEL_Y, every, nodes[every, s.U_FY], noise)]
    if p[s.P_SEEDER] > 0.0:
        rate1, rate2 = (p[s.P_GYRO1] * p[s.P_HITCH]) ** 2 / STEP, (p[s.P_GYRO2] * p[s.P_AXLE2]) ** 2 / STEP
        parts.append(
            _part(s.HITCH, moving, np.zeros(moving.size), HITCH_FLOOR**2 + levels.hitch**2 * (rate1 + rate2))
        )
    if wheel is not None:
        parts.append(_part(s.WHEEL, *wheel.measured(still, levels.wheel)))
    return parts


def _rest(nodes: Floats, still: NDArray[np.bool_], p: Floats) -> list[Part]:
    """What a standing machine shows: no speed, no slip, gyros at their biases, the pitch."""
    k = np.flatnonzero(still)[::EVERY_TILT]
    zero = np.zeros(k.size)
    parts = [_part(s.STILL_V, k, zero, STILL_SD**2), _part(s.STILL_SLIP, k, zero, STILL_SD**2)]
    columns = [(s.STILL_GX, s.U_WX), (s.STILL_GY, s.U_WY), (s.STILL_GZ, s.U_WZ)]
    columns += [(s.STILL_GZ2, s.U_W2)] if p[s.P_SEEDER] > 0.0 else []
    for kind, column in columns:
        parts.append(_part(kind, k, nodes[k, column], _rest_variance(nodes[k, column])))
    parts.append(_part(s.STILL_AX, k, nodes[k, s.U_FX], p[s.P_ACCEL] ** 2 / STEP))
    return parts


def ground_parts(t: Floats, main: Epochs, yaw: Floats, slope: Slope, way: Floats) -> tuple[Part, ...]:
    """Roll and pitch of the ground once a second, weighted so that all of them know its mean slope only once.

    yaw : (N,) of the tractor; way : (N,) m, distance along the heading
    """
    gradient, covariance = slope.gradient, slope.covariance
    hill = undulation(main, gradient, way, t, yaw)
    k = np.arange(0, t.size, LEVEL_EVERY)
    c, sn = np.cos(yaw[k]), np.sin(yaw[k])
    across, along = rough_mean(t[-1] - t[0]), rough_pitch(t[-1] - t[0], standstills(way, STEP))
    parts = []
    for kind, axis, beside, rough in (
        (s.LEVEL_ROLL, np.column_stack([-sn, c]), 0.0, across),
        (s.LEVEL_PITCH, np.column_stack([-c, -sn]), -hill[k], along),
    ):
        variance = np.einsum("ni,ij,nj->n", axis, covariance, axis) + rough
        parts.append(_part(kind, k, np.arctan(axis @ gradient + beside), variance * k.size))
    return tuple(parts)


def _rest_variance(v: Floats) -> float:
    """White variance of a gyro's readings at rest that gives means over half a second their seen spread."""
    size = 25 // EVERY_TILT
    blocks = v[: v.size // size * size].reshape(-1, size).mean(axis=1)
    seen = float(np.var(blocks)) * size if blocks.size > 3 else 0.0
    return max(seen, float(np.var(v)) if v.size else 0.0, REST_GYRO_SD**2)


def starting_state(
    manifest: Manifest, p: Floats, position: tuple[float, float], yaw: tuple[float, float], speed: float,
    lag_sd: float, nodes: Floats, bias: Floats | None,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Wide prior at the first node, and its covariance (diagonal).

    bias : (4,) mean gyro readings of the first rest (x, y, z of the tractor, z of the seeder), or None
    """
    x, sd = np.zeros(s.SIZE), np.zeros(s.SIZE)
    fwd = p[s.P_REAR] + p[s.P_ANT_X]
    x[s.X] = position[0] - fwd * math.cos(yaw[0]) + p[s.P_ANT_Y] * math.sin(yaw[0])
    x[s.Y] = position[1] - fwd * math.sin(yaw[0]) - p[s.P_ANT_Y] * math.cos(yaw[0])
    x[s.YAW1], x[s.YAW2], x[s.V] = yaw[0], yaw[1], speed
    level = nodes[: max(1, min(100, nodes.shape[0]))].mean(axis=0)
    x[s.ROLL], x[s.PITCH] = (
        math.asin(min(max(level[s.U_FY] / GRAVITY, -0.5), 0.5)),
        -math.asin(min(max(level[s.U_FX] / GRAVITY, -0.5), 0.5)),
    )
    imd = [u for u in manifest.of_kind("imd").values() if u.body == "tractor"]
    gyro = max((u.gyro_bias or physics.GYRO_BIAS) for u in imd)
    accel = max((u.accel_bias or physics.ACCEL_BIAS) for u in imd)
    if bias is not None:
        x[[s.BGX, s.BGY, s.BGZ, s.BGZ2]] = bias
    sd[[s.X, s.Y]], sd[[s.YAW1, s.YAW2]], sd[s.V], sd[s.SLIP1] = 5.0, 0.3, 1.0, 0.05
    sd[[s.ROLL, s.PITCH]], sd[[s.BGX, s.BGY, s.BGZ]], sd[[s.BAX, s.BAY]] = 0.1, gyro, accel
    sd[[s.EX, s.EY]], sd[[s.FX, s.FY]], sd[[s.GX, s.GY]] = p[s.P_SD_E], p[s.P_SD_F], p[s.P_SD_G]
    sd[s.SCALE1] = physics.GYRO_SCALE
    sd[s.LAG], sd[s.KAPPA] = lag_sd, physics.RADIUS_SD
    sd[[s.HEADING, s.SEEDER_HEADING]] = physics.HEADING_SD if p[s.P_ACTIVE] > s.HEADING else 0.0
    if p[s.P_SEEDER] > 0.0:
        sd[s.BGZ2], sd[s.SLIP2], sd[s.SCALE2] = physics.GYRO_BIAS, 0.05, physics.GYRO_SCALE
    else:
        sd[s.YAW2] = 0.0
    return x, np.diag(sd**2)
