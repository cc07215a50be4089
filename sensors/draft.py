"""A first run.toml for a folder of raw files: what each seems to be, and why."""

from __future__ import annotations

import datetime as dt
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .draft_bus import bus_guesses
from .draft_columns import guess_inertial
from .draft_guess import Guess, quoted, source_keys, time_units, usual_rate, words_of
from .draft_text import HEAD, MACHINE, SEEDER
from .formats import gcsv, gnss_csv, imu_csv, nmea, rtklib_pos, sensor_logger, ubx
from .manifest import GRAVITY, Gps, Imd, Units
from .plausibility import best_upright
from .presets import PRESETS
from .raw import Floats, RawError, RawGnss, RawImu
from .tables import find_header, read_head, read_text

PASSED_OVER = {"run.toml"}
MOST_FILES = 200
WHEEL_GRAVITY = 0.5  # of g: a turning wheel's mean specific force is below this
DEGREES_FROM = {True: 20.0, False: 4.0}  # a 99th percentile above this is no rad/s: of a wheel, of a body
WHEELS = ("front_right", "front_left", "rear_right", "rear_left")


class DraftError(ValueError):
    """A folder in which nothing could be recognised; one line."""


def draft_manifest(folder: Path) -> tuple[str, list[str]]:
    """A run.toml for the raw files of a folder, and what was guessed and why, a line each.

    The text is a valid manifest; lengths, masses and positions in it are typical values to be measured.

    Raises DraftError : no inertial unit or no GNSS log was recognised.
    """
    guesses: list[Guess] = []
    reasons: list[str] = []
    for path in sorted(p for p in folder.iterdir() if p.is_file() and p.name not in PASSED_OVER)[:MOST_FILES]:
        found = _recognised(path)
        guesses += found
        if not found:
            reasons.append(f"{path.name}: not recognised, passed over")
    _require(folder, guesses)
    tables, told = _tables(guesses)
    with_seeder = any('body = "seeder"' in table for table in tables)
    moment = next((guess.moment for guess in guesses if guess.kind == "gps" and guess.moment), None)
    moment = moment or next((guess.moment for guess in guesses if guess.moment), None)
    date = dt.datetime.fromtimestamp(moment or 0.0, dt.UTC).date()
    told.append(f"run.date = {date}: {'from the recordings' if moment else 'unknown, enter it'}")
    head = HEAD.format(id=_run_id(folder.resolve().name), date=date)
    body = "\n".join([head, MACHINE, *([SEEDER] if with_seeder else []), *tables])
    return body, reasons + told


def _require(folder: Path, guesses: Sequence[Guess]) -> None:
    for kinds, what in ((("imd",), "an inertial unit on a body"), (("gps",), "a receiver")):
        if not any(guess.kind in kinds for guess in guesses):
            raise DraftError(f"{folder.name}: no file looks like the log of {what}; see docs/formats.md")


def _run_id(name: str) -> str:
    cleaned = re.sub(r"\.{2,}", ".", re.sub(r"[^A-Za-z0-9._-]+", "-", name)).lstrip("._-")
    return cleaned[:64] or "pass"


def _recognised(path: Path) -> list[Guess]:
    """By the first way of reading the file that succeeds; a bus's export may hold several sensors."""
    for attempt in (_as_gnss, _as_inertial, bus_guesses):
        try:
            guess = attempt(path)
        except RawError:
            continue
        if guess is not None:
            return guess if isinstance(guess, list) else [guess]
    return []


def _as_gnss(path: Path) -> Guess | None:
    sensor = Gps(kind="gps", file=path.name, position=(0.0, 0.0, 0.0), rate=1.0)
    head = read_head(path)
    sentences = re.search(rb"\$(..(GGA|RMC)|PANDA|PAOGI),", head) is not None
    for form, fits in ((ubx, True), (rtklib_pos, True), (nmea, sentences), (gnss_csv, True)):
        if fits and form.reads(sensor, path, head):
            raw: RawGnss = form.read(path, sensor, "gps", dt.date(1970, 1, 1))
            rate = usual_rate(raw.utc)
            what = form.__name__.rsplit(".", 1)[-1]
            told = [f"read as {what}: {raw.utc.size} epochs at {rate:g} Hz"]
            told.append("position guessed: measure the antenna from the centre of mass")
            if raw.host_ns is None:
                told.append("no logger's time in it: the offset will be sought in the motion")
            keys = {"position": "[0.0, 0.0, 2.0]", "rate": f"{rate:.1f}"}
            day = raw.utc[0] if raw.utc[0] > 10 * 86400.0 else None  # without a date the day is a guess
            return Guess(path.name, "gps", keys, tuple(told), day, words_of(path))
    return None


def _as_inertial(path: Path) -> Guess | None:
    head = read_head(path)
    sensor = Imd(kind="imd", body="tractor", file=path.name, position=(0.0, 0.0, 0.0), rate=100.0)
    for form in (gcsv, sensor_logger):
        if form.reads(sensor, path, head):
            raw: RawImu = form.read(path, sensor, "imd", dt.date(1970, 1, 1))
            return _inertial(path, raw, {}, [f"read as {form.__name__.rsplit('.', 1)[-1]}"], {})
    header = find_header(read_text(path), path.name)
    columns, units, reasons = guess_inertial(header.names)
    known = any(set(preset.columns.values()) <= set(header.names) for preset in PRESETS)
    if columns is None and not known:
        return None
    columns = None if known else columns
    if columns and "t_host_ns" in columns:
        units |= time_units(path, columns["t_host_ns"], "host_time")
    sensor = sensor.model_copy(update={"columns": columns or {}, "units": Units.model_validate(units)})
    raw = imu_csv.read(path, sensor, "imd", dt.date(1970, 1, 1))
    return _inertial(path, raw, columns or {}, reasons, units)


