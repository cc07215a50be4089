"""GNSS receivers of a twin: errors of position and velocity by quality of fix, and their NMEA 0183 sentences.

| quality | GGA | white | slow (Gauss-Markov) | velocity | of |
| --- | --- | --- | --- | --- | --- |
| RTK fixed | 4 | 6 mm | 9 mm over 40 s | 0.02 m/s | ZED-F9P: 0.01 m + 1 ppm CEP, 0.05 m/s |
| RTK float | 5 | 2 cm | 20 cm over 30 s | 0.03 m/s | receivers state 0.1 to 0.5 m |
| DGPS | 2 | 4 cm | 40 cm over 100 s | 0.04 m/s | SBAS: 0.6 to 1 m CEP |
| single | 1 | 5 cm | 1.0 m over 120 s | 0.05 m/s | ZED-F9P: 1.5 m CEP |

Each axis, 1 sigma; up twice that. Slow errors are why an hour's average is no better than a minute's;
receivers filter their solution, which is why even a single-point fix jitters by centimetres only
(`white_scale` for one that does not).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..sensors.geodesy import to_geodetic
from .twin_clocks import HostClock
from .twin_path import wander
from .twin_plan import GnssPlan, PlacePlan
from .twin_rigid import BodyPath

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SEPARATION = 16.0  # m, of the geoid above the ellipsoid
KNOT = 1852.0 / 3600.0  # m/s
SLOWEST_COURSE = 0.1  # m/s, below which receivers state no course
SENTENCE_GAP = 0.007  # s between the sentences of one epoch, on a serial line
MOST_SENTENCES = 6  # of one epoch
GSA_EVERY = 50  # epochs


@dataclass(frozen=True)
class Grade:
    """One quality of fix: GGA code, 1 sigma of white and slow errors (m), slow errors' time (s),
    velocity (m/s)."""

    code: int
    white: float
    slow: float
    time: float
    velocity: float

    @property
    def sigma(self) -> float:
        """1 sigma of a horizontal axis, m: what an honest GST states."""
        return math.hypot(self.white, self.slow)


GRADES = {
    "rtk_fixed": Grade(4, 0.006, 0.009, 40.0, 0.02),
    "rtk_float": Grade(5, 0.02, 0.20, 30.0, 0.03),
    "dgps": Grade(2, 0.04, 0.40, 100.0, 0.04),
    "single": Grade(1, 0.05, 1.0, 120.0, 0.05),
}
NONE = 0  # GGA code of an epoch without a position


@dataclass(frozen=True)
class Fixes:
    """Epochs of one receiver: t (s in the pass), code of quality, position error and velocity error (N,
    3) ENU, stated sigma (N,), and when the first sentence arrives, s in the pass."""

    t: Floats
    code: Ints
    error: Floats
    velocity_error: Floats
    stated: Floats
    arrival: Floats


def fixes(plan: GnssPlan, rate: float, t: Floats, rng: np.random.Generator) -> Fixes:
    """Errors of a receiver at its epochs t, by the planned quality at each."""
    name = qualities(plan, t)
    error, speed_error, stated = np.zeros((t.size, 3)), np.zeros((t.size, 3)), np.full(t.size, np.nan)
    for (
        quality,
        grade,
    ) in GRADES.items():  # every grade's series is drawn: a plan's spans do not move the others
        series, velocity = _errors(grade, plan.white_scale, t.size, 1.0 / rate, rng)
        here = name == quality
        error[here], speed_error[here] = series[here], velocity[here]
        stated[here] = grade.sigma
    stated = stated * np.exp(0.15 * rng.standard_normal(t.size))
    code = np.array([GRADES[q].code if q in GRADES else NONE for q in name])
    return Fixes(t, code, error + _spikes(plan, t, rng), speed_error, stated, _arrivals(plan, rate, t, rng))


def qualities(plan: GnssPlan, t: Floats) -> NDArray[np.str_]:
    """Name of the grade at each epoch; "" in an outage."""
    name = np.full(t.size, plan.kind, dtype="<U16")
    for label, spans in (("single", plan.singles), ("rtk_float", plan.floats), ("", plan.outages)):
        for start, length in spans:
            name[(t >= start) & (t < start + length)] = label
    return name


def _errors(
    grade: Grade, white_scale: float, n: int, step: float, rng: np.random.Generator
) -> tuple[Floats, Floats]:
    shape = np.array([1.0, 1.0, 2.0])
    slow = np.column_stack([wander(n, step, grade.time, rng) for _ in range(3)])
    white = rng.standard_normal((n, 3))
    return shape * (
        grade.slow * slow + grade.white * white_scale * white
    ), grade.velocity * rng.standard_normal((n, 3))


def _spikes(plan: GnssPlan, t: Floats, rng: np.random.Generator) -> Floats:
    out = np.zeros((t.size, 3))
    for start, length, size in plan.spikes:
        bearing = float(rng.uniform(0.0, 2.0 * math.pi))
        out[(t >= start) & (t < start + length), :2] += size * np.array(
            [math.cos(bearing), math.sin(bearing)]
        )
    return out


def _arrivals(plan: GnssPlan, rate: float, t: Floats, rng: np.random.Generator) -> Floats:
    """Arrival of each epoch's first sentence; the last of one epoch comes before the first of the next."""
    drawn = float(rng.uniform(0.02, 0.15))
    least = drawn if plan.latency is None else plan.latency
    jitter = np.minimum(rng.exponential(plan.latency_jitter, t.size), max(0.2 - least, 0.5 / rate))
    busy = MOST_SENTENCES * SENTENCE_GAP * np.arange(t.size)
    return np.asarray(np.maximum.accumulate(t + least + jitter - busy) + busy)


