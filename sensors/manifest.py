"""run.toml: what a pass is, where each sensor sits. An unknown key is an error that names the nearest one."""

from __future__ import annotations

import datetime as dt
import difflib
import re
import tomllib
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, ClassVar, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
    field_validator,
    model_validator,
)

from .manifest_errors import one_line, told

GRAVITY = 9.80665  # m/s², standard gravity

MAX_BYTES = 2**20  # of a run.toml
MAX_SENSORS = 256
MOST_DOTS = 64  # in one key
UNDATED = dt.date(1970, 1, 1)  # of a run.toml without date, until the recordings tell it


def _a_number(value: Any) -> Any:
    """Neither text nor true/false, which would otherwise be turned into numbers."""
    if isinstance(value, str | bool):
        raise ValueError("must be a number")
    return value


Finite = Annotated[float, BeforeValidator(_a_number), Field(allow_inf_nan=False)]
Positive = Annotated[float, BeforeValidator(_a_number), Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, BeforeValidator(_a_number), Field(ge=0.0, allow_inf_nan=False)]
Vector = tuple[Finite, Finite, Finite]
RunId = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=128)]
Wheel = Literal["front_right", "front_left", "rear_right", "rear_left"]
Body = Literal["tractor", "seeder"]


class ManifestError(ValueError):
    """A run.toml that cannot be used; the text says where and how to mend it, in one line."""


class Table(BaseModel):
    """A TOML table of the manifest: strict about its keys, immutable once read."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Run(Table):
    """Which pass this is. date : UTC day of its start; UNDATED: the recordings tell it."""

    id: RunId
    field: str = ""
    direction: str = ""
    repeat: int = 1
    variant: str = ""
    date: dt.date = UNDATED

    @field_validator("id")
    @classmethod
    def _no_climbing(cls, value: str) -> str:
        if ".." in value:
            raise ValueError("must not contain '..'")
        return value


class Line(Table):
    """Intended AB line: a, b as (lat, lon) in degrees."""

    a: tuple[Finite, Finite]
    b: tuple[Finite, Finite]

    @field_validator("a", "b")
    @classmethod
    def _on_earth(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not (abs(value[0]) <= 90.0 and abs(value[1]) <= 360.0):
            raise ValueError("must be latitude (within ±90) and longitude (within ±360) in degrees")
        return value

    @model_validator(mode="after")
    def _two_points(self) -> Line:
        if self.a == self.b:
            raise ValueError("a and b must be two different points")
        return self


class Operating(Table):
    """What was set before the pass: speed (m/s) and the tractor's tyre pressure (MPa)."""

    speed: Positive
    tyre_pressure_mpa: Positive


class Tractor(Table):
    """The tractor: masses, lengths from its CoM, radii; SI."""

    mass: Positive
    yaw_inertia: Positive
    front_track: Positive
    rear_track: Positive
    front_axle: Positive
    rear_axle: Positive
    hitch: Finite
    cog_height: Positive
    front_wheel_radius: Positive
    rear_wheel_radius: Positive
    driven: Literal["all", "rear"] = "all"
    roll_centre: NotNegative | None = None  # height above ground of the axis it rolls about; None: at the CoM


class Seeder(Table):
    """The seeder: masses, lengths from its CoM, its axles, its draft; SI."""

    mass: Positive
    yaw_inertia: Positive
    hitch_to_com: Positive
    com_to_axle: Finite | tuple[Finite, ...]
    track: Positive | tuple[Positive, ...]
    cog_height: Positive
    wheel_radius: Positive
    draft: NotNegative
    draft_angle_deg: Finite = 0.0
    roll_centre: NotNegative | None = None

    @model_validator(mode="after")
    def _axles_agree(self) -> Seeder:
        if len(self.axles) == 0 or len(self.axles) != len(self.tracks):
            raise ValueError(
                "com_to_axle and track must list the same number of axles, at least one "
                f"(they list {len(self.axles)} and {len(self.tracks)})"
            )
        return self

    @property
    def axles(self) -> tuple[float, ...]:
        """Each axle's distance behind the CoM, m."""
        return self.com_to_axle if isinstance(self.com_to_axle, tuple) else (self.com_to_axle,)

    @property
    def tracks(self) -> tuple[float, ...]:
        """Each axle's track, m; a single number serves all axles, a list has one for each."""
        return self.track if isinstance(self.track, tuple) else (self.track,) * len(self.axles)


class Tyre(Table):
    """One wheel's tyre."""

    cornering_stiffness: Positive
    reference_pressure_mpa: Positive = 0.10
    pressure_exponent: Finite = 0.5
    friction: Positive
    rolling_resistance: NotNegative
    relaxation_length: NotNegative = 0.0


class Tyres(Table):
    """Tyres by axle."""

    front: Tyre
    rear: Tyre
    seeder: Tyre | None = None


