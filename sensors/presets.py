"""How well-known loggers name and scale the columns of their inertial CSV."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Preset:
    """Columns by standard name, and the units that differ from the standard's."""

    name: str
    columns: Mapping[str, str]
    units: Mapping[str, str] = field(default_factory=dict)


def _three(standard: str, pattern: str, axes: tuple[str, str, str] = AXES) -> dict[str, str]:
    return {f"{standard}{axis}": pattern.format(shown) for axis, shown in zip(AXES, axes, strict=True)}


EUROC = Preset(
    "EuRoC",
    {"t_host_ns": "#timestamp [ns]"}
    | _three("a", "a_RS_S_{} [m s^-2]")
    | _three("g", "w_RS_S_{} [rad s^-1]"),
)
KALIBR = Preset(
    "Kalibr",
    {"t_host_ns": "timestamp"} | _three("a", "alpha_{}") | _three("g", "omega_{}"),
)
XSENS = Preset(
    "Xsens / Movella DOT",
    {"t_dev_us": "SampleTimeFine", "seq": "PacketCounter"}
    | _three("a", "Acc_{}", ("X", "Y", "Z"))
    | _three("g", "Gyr_{}", ("X", "Y", "Z")),
    {"gyro": "deg/s"},
)
GENERIC = Preset(
    "generic",
    {"t_host_ns": "timestamp"} | _three("a", "accel_{}") | _three("g", "gyro_{}"),
)
PRESETS = (EUROC, KALIBR, XSENS, GENERIC)