def sentences(
    plan: GnssPlan, place: PlacePlan, antenna: Floats, body: BodyPath, found: Fixes,
    host: HostClock, headings: Floats | None, rng: np.random.Generator,
) -> list[str]:  # fmt: skip
    """Lines of the NMEA file. antenna : (3,) m in the body; headings : (N,) rad, ccw from East, as
    measured; None without a second antenna."""
    position = body.point(found.t, antenna) + found.error
    velocity = body.point_velocity(found.t, antenna) + found.velocity_error
    east, north, up = position.T
    lat, lon, alt = to_geodetic(east, north, up, place)
    speed = np.hypot(velocity[:, 0], velocity[:, 1])
    course = np.degrees(np.arctan2(velocity[:, 0], velocity[:, 1])) % 360.0
    satellites = rng.integers(12, 19, found.t.size)
    lines: list[str] = []
    for k in range(found.t.size):
        when = utc(host.start_ns, found.t[k])
        bodies = _position_sentences(plan, when, int(found.code[k]), lat[k], lon[k], alt[k],
                                     speed[k], course[k], found.stated[k], int(satellites[k]))  # fmt: skip
        if headings is not None:
            bodies.append(f"GNHDT,{(90.0 - math.degrees(headings[k])) % 360.0:.2f},T")
        if k % GSA_EVERY == 0:
            bodies.append("GNGSA,A,3,01,02,03,04,05,06,07,08,,,,,1.2,0.7,1.0")
        first = found.arrival[k]
        times = host.reading(first + SENTENCE_GAP * np.arange(len(bodies)))
        prefix = [f"{ns} " if plan.host_time else "" for ns in times]
        lines += [before + checked(text) for before, text in zip(prefix, bodies, strict=True)]
    return lines


def utc(start_ns: int, t: float) -> tuple[str, str]:
    """(hhmmss.ss, ddmmyy) of an instant t s after start_ns."""
    at = np.datetime64(start_ns + 10_000_000 * round(t * 100), "ns")
    day, clock = str(at.astype("datetime64[ms]")).split("T")
    year, month, date = day.split("-")
    return clock.replace(":", "")[:9], f"{date}{month}{year[2:]}"


def _position_sentences(
    plan: GnssPlan, when: tuple[str, str], code: int, lat: float, lon: float, alt: float,
    speed: float, course: float, stated: float, satellites: int,
) -> list[str]:  # fmt: skip
    clock, day = when
    if code == NONE:
        gone = [f"GNGGA,{clock},,,,,0,00,99.99,,M,,M,,"]
        return [*gone, f"GNRMC,{clock},V,,,,,,,{day},,,N", "GNVTG,,T,,M,,N,,K,N"] if plan.rmc else gone
    where = f"{_degrees(lat, 2)},{'N' if lat >= 0.0 else 'S'},{_degrees(lon, 3)},{'E' if lon >= 0.0 else 'W'}"
    age = "1.2,0001" if code in (2, 4, 5) else ","
    out = [f"GNGGA,{clock},{where},{code},{satellites},0.8,{alt - SEPARATION:.3f},M,{SEPARATION:.3f},M,{age}"]
    if plan.rmc:
        toward, mode = (
            f"{course:.2f}" if speed >= SLOWEST_COURSE else "",
            {4: "R", 5: "F", 2: "D", 1: "A"}[code],
        )
        out.append(f"GNRMC,{clock},A,{where},{speed / KNOT:.3f},{toward},{day},,,{mode}")
        out.append(f"GNVTG,{toward},T,,M,{speed / KNOT:.3f},N,{speed * 3.6:.3f},K,{mode}")
    if plan.gst:
        along = f"{stated:.3f},{stated:.3f}"
        out.append(f"GNGST,{clock},{1.3 * stated:.3f},{along},0.0,{along},{2.0 * stated:.3f}")
    return out


def _degrees(angle: float, digits: int) -> str:
    """Degrees and minutes to 1e-8 min (0.02 mm): 50.5° is 5030.00000000."""
    minutes = round(abs(angle) * 60.0 * 1e8)
    whole, rest = divmod(minutes, 60 * 10**8)
    return f"{whole:0{digits}d}{rest // 10**8:02d}.{rest % 10**8:08d}"


def checked(text: str) -> str:
    """`$text*hh` with the exclusive-or of its characters."""
    total = 0
    for byte in text.encode("ascii"):
        total ^= byte
    return f"${text}*{total:02X}"


def corrupted(lines: Sequence[str], share: float, rng: np.random.Generator) -> list[str]:
    """The lines, a share of them with one digit of the sentence changed (its checksum then tells)."""
    out = list(lines)
    for k in np.flatnonzero(rng.random(len(out)) < share):
        line = out[int(k)]
        at = line.index(",") + 1
        out[int(k)] = line[:at] + ("8" if line[at : at + 1] != "8" else "3") + line[at + 1 :]
    return out