def _inertial(
    path: Path, raw: RawImu, columns: Mapping[str, str], reasons: list[str], units: dict[str, str]
) -> Guess:
    """Kind, units and mounting from the readings."""
    force, turn = raw.specific_force, raw.angular_velocity
    size = float(np.median(np.linalg.norm(force, axis=1)))
    scale = 1.0
    if 0.7 < size < 1.4 and "accel" not in units:
        scale = GRAVITY
        units = units | {"accel": "g"}
        reasons = [*reasons, f"accelerations of {size:.2f} are g"]
    mean = force.mean(axis=0) * scale
    wheel = float(np.linalg.norm(mean)) < WHEEL_GRAVITY * GRAVITY
    if float(np.percentile(np.abs(turn), 99)) > DEGREES_FROM[wheel] and "gyro" not in units:
        turn = np.radians(turn)
        units = units | {"gyro": "deg/s"}
        reasons = [*reasons, "rotations too large for rad/s are deg/s"]
    rate = usual_rate(raw.host_ns)
    keys = source_keys(columns, units) | {"rate": f"{rate:.1f}"}
    if wheel:
        keys |= {"offset": "[0.0, 0.0, 0.0]", "rotation_deg": _axle(turn)}
        reasons = [*reasons, "gravity turns in its frame: it sits in a wheel"]
    else:
        roll, pitch = best_upright(mean)
        keys |= {"position": "[0.0, 0.0, 0.0]", "rotation_deg": f"[{roll:.1f}, {pitch:.1f}, 0.0]"}
        axis = int(np.argmax(np.abs(mean)))
        along = f"{'-' if mean[axis] < 0 else '+'}{'xyz'[axis]}"
        reasons = [
            *reasons,
            f"gravity along {along}: roll {roll}, pitch {pitch}; yaw cannot be seen, 0 assumed",
        ]
    start = float(raw.host_ns[0]) * 1.0e-9
    moment = start if start > 9.0e8 else None
    return Guess(path.name, "wds" if wheel else "imd", keys, tuple(reasons), moment, words_of(path))


def _axle(turn: Floats) -> str:
    """Mounting that brings the axis of most rotation onto the axle, forward positive."""
    axis = int(np.argmax((turn**2).sum(axis=0)))
    forward = turn[:, axis].mean() >= 0.0
    fits = {
        (0, True): "[0.0, 0.0, 90.0]",
        (0, False): "[0.0, 0.0, -90.0]",
        (1, True): "[0.0, 0.0, 0.0]",
        (1, False): "[0.0, 0.0, 180.0]",
        (2, True): "[-90.0, 0.0, 0.0]",
        (2, False): "[90.0, 0.0, 0.0]",
    }
    return fits[axis, bool(forward)]


def _tables(guesses: Sequence[Guess]) -> tuple[list[str], list[str]]:
    """A table of run.toml for each file, and the reasons."""
    tables, told = [], []
    counts: dict[str, int] = {}
    for guess in guesses:
        counts[guess.kind] = counts.get(guess.kind, 0) + 1
        keys, more = dict(guess.keys), []
        if guess.kind == "imd":
            keys["body"], why = _body(guess, counts["imd"])
            more.append(why)
        elif guess.kind == "gps":
            keys["body"] = '"tractor"'
        elif guess.kind == "wds":
            keys["wheel"], why = _wheel(guess, counts["wds"])
            more.append(why)
        alone = guess.kind in ("gps", "steer", "speed") and counts[guess.kind] == 1
        name = guess.kind if alone else f"{guess.kind}{counts[guess.kind]}"
        lines = [f"[sensors.{name}]", f'kind = "{guess.kind}"', f"file = {quoted(guess.file)}"]
        tables.append("\n".join([*lines, *(f"{key} = {value}" for key, value in keys.items())]) + "\n")
        told += [f"{guess.file} -> sensors.{name}: {reason}" for reason in (*guess.reasons, *more)]
    return tables, told


def _body(guess: Guess, number: int) -> tuple[str, str]:
    for word in guess.words:
        if word in ("seeder", "implement", "drill", "trailer", "cart", "planter"):
            return '"seeder"', f"'{word}' in the name: on the seeder"
        if word in ("tractor", "cab", "cabin"):
            return '"tractor"', f"'{word}' in the name: on the tractor"
    if number == 1:
        return '"tractor"', "the first inertial unit: on the tractor, assumed"
    return '"seeder"', "a further inertial unit: on the seeder, assumed"


def _wheel(guess: Guess, number: int) -> tuple[str, str]:
    words = set(guess.words)
    for wheel in WHEELS:
        end, side = wheel.split("_")
        if {end, side} <= words or (end[0] + side[0]) in words:
            return f'"{wheel}"', f"its name says {wheel}"
    wheel = WHEELS[(number - 1) % 4]
    return f'"{wheel}"', f"wheel number {number}: {wheel}, assumed"