class Machine(Table):
    """What moved: a tractor, with or without a seeder."""

    tractor: Tractor
    seeder: Seeder | None = None
    tyres: Tyres

    @model_validator(mode="after")
    def _seeder_has_tyres(self) -> Machine:
        if (self.seeder is None) != (self.tyres.seeder is None):
            raise ValueError("[machine.seeder] and [machine.tyres.seeder] go together")
        return self


class Units(Table):
    """Units of a raw file's columns where they are not the default's."""

    accel: Literal["m/s2", "g"] = "m/s2"
    gyro: Literal["rad/s", "deg/s"] = "rad/s"
    mag: Literal["uT", "T", "gauss"] = "T"
    angle: Literal["rad", "deg"] = "rad"
    speed: Literal["m/s", "mm/s", "km/h", "mph", "rad/s", "rpm"] = "m/s"  # the last two: a wheel's rotation
    host_time: Literal["ns", "us", "ms", "s"] = "ns"
    device_time: Literal["ns", "us", "ms", "s"] = "us"


class Sensor(Table):
    """What every sensor has: one source, a raw file of the pass's folder or a topic of another log."""

    file: str | None = None
    topic: str | None = None
    columns: dict[str, str] = Field(default_factory=dict)
    units: Units = Units()

    COLUMNS: ClassVar[tuple[str, ...]] = ()  # the names that `columns` can rename

    @field_validator("columns")
    @classmethod
    def _known_columns(cls, value: dict[str, str]) -> dict[str, str]:
        for name in value:
            if name not in cls.COLUMNS:
                near = difflib.get_close_matches(name, cls.COLUMNS, n=1, cutoff=0.0)
                hint = f"; did you mean `{near[0]}`?" if near else ""
                raise ValueError(f"no column is called `{name}`{hint}")
        return value

    @field_validator("file")
    @classmethod
    def _inside(cls, value: str | None) -> str | None:
        if value is None:
            return value
        path = PurePosixPath(value.replace("\\", "/"))
        if not path.parts or path.is_absolute() or ".." in path.parts or not value.isprintable():
            raise ValueError("must be a path inside the pass's folder, without '..'")
        if re.match(r"[A-Za-z]:", value):
            raise ValueError("must be a path inside the pass's folder, without '..'")
        return value

    @model_validator(mode="after")
    def _one_source(self) -> Sensor:
        if (self.file is None) == (self.topic is None):
            raise ValueError("needs either `file` or `topic`")
        return self


class Inertial(Sensor):
    """An inertial unit: how it is turned, how fast, how noisy."""

    COLUMNS: ClassVar[tuple[str, ...]] = (
        *("t_host_ns", "t_dev_us", "seq"),
        *("ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"),
    )

    rotation_deg: Vector = (0.0, 0.0, 0.0)
    rate: Positive
    gyro_noise: Positive | None = None  # rad/s/sqrt(Hz)
    accel_noise: Positive | None = None  # m/s2/sqrt(Hz)
    gyro_bias: Positive | None = None  # rad/s, 1 sigma
    accel_bias: Positive | None = None  # m/s2, 1 sigma


class Imd(Inertial):
    """An inertial unit fixed to a body; position from the body's CoM, m."""

    kind: Literal["imd"]
    body: Body
    position: Vector


class Wds(Inertial):
    """An inertial unit in a wheel; offset from the hub's centre in the wheel's frame at phase 0, m."""

    kind: Literal["wds"]
    wheel: Wheel
    offset: Vector = (0.0, 0.0, 0.0)


class Steer(Sensor):
    """A steering sensor, and how good it is."""

    COLUMNS: ClassVar[tuple[str, ...]] = ("t_host_ns", "angle")

    kind: Literal["steer"]
    rate: Positive
    noise_deg: Positive = 0.1
    zero_sd_deg: Positive = 0.3
    scale_sd: Positive = 0.01


class Speed(Sensor):
    """Speed by the rotation of wheels, as a CAN bus tells it, and how good it is.

    wheel : whose hub's speed along the wheel's heading; None: of the middle of the rear axle (gearbox, ECU)
    noise : m/s, of a value (None: as the pass shows); scale_sd : 1, of the radius that was assumed and of the mean
        slip together
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ("t_host_ns", "speed")

    kind: Literal["speed"]
    wheel: Wheel | None = None
    rate: Positive
    noise: Positive | None = None
    scale_sd: Positive = 0.10


class Gps(Sensor):
    """A GNSS receiver; position of its antenna from the body's CoM, m."""

    COLUMNS: ClassVar[tuple[str, ...]] = (
        *("t_host_ns", "t", "lat", "lon", "alt", "quality", "sd_east", "sd_north", "sd_up"),
        *("speed", "course_deg", "heading_deg", "hdop", "satellites"),
    )

    kind: Literal["gps"]
    body: Body = "tractor"
    position: Vector
    rate: Positive
    latency: NotNegative = 0.1  # s, prior of the least delay from validity to arrival
    latency_sd: Positive = 0.05  # s


AnySensor = Annotated[Imd | Wds | Steer | Speed | Gps, Field(discriminator="kind")]


