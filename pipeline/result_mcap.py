"""result.mcap: measured and simulated motion as ROS 2 messages, to open beside the log.

Frames: `map` is the ENU plane of the result, its z axis up; `tractor`, `seeder` are the measured bodies, and
`tractor_simulated`, `seeder_simulated` the model's. The motion is planar, so z, roll and pitch are zero and
their variances say that they are not known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sensors.cdr import message_type, serialise, stamp_columns
from ..sensors.geodesy import to_geodetic
from ..sensors.log import Attachment, Channel, messages, write_channels
from ..sensors.log_topics import to_ns
from ..sensors.ros_messages import definition
from .fusion.motion import Origin
from .report_view import BODY_NAMES, Columns, PassView
from .result_scene import MAP, scene

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ODOMETRY, POSE, FIX = "nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseStamped", "sensor_msgs/msg/NavSatFix"
TRANSFORMS, SCENE, NUMBER = "tf2_msgs/msg/TFMessage", "foxglove_msgs/msg/SceneUpdate", "std_msgs/msg/Float64"
UNKNOWN_VARIANCE = 1e6  # m², rad²: of what planar motion does not tell
PX, PY, PZ, ROLL, PITCH, TURN = range(6)  # order of ROS covariances
QOS = {"offered_qos_profiles": ""}


@dataclass(frozen=True)
class _Body:
    """One moving frame: its samples where it has a place, and its sds (NaN: not stated)."""

    frame: str
    topic: str
    t_ns: Ints
    x: Floats
    y: Floats
    yaw: Floats
    v: Floats
    yaw_rate: Floats
    sd_along: Floats
    sd_lateral: Floats
    sd_yaw: Floats
    sd_v: Floats
    sd_yaw_rate: Floats


def write_result_log(path: Path, view: PassView) -> None:
    """Write result.mcap of a stored result."""
    bodies = list(_bodies(view))
    channels = [channel for body in bodies for channel in _channels(body, view)]
    channels += [*_transforms(bodies), *_residuals(view), *_scene(view)]
    start = int(to_ns(view.trajectory["t"][:1])[0])
    attached = (Attachment("run.toml", "application/toml", view.manifest_text.encode(), start),)
    verdict = view.metrics.get("verdict") or {}
    metadata = {"smts.result": {"run": view.manifest.run.id, "verdict": str(verdict.get("value", ""))}}
    write_channels(path, channels, attached, metadata)


def _bodies(view: PassView) -> Iterator[_Body]:
    for b in view.bodies:
        yield _body(view.trajectory, b, f"/measured/{BODY_NAMES[b]}", BODY_NAMES[b])
        if b in view.simulated_bodies:
            yield _body(view.simulation, b, f"/simulated/{BODY_NAMES[b]}", f"{BODY_NAMES[b]}_simulated")


def _body(columns: Columns, b: str, topic: str, frame: str) -> _Body:
    there = np.isfinite(columns[f"x{b}"]) & np.isfinite(columns[f"yaw{b}"])
    nothing = np.full(there.size, np.nan)
    names = ("x", "y", "yaw", "v", "yaw_rate", "sd_along", "sd_lateral", "sd_yaw", "sd_v", "sd_yaw_rate")
    values = {name: np.asarray(columns.get(f"{name}{b}", nothing)[there]) for name in names}
    return _Body(frame, topic, to_ns(columns["t"][there]), **values)


def _channels(body: _Body, view: PassView) -> Iterator[Channel]:
    pose, turn = _pose_columns(body, "pose.pose"), _pose_columns(body, "pose")
    stamp = stamp_columns("header.stamp", body.t_ns)
    head = {"header": {"frame_id": MAP}}
    motion = {
        "twist.twist.linear.x": np.nan_to_num(body.v), "twist.twist.angular.z": np.nan_to_num(body.yaw_rate),
        "pose.covariance": _pose_covariance(body), "twist.covariance": _twist_covariance(body),
    }  # fmt: skip
    odometry = messages(ODOMETRY, {**head, "child_frame_id": body.frame}, {**stamp, **pose, **motion})
    yield Channel(f"{body.topic}/odometry", ODOMETRY, body.t_ns, odometry, metadata=QOS)
    yield Channel(
        f"{body.topic}/pose", POSE, body.t_ns, messages(POSE, head, {**stamp, **turn}), metadata=QOS
    )
    origin = Origin(view.origin["lat"], view.origin["lon"], view.origin["alt"])
    lat, lon, alt = to_geodetic(body.x, body.y, np.zeros(body.x.size), origin)
    place = {**stamp, "latitude": lat, "longitude": lon, "altitude": alt}
    values = {"header": {"frame_id": body.frame}, "status": {"service": 1}}
    yield Channel(f"{body.topic}/fix", FIX, body.t_ns, messages(FIX, values, place), metadata=QOS)


def _pose_columns(body: _Body, path: str) -> dict[str, NDArray[Any]]:
    return {
        f"{path}.position.x": body.x, f"{path}.position.y": body.y,
        f"{path}.orientation.z": np.sin(0.5 * body.yaw), f"{path}.orientation.w": np.cos(0.5 * body.yaw),
    }  # fmt: skip


def _pose_covariance(body: _Body) -> Floats:
    """(N, 36) of (x, y, z, roll, pitch, yaw); along and across the body are taken as independent."""
    matrix = np.zeros((body.x.size, 6, 6))
    matrix[:, [PZ, ROLL, PITCH], [PZ, ROLL, PITCH]] = UNKNOWN_VARIANCE
    along, across = _variance(body.sd_along), _variance(body.sd_lateral)
    c, s = np.cos(body.yaw), np.sin(body.yaw)
    matrix[:, PX, PX] = c * c * along + s * s * across
    matrix[:, PY, PY] = s * s * along + c * c * across
    matrix[:, PX, PY] = matrix[:, PY, PX] = s * c * (along - across)
    matrix[:, TURN, TURN] = _variance(body.sd_yaw)
    return matrix.reshape(-1, 36)


def _twist_covariance(body: _Body) -> Floats:
    """(N, 36) of the velocity in the body's own frame."""
    matrix = np.zeros((body.x.size, 6, 6))
    matrix[:, range(6), range(6)] = UNKNOWN_VARIANCE
    matrix[:, PX, PX], matrix[:, TURN, TURN] = _variance(body.sd_v), _variance(body.sd_yaw_rate)
    return matrix.reshape(-1, 36)


