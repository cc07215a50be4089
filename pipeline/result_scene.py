"""The pass as a scene (foxglove_msgs/SceneUpdate): machines' outlines, tracks, residuals, the verdict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..sensors.manifest import Seeder, Tractor
from .report_view import BODY_NAMES, PassView

Floats = NDArray[np.float64]
Values = dict[str, Any]

LINE_STRIP, LINE_LOOP, LINE_LIST = 0, 1, 2
MAP = "map"
THIN, TYRE_WIDTH = 0.04, 0.35  # m
RESIDUAL_STEP = 1.0  # m along the row between residual strokes
EXAGGERATION = 10.0  # of the strokes: a residual of 1 cm is drawn 10 cm long
COLOURS = {
    "measured": (0.0, 0.45, 0.70, 1.0), "simulated": (0.84, 0.37, 0.0, 1.0), "tyre": (0.2, 0.2, 0.2, 1.0),
    "residual": (0.8, 0.47, 0.65, 1.0), "text": (0.1, 0.1, 0.1, 1.0),
}  # fmt: skip


def scene(view: PassView, stamp: Mapping[str, int]) -> Values:
    """One SceneUpdate with everything that does not change during the pass.

    The outlines are fixed to the bodies' frames and so move with them; tracks and residuals lie on the map.
    """
    entities = [outline(view, b, frame, colour) for b, frame, colour in frames(view)]
    entities += [track(view, b, "measured") for b in view.bodies]
    entities += [track(view, b, "simulated") for b in view.simulated_bodies]
    entities += [residuals(view, b) for b in view.bodies if f"n{b}_simulated" in view.comparison]
    entities.append(verdict(view))
    return {"entities": [{"timestamp": dict(stamp), **entity} for entity in entities]}


def frames(view: PassView) -> list[tuple[str, str, str]]:
    """(body, frame, colour) of every body's measured and simulated frame."""
    measured = [(b, BODY_NAMES[b], "measured") for b in view.bodies]
    return measured + [(b, f"{BODY_NAMES[b]}_simulated", "simulated") for b in view.simulated_bodies]


def outline(view: PassView, b: str, frame: str, colour: str) -> Values:
    """A body's frame and wheels in its own coordinates, seen from above."""
    machine = view.manifest.machine
    if b == "1":
        lines, wheels = tractor_shape(machine.tractor)
    else:
        assert machine.seeder is not None  # a second body comes with a [machine.seeder]
        lines, wheels = seeder_shape(machine.seeder)
    return {
        "frame_id": frame, "id": f"outline {frame}", "frame_locked": True,
        "lines": [line(points, colour, LINE_STRIP) for points in lines],
        "cubes": [cube(x, y, radius) for x, y, radius in wheels],
    }  # fmt: skip


Shape = tuple[list[Floats], list[tuple[float, float, float]]]


def tractor_shape(tractor: Tractor) -> Shape:
    """Lines (m, in the body frame) and wheels (x, y, radius) of a tractor."""
    front, rear = 0.5 * tractor.front_track, 0.5 * tractor.rear_track
    axles = [
        np.array([[tractor.front_axle, -front], [tractor.front_axle, front]]),
        np.array([[-tractor.rear_axle, -rear], [-tractor.rear_axle, rear]]),
    ]
    spine = np.array([[tractor.front_axle + 0.8, 0.0], [-tractor.hitch, 0.0]])
    wheels = [(tractor.front_axle, side * front, tractor.front_wheel_radius) for side in (-1, 1)]
    wheels += [(-tractor.rear_axle, side * rear, tractor.rear_wheel_radius) for side in (-1, 1)]
    return [*axles, spine], wheels


def seeder_shape(seeder: Seeder) -> Shape:
    """Lines (m, in the body frame) and wheels (x, y, radius) of a seeder with its drawbar."""
    axles = list(zip(seeder.axles, seeder.tracks, strict=True))
    lines = [np.array([[-back, -0.5 * track], [-back, 0.5 * track]]) for back, track in axles]
    lines.append(np.array([[seeder.hitch_to_com, 0.0], [-max(back for back, _ in axles), 0.0]]))
    wheels = [(-back, side * 0.5 * track, seeder.wheel_radius) for back, track in axles for side in (-1, 1)]
    return lines, wheels