class Manifest(Table):
    """One pass. Attribute names are the TOML keys of the format page."""

    schema_: Literal[1] = Field(alias="schema")
    run: Run
    line: Line | None = None
    operating: Operating
    machine: Machine
    sensors: dict[str, AnySensor]
    conditions: dict[str, Any] = Field(default_factory=dict)
    uncertainty: dict[str, NotNegative] = Field(default_factory=dict)  # by path, sd in SI

    @field_validator("sensors")
    @classmethod
    def _names(cls, value: dict[str, Any]) -> dict[str, Any]:
        for name in value:
            if not re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_-]{0,63}", name):
                raise ValueError(f"sensor name {name[:70]!r} must be up to 64 letters, digits, '_' or '-'")
        if len(value) > MAX_SENSORS:
            raise ValueError(f"{len(value)} sensors; a pass has at most {MAX_SENSORS}")
        return value

    @model_validator(mode="after")
    def _own_sources(self) -> Manifest:
        owners: dict[tuple[str | None, ...], str] = {}
        for name, sensor in self.sensors.items():
            # a bus's export holds several signals: their columns must differ
            signal = sensor.columns.get("angle" if sensor.kind == "steer" else "speed", sensor.kind)
            part = signal if sensor.kind in ("steer", "speed") else None
            first = owners.setdefault((sensor.file, sensor.topic, part), name)
            if first != name:
                what = sensor.file or sensor.topic
                raise ValueError(
                    f"sensors.{first} and sensors.{name} both read {what!r}; one of them is wrong"
                )
        return self

    @model_validator(mode="after")
    def _enough_sensors(self) -> Manifest:
        bodies = {s.body for s in self.sensors.values() if s.kind == "imd"}
        if "tractor" not in bodies:
            raise ValueError('a pass needs at least one IMD with body = "tractor"')
        if self.machine.seeder is not None and "seeder" not in bodies:
            raise ValueError('a pass with [machine.seeder] needs at least one IMD with body = "seeder"')
        if self.machine.seeder is None and any(
            getattr(s, "body", "") == "seeder" for s in self.sensors.values()
        ):
            raise ValueError("a sensor sits on the seeder but there is no [machine.seeder]")
        if not any(s.kind == "gps" and s.body == "tractor" for s in self.sensors.values()):
            raise ValueError('a pass needs a receiver on the tractor: kind = "gps", body = "tractor"')
        return self

    def dated(self, day: dt.date | str | None) -> Manifest:
        """The same pass, of that day (a date, or as ISO 8601 has it) where its run.toml has none."""
        if self.run.date != UNDATED or day is None:
            return self
        date = dt.date.fromisoformat(day) if isinstance(day, str) else day
        return self.model_copy(update={"run": self.run.model_copy(update={"date": date})})

    def of_kind(self, kind: str) -> dict[str, Any]:
        """Sensors of one kind, by name, in the manifest's order."""
        return {name: s for name, s in self.sensors.items() if s.kind == kind}


_TABLES: dict[str, type[BaseModel]] = {
    "": Manifest,
    "run": Run,
    "line": Line,
    "operating": Operating,
    "machine": Machine,
    "machine.tractor": Tractor,
    "machine.seeder": Seeder,
    "machine.tyres": Tyres,
    "machine.tyres.front": Tyre,
    "machine.tyres.rear": Tyre,
    "machine.tyres.seeder": Tyre,
    "sensors.*.imd": Imd,
    "sensors.*.wds": Wds,
    "sensors.*.steer": Steer,
    "sensors.*.speed": Speed,
    "sensors.*.gps": Gps,
    "sensors.*.*.units": Units,
}


def parse(text: str, where: str = "run.toml") -> Manifest:
    """The manifest of a run.toml's text.

    Raises ManifestError, one line: what, where, how to mend.
    """
    _bounded(text, where)
    try:
        return Manifest.model_validate(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise ManifestError(one_line(f"{where}: not valid TOML: {error}")) from None
    except ValidationError as error:
        raise ManifestError(one_line(f"{where}{told(error, text, _TABLES)}")) from None
    except RecursionError:
        raise ManifestError(f"{where}: tables nested too deeply") from None


def _bounded(text: str, where: str) -> None:
    """Refuse keys of very many parts, on which the TOML parser's time grows with the square."""
    for number, line in enumerate(text.split("\n"), start=1):
        if any(part.count(".") > MOST_DOTS for part in re.split(r"[^\w\"'.\- \t]+", line)):
            raise ManifestError(f"{where}, line {number}: a key with more than {MOST_DOTS} dots")


def read(path: Path) -> tuple[Manifest, str]:
    """The manifest in a file, and its text.

    Raises ManifestError, one line: what, where, how to mend.
    """
    try:
        if path.exists() and not path.is_file():
            raise ManifestError(f"{path}: is not a regular file")
        if path.stat().st_size > MAX_BYTES:
            raise ManifestError(f"{path}: is larger than 1 MiB; this is no run.toml")
        text = path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise ManifestError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ManifestError(f"{path}: is not UTF-8 text; save it as UTF-8") from None
    return parse(text, str(path)), text