def _variance(sd: Floats) -> Floats:
    """Squares; zero where no deviation is stated (ROS: not known)."""
    return np.nan_to_num(np.square(sd))


def _transforms(bodies: list[_Body]) -> Iterator[Channel]:
    """/tf: a channel for frames that live together: the measured bodies always, the model's inside rows."""
    for wanted in (False, True):
        group = [body for body in bodies if body.frame.endswith("_simulated") == wanted]
        if not group:
            continue
        shared = reduce(np.intersect1d, [body.t_ns for body in group])
        values = {"transforms": [{"header": {"frame_id": MAP}, "child_frame_id": b.frame} for b in group]}
        columns: dict[str, NDArray[Any]] = {}
        for index, body in enumerate(group):
            at = np.isin(body.t_ns, shared)
            columns |= _transform_columns(body, f"transforms.{index}", at)
        yield Channel("/tf", TRANSFORMS, shared, messages(TRANSFORMS, values, columns), metadata=QOS)


def _transform_columns(body: _Body, path: str, at: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    yaw = 0.5 * body.yaw[at]
    return {
        **stamp_columns(f"{path}.header.stamp", body.t_ns[at]),
        f"{path}.transform.translation.x": body.x[at],
        f"{path}.transform.translation.y": body.y[at],
        f"{path}.transform.rotation.z": np.sin(yaw),
        f"{path}.transform.rotation.w": np.cos(yaw),
    }


def _residuals(view: PassView) -> Iterator[Channel]:
    """Simulated less measured over time, to plot: deviation in m, yaw in rad."""
    grid = view.comparison
    for b in view.bodies:
        for quantity, name in (("n", "deviation"), ("yaw", "yaw")):
            if f"{quantity}{b}_simulated" not in grid:
                continue
            residual = grid[f"{quantity}{b}_simulated"] - grid[f"{quantity}{b}"]
            here = np.isfinite(residual)
            order = np.argsort(grid[f"t{b}"][here], kind="stable")
            t_ns, values = to_ns(grid[f"t{b}"][here][order]), residual[here][order]
            topic = f"/residual/{BODY_NAMES[b]}/{name}"
            yield Channel(topic, NUMBER, t_ns, messages(NUMBER, {}, {"data": values}), metadata=QOS)


def _scene(view: PassView) -> Iterator[Channel]:
    start = to_ns(view.trajectory["t"][:1])
    stamp = {name.rpartition(".")[2]: int(value[0]) for name, value in stamp_columns("stamp", start).items()}
    kind = message_type(SCENE, definition(SCENE))
    payload = serialise(kind, scene(view, stamp))
    yield Channel("/scene", SCENE, start, [payload], metadata=QOS)
