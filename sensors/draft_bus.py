"""Drafts of what a bus's export holds: steering angle and speeds, each of the columns that look like one."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

import numpy as np

from .draft_columns import guess_speeds, guess_steering, speed_unit
from .draft_guess import Guess, quoted, source_keys, time_units, usual_rate, words_of
from .formats import speed_csv, steer_csv
from .manifest import Speed, Steer, Units
from .raw import Floats
from .tables import find_header, read_text

DATE = dt.date(1970, 1, 1)  # the format does not need it
FRONT_WHEELS_TURN = 0.9  # rad: no front wheel turns further, so a larger angle is in degrees
FIELD_SPEED = 4.5  # m/s: a pass over a field is slower, so a larger median is in km/h
ROAD_SPEED = 100.0  # km/h: no tractor is faster, so a larger median is in mm/s


def bus_guesses(path: Path) -> list[Guess] | None:
    """What a table of times and signals holds; None where no column looks like steering or speed.

    Raises RawError for a file that is no such table.
    """
    names = find_header(read_text(path), path.name).names
    return [*_steering(path, names), *_speeds(path, names)] or None


def _steering(path: Path, names: tuple[str, ...]) -> list[Guess]:
    columns, reasons = guess_steering(names)
    if columns is None:
        return []
    units = time_units(path, columns["t_host_ns"], "host_time") | {"angle": "deg"}
    sensor = Steer(
        kind="steer", file=path.name, rate=50.0, columns=columns, units=Units.model_validate(units)
    )
    raw = steer_csv.read(path, sensor, "steer", DATE)
    if float(np.percentile(np.abs(np.degrees(raw.angle)), 99)) > FRONT_WHEELS_TURN:
        reasons = [*reasons, f"angles above {FRONT_WHEELS_TURN:g} are no rad of front wheels: degrees"]
    else:
        del units["angle"]
    keys = source_keys(columns, units) | {"rate": f"{usual_rate(raw.host_ns):.1f}"}
    return [Guess(path.name, "steer", keys, tuple(reasons), None, words_of(path))]


def _speeds(path: Path, names: tuple[str, ...]) -> list[Guess]:
    time, found = guess_speeds(names)
    if time is None:
        return []
    return [_speed(path, {"t_host_ns": time, "speed": name}, wheel) for name, wheel in found]


def _speed(path: Path, columns: dict[str, str], wheel: str | None) -> Guess:
    name = columns["speed"]
    units = time_units(path, columns["t_host_ns"], "host_time") | {"speed": "mm/s"}
    sensor = Speed(
        kind="speed", file=path.name, rate=20.0, columns=columns, units=Units.model_validate(units)
    )
    raw = speed_csv.read(path, sensor, "speed", DATE)
    unit, why = _unit(name, np.abs(raw.speed) * 1.0e3)
    if unit == "m/s":
        del units["speed"]
    else:
        units["speed"] = unit
    keys = source_keys(columns, units) | {"rate": f"{usual_rate(raw.host_ns):.1f}"}
    keys |= {"wheel": quoted(wheel)} if wheel else {}
    place = f"of the wheel {wheel}" if wheel else "of the vehicle: of its rear axle's middle"
    reasons = (f"column {name} is a speed, {place}", why)
    return Guess(path.name, "speed", keys, reasons, None, words_of(path))


def _unit(name: str, values: Floats) -> tuple[str, str]:
    """The unit that a column's name states, else that in which it is the speed of a pass over a field."""
    stated = speed_unit(name)
    if stated is not None:
        return stated, f"its name says {stated}"
    moving = values[values > 0.0]
    usual = float(np.median(moving)) if moving.size else 0.0
    unit = "mm/s" if usual > ROAD_SPEED else "km/h" if usual > FIELD_SPEED else "m/s"
    return unit, f"a median of {usual:.3g} is {unit}, assumed; ingest holds it against the receiver"
