"""What drove the model: the steering and the speed as they were measured."""

from __future__ import annotations

import numpy as np

from ..report_blocks import Block, Chart, Curve, Missing, Panel, Section, Text
from ..report_view import PassView
from ._common import deep, number

SOURCES = {
    "sensor": "The model's steering comes from the steering sensor.",
    "wheels": (
        "The model's steering comes from the units on the front wheels: their yaw rate less the "
        "body's, integrated. It is never corrected by the body's position or yaw."
    ),
}
NO_STEER = (
    "There is no steering series that is independent of the body's own motion (no steering sensor and "
    "no unit on a front wheel), so the model of the tractor cannot be tested on this pass; only the "
    "seeder is judged, with the measured motion of the tractor imposed."
)

DRIVEN = "The model sees them as shown, each window with its own bounded offset of steering."
IMPOSED = "This steering is an estimate from the body's own motion, shown for reference; it drove no model."


def build(view: PassView) -> Section:
    """The section."""
    t = view.trajectory
    blocks: list[Block] = []
    words = SOURCES.get(str(deep(view.metrics, "steering", "source")))
    if words:
        blocks.append(Text(words))
    elif view.imposed:
        blocks.append(Missing(NO_STEER))
    time = t["t"] - t["t"][0]
    panels = [Panel("speed, m/s", _speed(view, time), levels=((view.manifest.operating.speed, "nominal"),))]
    if np.isfinite(t["steer"]).any():
        panels.insert(0, Panel("steering, °", _steer(view, time)))
    else:
        blocks.append(Missing("Nothing on this machine tells the steering angle."))
    blocks.append(_chart(view, tuple(panels)))
    return Section("inputs", "Steering and speed", tuple(blocks))


def _steer(view: PassView, time: np.ndarray) -> tuple[Curve, ...]:
    steer, sd = np.rad2deg(view.trajectory["steer"]), np.rad2deg(view.trajectory["sd_steer"])
    best = Curve("best estimate", "measured", time, steer, steer - 2 * sd, steer + 2 * sd, band_name="± 2 sd")
    driven = view.simulation.get("steer")
    if view.imposed or driven is None or not np.isfinite(driven).any():
        return (best,)
    return best, Curve("as the model was driven", "simulated", time, np.rad2deg(driven), style="dash")


def _speed(view: PassView, time: np.ndarray) -> tuple[Curve, ...]:
    t = view.trajectory
    v, sd = t["v1"], t["sd_v1"]
    return (Curve("tractor", "tractor", time, v, v - 2 * sd, v + 2 * sd, band_name="± 2 sd"),)


def _chart(view: PassView, panels: tuple[Panel, ...]) -> Chart:
    steer, v = np.rad2deg(view.trajectory["steer"]), view.trajectory["v1"]
    swing = number(float(np.nanstd(steer)), 2, "°") if np.isfinite(steer).any() else "not measured"
    return Chart(
        key="inputs", title="Steering and speed", x_label="time from the start of the log, s", panels=panels,
        alt=f"Steering angle (root mean square {swing}) and speed of the tractor (median "
        f"{np.median(v):.2f} m/s) over time.",
        caption="Mean angle of the front wheels, positive to the left, and speed of the tractor's "
        f"centre of mass. {IMPOSED if view.imposed else DRIVEN}",
    )  # fmt: skip