def track(view: PassView, b: str, kind: str) -> Values:
    """A body's track on the map, a point each half second."""
    columns = view.trajectory if kind == "measured" else view.simulation
    points = np.column_stack([columns[f"x{b}"], columns[f"y{b}"]])[::25]
    drawn = line(points[np.isfinite(points).all(axis=1)], kind, LINE_STRIP)
    return {"frame_id": MAP, "id": f"track {BODY_NAMES[b]} {kind}", "lines": [drawn]}


def residuals(view: PassView, b: str) -> Values:
    """Strokes across the measured track, as long as the residual times `EXAGGERATION`."""
    strokes = [stroke for row in view.lines for stroke in _strokes(view, b, row)]
    points = np.concatenate(strokes) if strokes else np.empty((0, 2))
    return {
        "frame_id": MAP, "id": f"residual {BODY_NAMES[b]}",
        "metadata": [{"key": "exaggeration", "value": f"{EXAGGERATION:g}"}],
        "lines": [line(points, "residual", LINE_LIST)],
    }  # fmt: skip


def _strokes(view: PassView, b: str, row: Mapping[str, Any]) -> list[Floats]:
    grid = view.comparison
    residual = grid[f"n{b}_simulated"] - grid[f"n{b}"]
    here = (grid["row"] == row["row"]) & np.isfinite(residual)
    s, n, e = grid["s"][here], grid[f"n{b}"][here], residual[here]
    step = max(1, round(RESIDUAL_STEP / float(np.median(np.diff(s))))) if s.size > 1 else 1
    a, end = np.array(row["a"], dtype=np.float64), np.array(row["b"], dtype=np.float64)
    along = (end - a) / np.hypot(*(end - a))
    left = np.array([-along[1], along[0]])

    def at(index: int, across: float) -> Floats:
        return np.asarray(a + s[index] * along + across * left)

    return [np.array([at(i, n[i]), at(i, n[i] + EXAGGERATION * e[i])]) for i in range(0, s.size, step)]


def verdict(view: PassView) -> Values:
    """The verdict with its headline numbers, beside the start of the pass."""
    t = view.trajectory
    place = {"x": float(t["x1"][0]), "y": float(t["y1"][0]) + 5.0, "z": 3.0}
    text = {
        "pose": {"position": place, "orientation": {"w": 1.0}},
        "billboard": True, "font_size": 1.0, "color": rgba("text"), "text": verdict_words(view.metrics),
    }  # fmt: skip
    return {"frame_id": MAP, "id": "verdict", "texts": [text]}


def verdict_words(metrics: Mapping[str, Any]) -> str:
    """`inconclusive: trajectory 7.1 %, yaw 5.0 %`."""
    found = metrics.get("discrepancy") or {}
    parts = [
        f"{kind} {entry['combined']:.1f} %"
        for kind, entry in found.items()
        if isinstance(entry, Mapping) and isinstance(entry.get("combined"), int | float)
    ]
    value = (metrics.get("verdict") or {}).get("value", "no verdict")
    return f"{value}: {', '.join(parts)}" if parts else str(value)


def line(points: Floats, colour: str, kind: int) -> Values:
    """A line on the ground through points (N, 2)."""
    listed = [{"x": float(x), "y": float(y), "z": 0.0} for x, y in points]
    return {
        "type": kind, "pose": {"orientation": {"w": 1.0}}, "thickness": THIN, "points": listed,
        "color": rgba(colour),
    }  # fmt: skip


def cube(x: float, y: float, radius: float) -> Values:
    """A wheel as a box standing on the ground."""
    return {
        "pose": {"position": {"x": x, "y": y, "z": radius}, "orientation": {"w": 1.0}},
        "size": {"x": 2.0 * radius, "y": TYRE_WIDTH, "z": 2.0 * radius}, "color": rgba("tyre"),
    }  # fmt: skip


def rgba(name: str) -> Values:
    """A colour of this scene."""
    return dict(zip("rgba", COLOURS[name], strict=True))
