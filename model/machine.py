"""The machine: geometry, inertia, tyres and static wheel loads of a tractor, with or without a trailed
seeder.

Keys are those of the manifest's `[machine]` table; the paper's symbols stand in brackets. SI units
throughout, a body's frame has x forward, y left and its origin at the body's centre of mass (CoM).
"""

from __future__ import annotations

import dataclasses
import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

GRAVITY = 9.80665  # m/s², standard gravity

Part = TypeVar("Part")


class MachineError(ValueError):
    """A machine that cannot be: one line that names the parameter and the bound."""


def _require_positive(part: str, owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        if not (isinstance(value, int | float) and value > 0.0 and math.isfinite(value)):
            raise MachineError(f"{part}.{name} is {value!r}; it must be a finite number above 0")


def _require_not_negative(part: str, owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        if not (isinstance(value, int | float) and value >= 0.0 and math.isfinite(value)):
            raise MachineError(f"{part}.{name} is {value!r}; it must be a finite number, 0 or above")


def _require_finite(part: str, owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        if not (isinstance(value, int | float) and math.isfinite(value)):
            raise MachineError(f"{part}.{name} is {value!r}; it must be a finite number")


@dataclass(frozen=True)
class Tractor:
    """The leading body.

    mass [m1] kg; yaw_inertia [J1] kg·m² about the CoM; front_track [l1], rear_track m;
    front_axle [l2] m ahead of the CoM; rear_axle [l3] m behind it; hitch [l4] m behind it;
    cog_height m above ground; wheel radii m (rolling); driven: which wheels share the traction;
    roll_centre m above ground (None: at the CoM), of no effect on the planar model.
    """

    mass: float
    yaw_inertia: float
    front_track: float
    rear_track: float
    front_axle: float
    rear_axle: float
    hitch: float
    cog_height: float = 1.0
    front_wheel_radius: float = 0.62
    rear_wheel_radius: float = 0.80
    driven: Literal["all", "rear"] = "all"
    roll_centre: float | None = None

    def __post_init__(self) -> None:
        _require_positive(
            "tractor", self, "mass", "yaw_inertia", "front_track", "rear_track", "front_axle", "rear_axle"
        )
        _require_positive("tractor", self, "cog_height", "front_wheel_radius", "rear_wheel_radius")
        _require_finite("tractor", self, "hitch")
        if self.driven not in ("all", "rear"):
            raise MachineError(f"tractor.driven is {self.driven!r}; it must be 'all' or 'rear'")

    @property
    def wheelbase(self) -> float:
        """l2 + l3, m."""
        return self.front_axle + self.rear_axle


@dataclass(frozen=True)
class Seeder:
    """The trailed body.

    mass [m2] kg; yaw_inertia [J2] kg·m²; hitch_to_com [l5] m from the hitch back to the CoM;
    com_to_axle [l6] m behind the CoM and track [l7] m, one entry an axle; draft [P2] N;
    draft_angle_deg [γ21], counter-clockwise; draft_point m behind the CoM, where the draft acts.
    """

    mass: float
    yaw_inertia: float
    hitch_to_com: float
    com_to_axle: tuple[float, ...]
    track: tuple[float, ...]
    cog_height: float = 0.9
    wheel_radius: float = 0.5
    draft: float = 0.0
    draft_angle_deg: float = 0.0
    draft_point: float = 0.0
    roll_centre: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "com_to_axle", _as_tuple(self.com_to_axle))
        tracks = _as_tuple(self.track)
        object.__setattr__(self, "track", tracks * len(self.com_to_axle) if len(tracks) == 1 else tracks)
        _require_positive("seeder", self, "mass", "yaw_inertia", "hitch_to_com", "cog_height", "wheel_radius")
        _require_not_negative("seeder", self, "draft")
        _require_finite("seeder", self, "draft_angle_deg", "draft_point")
        self._require_axles()

    def _require_axles(self) -> None:
        if not self.com_to_axle or len(self.com_to_axle) != len(self.track):
            raise MachineError(
                f"seeder.com_to_axle has {len(self.com_to_axle)} entries and seeder.track "
                f"{len(self.track)}; list one of each for every axle"
            )
        for axle, track in zip(self.com_to_axle, self.track, strict=True):
            if not math.isfinite(axle):
                raise MachineError(f"seeder.com_to_axle is {axle!r}; it must be a finite number")
            if not (track > 0.0 and math.isfinite(track)):
                raise MachineError(f"seeder.track is {track!r}; it must be a finite number above 0")

    @property
    def mean_axle(self) -> float:
        """Distance of the axles' common centre behind the CoM, m."""
        return sum(self.com_to_axle) / len(self.com_to_axle)


@dataclass(frozen=True)
class Tyre:
    """One wheel's tyre on its soil.

    cornering_stiffness N/rad at reference_pressure_mpa; it grows as (pressure / reference)^pressure_exponent;
    friction: largest lateral (and tractive) force over vertical load; rolling_resistance: coefficient over
    vertical load; relaxation_length m (0: none).
    """

    cornering_stiffness: float
    reference_pressure_mpa: float = 0.10
    pressure_exponent: float = 0.5
    friction: float = 0.6
    rolling_resistance: float = 0.08
    relaxation_length: float = 0.0

    def __post_init__(self) -> None:
        _require_positive("tyres", self, "cornering_stiffness", "reference_pressure_mpa", "friction")
        _require_not_negative("tyres", self, "rolling_resistance", "relaxation_length")
        _require_finite("tyres", self, "pressure_exponent")

    def stiffness_at(self, pressure_mpa: float | None) -> float:
        """Cornering stiffness C = C_ref·(P/P_ref)^e, N/rad; None: at the reference pressure."""
        if pressure_mpa is None:
            return self.cornering_stiffness
        ratio = pressure_mpa / self.reference_pressure_mpa
        return float(self.cornering_stiffness * ratio**self.pressure_exponent)


@dataclass(frozen=True)
class Tyres:
    """The tyre of every wheel of an axle; seeder is None for a tractor alone."""

    front: Tyre
    rear: Tyre
    seeder: Tyre | None = None


@dataclass(frozen=True)
class WheelLoads:
    """Static vertical load of one wheel of each axle, N; seeder has one entry an axle; hitch is the load that
    the seeder lays on the tractor's hitch (negative: it lifts)."""

    front: float
    rear: float
    seeder: tuple[float, ...]
    hitch: float


@dataclass(frozen=True)
class Machine:
    """Tractor, optional seeder, tyres, and the pressure of the tractor's tyres in MPa.

    Raises MachineError for a parameter out of its bounds or geometry that leaves a wheel without load.
    """

    tractor: Tractor
    seeder: Seeder | None
    tyres: Tyres
    tyre_pressure_mpa: float

    def __post_init__(self) -> None:
        if not (self.tyre_pressure_mpa > 0.0 and math.isfinite(self.tyre_pressure_mpa)):
            raise MachineError(
                f"tyre_pressure_mpa is {self.tyre_pressure_mpa!r}; it must be a finite number above 0"
            )
        if (self.seeder is None) != (self.tyres.seeder is None):
            raise MachineError("seeder and tyres.seeder go together: give both or neither")
        self.wheel_loads()

    @classmethod
    def from_mapping(cls, mapping: Mapping[str, Any], tyre_pressure_mpa: float) -> Machine:
        """The machine of a manifest's `[machine]` table (plain dict) at a tyre pressure in MPa.

        Raises MachineError that names a missing or unknown key.
        """
        _require_known(mapping, ("tractor", "seeder", "tyres", "tyre_pressure_mpa"), "machine")
        tyres = mapping.get("tyres") or {}
        _require_known(tyres, ("front", "rear", "seeder"), "tyres")
        seeder, seeder_tyre = mapping.get("seeder"), tyres.get("seeder")
        return cls(
            tractor=_part(Tractor, mapping.get("tractor"), "tractor"),
            seeder=None if seeder is None else _part(Seeder, seeder, "seeder"),
            tyres=Tyres(
                front=_part(Tyre, tyres.get("front"), "tyres.front"),
                rear=_part(Tyre, tyres.get("rear"), "tyres.rear"),
                seeder=None if seeder_tyre is None else _part(Tyre, seeder_tyre, "tyres.seeder"),
            ),
            tyre_pressure_mpa=tyre_pressure_mpa,
        )

    def wheel_loads(self) -> WheelLoads:
        """Static loads from masses and geometry, the hitch load included.

        Seeder: axle loads N = m2·g·l5/(l5 + l6), hitch load m2·g − N; axles of a tandem share N evenly, as
        on a walking beam, which makes l6 their mean. Tractor: moments about each axle.
        """
        axle, hitch = self._seeder_loads()
        t = self.tractor
        front = (t.mass * GRAVITY * t.rear_axle - hitch * (t.hitch - t.rear_axle)) / (2.0 * t.wheelbase)
        rear = (t.mass * GRAVITY * t.front_axle + hitch * (t.hitch + t.front_axle)) / (2.0 * t.wheelbase)
        self._require_load("front", front)
        self._require_load("rear", rear)
        count = 0 if self.seeder is None else len(self.seeder.com_to_axle)
        return WheelLoads(front=front, rear=rear, seeder=(axle / 2.0,) * count, hitch=hitch)

    def _seeder_loads(self) -> tuple[float, float]:
        """Load of one seeder axle and of the hitch, N."""
        s = self.seeder
        if s is None:
            return 0.0, 0.0
        lever = s.hitch_to_com + s.mean_axle
        if not lever > 0.0:
            raise MachineError(
                f"seeder.com_to_axle is {s.mean_axle:g} m, which leaves the seeder's wheels without "
                f"load; it must be above -seeder.hitch_to_com = {-s.hitch_to_com:g} m"
            )
        carried = s.mass * GRAVITY * s.hitch_to_com / lever
        return carried / len(s.com_to_axle), s.mass * GRAVITY - carried

    def _require_load(self, axle: str, load: float) -> None:
        if load > 0.0:
            return
        culprit = "tractor.hitch" if self.seeder is None else "seeder.com_to_axle"
        value = self.tractor.hitch if self.seeder is None else self.seeder.mean_axle
        raise MachineError(
            f"{culprit} is {value:g} m, which leaves the tractor's {axle} wheels without load "
            f"({load:.0f} N each); move the seeder's axle towards its centre of mass, or the hitch "
            "towards the tractor's rear axle"
        )

    def replace_parameters(self, values: Mapping[str, Any]) -> Machine:
        """A machine with parameters replaced by dotted names.

        Names: "tyres.front.cornering_stiffness", "seeder.hitch_to_com", "seeder.com_to_axle.1" (one axle of a
        tandem), "tyre_pressure_mpa". Raises MachineError for an unknown name (naming the nearest) or bad
        value.
        """
        mapping: dict[str, Any] = {
            "tractor": dict(vars(self.tractor)),
            "seeder": None if self.seeder is None else dict(vars(self.seeder)),
            "tyres": {name: None if t is None else dict(vars(t)) for name, t in vars(self.tyres).items()},
            "tyre_pressure_mpa": self.tyre_pressure_mpa,
        }
        for name, value in values.items():
            _assign(mapping, name, value)
        return Machine.from_mapping(mapping, float(mapping.pop("tyre_pressure_mpa")))

    def parameter(self, name: str) -> float:
        """The value behind a dotted name (see `replace_parameters`); a list over axles gives its mean."""
        owner: Any = self
        for key in name.split("."):
            known = [str(i) for i in range(len(owner))] if isinstance(owner, tuple) else list(vars(owner))
            _require_name(key, known, name)
            owner = owner[int(key)] if isinstance(owner, tuple) else getattr(owner, key)
            if owner is None:
                raise MachineError(f"{name}: this machine has no seeder")
        return float(sum(owner) / len(owner) if isinstance(owner, tuple) else owner)


def _as_tuple(value: Any) -> tuple[float, ...]:
    """One entry an axle, from a number, a sequence, or a dict of axles as `_assign` leaves it."""
    if isinstance(value, dict):
        return tuple(float(v) for v in value.values())
    return tuple(float(v) for v in value) if isinstance(value, tuple | list) else (float(value),)


def _require_name(key: str, known: Sequence[str], name: str) -> None:
    if key not in known:
        near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
        hint = f"; did you mean `{near[0]}`?" if near else ""
        raise MachineError(f"{name}: unknown parameter{hint}")


def _require_known(mapping: Mapping[str, Any], known: Sequence[str], where: str) -> None:
    for key in mapping:
        _require_name(key, known, f"{where}.{key}")


def _part(kind: type[Part], mapping: Mapping[str, Any] | None, where: str) -> Part:
    if mapping is None:
        raise MachineError(f"{where}: this table is missing")
    fields = dataclasses.fields(kind)  # type: ignore[arg-type]
    _require_known(mapping, tuple(f.name for f in fields), where)
    for field in fields:
        if field.name not in mapping and field.default is dataclasses.MISSING:
            raise MachineError(f"{where}.{field.name}: this parameter is missing")
    try:
        return kind(**mapping)
    except MachineError as error:
        if where.startswith("tyres."):
            raise MachineError(str(error).replace("tyres.", f"{where}.", 1)) from None
        raise


def _assign(mapping: dict[str, Any], name: str, value: Any) -> None:
    """Put a value into nested dicts under a dotted name that exists."""
    *path, last = name.split(".")
    owner: Any = mapping
    for key in path:
        _require_name(key, list(owner), name)
        if owner[key] is None:
            raise MachineError(f"{name}: this machine has no seeder")
        if isinstance(owner[key], tuple):
            owner[key] = dict(zip(map(str, range(len(owner[key]))), owner[key], strict=True))
        owner = owner[key]
    _require_name(last, list(owner), name)
    owner[last] = value
