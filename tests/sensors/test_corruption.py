"""A sound pass, damaged on purpose: what is left is right, what is lost is counted, named with file and row."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from raw_samples import START, Plan, gps_lines, imu_lines, write_pass, yaw_rate
from smts_validate.sensors.ingest import IngestError, read_pass
from smts_validate.sensors.streams import FieldLog, GnssStream, ImuStream

HEADER = "t_host_ns,t_dev_us,seq,ax,ay,az,gx,gy,gz"
PLAN = Plan(seconds=30.0, gnss_latency=0.1)
SHARE = 0.02
Rows = list[str]
Damage = Callable[[random.Random, Rows], Rows]


def _some(rng: random.Random, rows: Rows) -> list[int]:
    """Rows to damage; the first ones are left, as they anchor what follows."""
    return sorted(rng.sample(range(20, len(rows) - 20), int(SHARE * len(rows))))


def _cell(value: str, column: int) -> Damage:
    def damage(rng: random.Random, rows: Rows) -> Rows:
        for k in _some(rng, rows):
            cells = rows[k].split(",")
            if len(cells) > column:  # not yet cut by another damage
                cells[column] = value
            rows[k] = ",".join(cells)
        return rows

    return damage


def _lost(rng: random.Random, rows: Rows) -> Rows:
    gone = set(_some(rng, rows))
    return [row for k, row in enumerate(rows) if k not in gone]


def _doubled(rng: random.Random, rows: Rows) -> Rows:
    twice = set(_some(rng, rows))
    return [row for k, row in enumerate(rows) for _ in range(1 + (k in twice))]


def _cut(rng: random.Random, rows: Rows) -> Rows:
    for k in _some(rng, rows):
        rows[k] = rows[k][: rng.randrange(1, len(rows[k]) - 30)]
    return rows


def _joined(rng: random.Random, rows: Rows) -> Rows:
    for k in reversed(_some(rng, rows)):
        rows[k - 1 : k + 1] = [rows[k - 1] + rows[k]]
    return rows


def _swapped(rng: random.Random, rows: Rows) -> Rows:
    """Neighbours' readings and counters change places; the logger's stamps stay in order."""
    for k in _some(rng, rows):
        first, second = rows[k - 1].split(",", 1), rows[k].split(",", 1)
        rows[k - 1], rows[k] = f"{first[0]},{second[1]}", f"{second[0]},{first[1]}"
    return rows


def _rubbish(rng: random.Random, rows: Rows) -> Rows:
    for k in reversed(_some(rng, rows)):
        rows.insert(k, "".join(chr(rng.randrange(33, 126)) for _ in range(rng.randrange(1, 80))))
    return rows


DAMAGES: dict[str, Damage] = {
    "lost": _lost,
    "doubled": _doubled,
    "cut": _cut,
    "joined": _joined,
    "swapped": _swapped,
    "rubbish": _rubbish,
    "empty value": _cell("", 8),
    "nan": _cell("nan", 4),
    "infinity": _cell("inf", 8),
    "absurd value": _cell("1e34", 7),
    "text": _cell("ERR", 3),
    "empty time": _cell("", 0),
    "time zero": _cell("0", 0),
    "empty counter": _cell("", 1),
    "absurd counter": _cell("4000000000", 1),
    "empty sequence": _cell("", 2),
}


def damaged_pass(folder: Path, seed: int, *names: str) -> FieldLog:
    """The pass with some damages done to imd1.csv, in that order."""
    rng, rows = random.Random(seed), imu_lines(PLAN)
    for name in names:
        rows = DAMAGES[name](rng, rows)
    write_pass(folder, PLAN)
    (folder / "imd1.csv").write_text("\n".join([HEADER, *rows]) + "\n")
    return read_pass(folder)


def assert_what_is_left_is_right(log: FieldLog) -> None:
    stream = log.streams["imd1"]
    assert isinstance(stream, ImuStream)
    error = stream.angular_velocity[:, 2] - yaw_rate(stream.t - START)
    assert np.abs(error).max() < 0.02  # noise of 0.002 rad/s, and timing
    assert np.sqrt(np.mean(error**2)) < 0.004
    assert stream.t.size > 0.85 * 3000


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_table_is_mended_and_the_damage_named(tmp_path: Path, name: str) -> None:
    log = damaged_pass(tmp_path / "pass", 1, name)
    assert_what_is_left_is_right(log)
    told = [warning for warning in log.warnings if warning.sensor == "imd1"]
    assert told
    assert all(warning.file == "imd1.csv" and warning.row is not None for warning in told)
    assert all(warning.what and warning.effect for warning in told)


@pytest.mark.parametrize("seed", range(12))
def test_several_damages_at_once_are_mended(tmp_path: Path, seed: int) -> None:
    names = random.Random(seed).sample(sorted(DAMAGES), 4)
    assert_what_is_left_is_right(damaged_pass(tmp_path / "pass", seed, *names))


@pytest.mark.parametrize("seed", range(6))
def test_damaged_sentences_cost_only_themselves(tmp_path: Path, seed: int) -> None:
    rng, lines = random.Random(seed), gps_lines(PLAN)
    for damage in (_lost, _doubled, _cut, _rubbish, _joined):
        lines = damage(rng, lines)
    folder = write_pass(tmp_path / "pass", PLAN)
    (folder / "gps.nmea").write_text("\n".join(lines) + "\n")
    log = read_pass(folder)
    assert_what_is_left_is_right(log)
    gnss = log.streams["gps"]
    assert isinstance(gnss, GnssStream)
    assert gnss.t.size > 290
    assert np.abs((gnss.t - START) * 10 - np.rint((gnss.t - START) * 10)).max() < 1e-3
    assert np.nanmax(np.abs(gnss.lat - 50.04)) < 0.01


@pytest.mark.parametrize("seed", range(20))
def test_bytes_changed_at_random_are_mended_or_refused_in_one_line(tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)
    folder = write_pass(tmp_path / "pass", PLAN)
    for file in ("imd1.csv", "gps.nmea"):
        data = bytearray((folder / file).read_bytes())
        for _ in range(rng.choice((1, 30, 300))):
            data[rng.randrange(len(data))] = rng.randrange(256)
        (folder / file).write_bytes(bytes(data))
    try:
        log = read_pass(folder)
    except IngestError as error:
        told = str(error)
        if "\n" in told:
            pytest.fail(told)
        return
    stream = log.streams["imd1"]
    assert isinstance(stream, ImuStream)
    error = stream.angular_velocity[:, 2] - yaw_rate(stream.t - START)
    assert np.median(np.abs(error)) < 0.003  # single digits may have changed and cannot be seen
