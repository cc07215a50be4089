"""NMEA 0183 with the logger's time in front of each sentence: `<t_host_ns> $GNGGA,...*hh`."""

from __future__ import annotations

import datetime as dt
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..decimals import Bools, Floats, Ints
from ..manifest import UNDATED, Gps, Sensor
from ..raw import RawError, RawGnss
from ..sentences import BAD_FIELD, NO_TIME, OUT_OF_RANGE, REASONS, Refusals, Sentences, scan
from ..streams import GnssStream, Warn
from ..tables import read_bytes

DAY = 86400.0
HALF_DAY = 43200.0
KNOT = 1852.0 / 3600.0
KMH = 1.0 / 3.6
KINDS = ("GGA", "RMC", "VTG", "GST", "HDT", "THS", "PANDA", "PAOGI", "ZDA")
GGA, RMC, VTG, GST, HDT, THS, PANDA, PAOGI, ZDA = range(9)
TIMED = (GGA, RMC, GST, PANDA, PAOGI, ZDA)
PLACED = (GGA, RMC, PANDA, PAOGI)
TICKS = 1.0e3  # epochs are told apart to a millisecond
MOST_LINES = 10_000_000  # two days of five sentences ten times a second
MOST_COMMAS = 100_000_000
BURST = 0.05  # s, within which the sentences of an epoch follow each other
WEEK_ROLLOVER = 1024 * 7  # days: a receiver that lost count of GPS weeks is off by multiples of this
MODE_QUALITY = {"A": 1.0, "D": 2.0, "P": 3.0, "R": 4.0, "F": 5.0, "E": 6.0, "N": 0.0}


def reads(sensor: Sensor, path: Path, head: bytes) -> bool:
    """Whether this format is for that sensor's file."""
    del path, head
    return isinstance(sensor, Gps)


def read(path: Path, sensor: Sensor, name: str, date: dt.date) -> RawGnss:
    """The epochs of a receiver's log; lines that cannot be used are counted and kept with the reason.

    date : UTC date of the first sentence, for logs without RMC and ZDA; UNDATED: such logs keep that day

    Raises RawError : no epoch has a position.
    """
    del sensor
    return parse(read_bytes(path), path.name, name, date)


def parse(text: bytes, file: str, name: str, date: dt.date) -> RawGnss:
    """The epochs in a log's bytes; see `read`."""
    for mark, what in ((b"\n", "lines"), (b"\r", "lines"), (b"$", "sentences")):
        if text.count(mark) > MOST_LINES:
            raise RawError(f"{file}: has more than {MOST_LINES} {what}; split it")
    if text.count(b",") > MOST_COMMAS:
        raise RawError(f"{file}: is no NMEA log, it holds more than {MOST_COMMAS} commas")
    data = np.frombuffer(text or b"\n", dtype=np.uint8)
    sentences, refused, passed_over = scan(data, KINDS)
    fields, sentences, refused = _understood(sentences, refused)
    if not np.isin(sentences.kind, PLACED).any():
        counts = ", ".join(f"{count} {reason}" for reason, count in refused.counts().items())
        raise RawError(f"{file}: no usable GGA or RMC sentence{f' ({counts})' if counts else ''}")
    utc, warnings = _utc(fields, sentences, date, file, name)
    placed = sentences.kind != ZDA  # which tells the day and nothing else
    gnss = _epochs(fields.of(placed), sentences.of(placed), utc[placed])
    warnings += _refusal_warnings(refused, file, name) + _altitude_warnings(fields, sentences, file, name)
    return RawGnss(
        gnss.utc,
        gnss.host_ns,
        gnss.rows,
        gnss.values,
        sentences.kind.size + passed_over,
        int(refused.row.size),
        refused.listed(data),
        tuple(warnings),
        refused.counts(),
    )


@dataclass(frozen=True)
class Fields:
    """What the sentences say, SI units, one value a sentence, NaN where its kind does not say it."""

    time_of_day: Floats
    day: Floats  # of RMC and ZDA, days since the epoch
    values: dict[str, Floats]
    geoid_missing: Bools

    def of(self, chosen: Bools) -> Fields:
        """Of the chosen sentences."""
        values = {key: value[chosen] for key, value in self.values.items()}
        return Fields(self.time_of_day[chosen], self.day[chosen], values, self.geoid_missing[chosen])


def _understood(sentences: Sentences, refused: Refusals) -> tuple[Fields, Sentences, Refusals]:
    """Fields of the sentences, those with an unusable field refused."""
    fields, reason = _fields(sentences)
    good, bad = reason < 0, reason >= 0
    refused = refused.with_more(sentences.row[bad], reason[bad], sentences.dollar[bad])
    return fields.of(good), sentences.of(good), refused


def _fields(sentences: Sentences) -> tuple[Fields, Ints]:
    n = sentences.kind.size
    values = {key: np.full(n, np.nan) for key in GnssStream.ARRAYS}
    time_of_day, day = np.full(n, np.nan), np.full(n, np.nan)
    geoid_missing = np.zeros(n, dtype=np.bool_)
    reason = np.full(n, -1, dtype=np.int64)
    for kind, understand in _READERS.items():
        chosen = sentences.kind == kind
        if chosen.any():
            part = _Part(sentences.of(chosen))
            for key, value in understand(part).items():
                if key == "time_of_day":
                    time_of_day[chosen] = value
                elif key == "day":
                    day[chosen] = value
                elif key == "geoid_missing":
                    geoid_missing[chosen] = value > 0.0
                else:
                    values[key][chosen] = value
            reason[chosen] = part.reason()
    return Fields(time_of_day, day, values, geoid_missing), reason


class _Part:
    """Sentences of one kind, and which of their fields turned out unusable."""

    def __init__(self, sentences: Sentences) -> None:
        self.sentences = sentences
        n = sentences.kind.size
        self.unsound = np.zeros(n, dtype=np.bool_)
        self.untimed = np.zeros(n, dtype=np.bool_)
        self.outside = np.zeros(n, dtype=np.bool_)

    def number(self, field: int, low: float = -np.inf, high: float = np.inf) -> Floats:
        """A decimal field, NaN where empty; what lies outside [low, high] is noted."""
        value, sound = self.sentences.number(field)
        self.unsound |= ~sound
        self.outside |= (value < low) | (value > high)
        return value

    def letter_is(self, field: int, letters: str) -> Bools:
        """Whether a field begins with one of the letters."""
        return np.asarray(np.isin(self.sentences.letter(field), [ord(letter) for letter in letters]))

    def time_of_day(self, field: int = 1) -> Floats:
        """hhmmss.sss as seconds of the day; a leap second is 23:59:60."""
        value = self.number(field)
        self.untimed |= np.isnan(value)
        hours = np.floor(value / 1.0e4)
        minutes = np.floor(value / 1.0e2) - 100.0 * hours
        seconds = value - 1.0e4 * hours - 1.0e2 * minutes
        leap = (hours == 23.0) & (minutes == 59.0)
        self.outside |= (hours > 23.0) | (minutes > 59.0) | (seconds >= 60.0 + leap)
        return np.asarray(3600.0 * hours + 60.0 * minutes + np.round(seconds, 6))

    def angle(self, field: int, limit: float, negative: str) -> Floats:
        """dddmm.mmmm and its hemisphere as degrees."""
        value = self.number(field, 0.0)
        degrees = np.floor(value / 100.0)
        minutes = value - 100.0 * degrees
        angle = degrees + minutes / 60.0
        self.outside |= (minutes >= 60.0) | (angle > limit)
        return np.where(self.letter_is(field + 1, negative), -angle, angle)

    def reason(self) -> Ints:
        """Why each sentence is refused, -1 where it is not."""
        reason = np.where(self.outside, OUT_OF_RANGE, -1)
        reason = np.where(self.untimed, NO_TIME, reason)
        return np.where(self.unsound, BAD_FIELD, reason)


def _to_yaw(compass_deg: Floats) -> Floats:
    """Compass degrees (clockwise from North) as rad counter-clockwise from East."""
    return np.asarray(np.pi / 2 - np.radians(compass_deg))


def _gga(part: _Part) -> dict[str, Floats]:
    quality = part.number(6, 0.0, 9.0)
    fixed = quality > 0.0
    sea_level, geoid = part.number(9, -1.0e4, 1.0e5), part.number(11, -200.0, 200.0)
    return {
        "time_of_day": part.time_of_day(),
        "lat": np.where(fixed, part.angle(2, 90.0, "S"), np.nan),
        "lon": np.where(fixed, part.angle(4, 180.0, "W"), np.nan),
        "alt": np.where(fixed, np.nan_to_num(sea_level) + np.nan_to_num(geoid), np.nan),
        "quality": np.nan_to_num(quality),
        "satellites": part.number(7, 0.0, 999.0),
        "hdop": part.number(8, 0.0),
        "geoid_missing": (fixed & (np.isnan(geoid) | np.isnan(sea_level))).astype(np.float64),
    }


def _rmc(part: _Part) -> dict[str, Floats]:
    valid = part.letter_is(2, "A")
    day = _day(part.number(9, 10100.0, 311299.0))
    return {
        "time_of_day": part.time_of_day(),
        "lat": np.where(valid, part.angle(3, 90.0, "S"), np.nan),
        "lon": np.where(valid, part.angle(5, 180.0, "W"), np.nan),
        "speed": np.where(valid, part.number(7, 0.0, 1000.0) * KNOT, np.nan),
        "course": np.where(valid, _to_yaw(part.number(8, -360.0, 360.0)), np.nan),
        "quality": np.where(valid, _mode_quality(part), 0.0),
        "day": np.where(valid, day, np.nan),
    }


def _mode_quality(part: _Part) -> Floats:
    quality = np.ones(part.unsound.size)
    letters = part.sentences.letter(12)
    for letter, value in MODE_QUALITY.items():
        quality[letters == ord(letter)] = value
    return quality


def _day(ddmmyy: Floats) -> Floats:
    """Days since the epoch of dates written ddmmyy; years 80 to 99 are of the last century."""
    codes, where = np.unique(np.nan_to_num(ddmmyy, nan=-1.0), return_inverse=True)
    return np.array([_one_day(int(code)) for code in codes])[where]


def _one_day(code: int) -> float:
    day, month, year = code // 10000, code // 100 % 100, code % 100
    try:
        return float((dt.date(year + (1900 if year >= 80 else 2000), month, day) - dt.date(1970, 1, 1)).days)
    except ValueError:
        return float("nan")


def _vtg(part: _Part) -> dict[str, Floats]:
    knots, kmh = part.number(5, 0.0, 1000.0) * KNOT, part.number(7, 0.0, 2000.0) * KMH
    return {"speed": np.where(np.isnan(kmh), knots, kmh), "course": _to_yaw(part.number(1, -360.0, 360.0))}


def _gst(part: _Part) -> dict[str, Floats]:
    north, east, up = (part.number(field, 0.0) for field in (6, 7, 8))
    return {"time_of_day": part.time_of_day(), "sd_north": north, "sd_east": east, "sd_up": up}


def _hdt(part: _Part) -> dict[str, Floats]:
    return {"heading": _to_yaw(part.number(1, -360.0, 360.0))}


def _ths(part: _Part) -> dict[str, Floats]:
    valid = ~part.letter_is(2, "V")
    return {"heading": np.where(valid, _to_yaw(part.number(1, -360.0, 360.0)), np.nan)}


def _panda(part: _Part) -> dict[str, Floats]:
    """AgOpenGPS: GGA's fields up to the age of corrections, then speed in knots; no geoid separation."""
    fixed = part.number(6, 0.0, 9.0) > 0.0
    return {
        "time_of_day": part.time_of_day(),
        "lat": np.where(fixed, part.angle(2, 90.0, "S"), np.nan),
        "lon": np.where(fixed, part.angle(4, 180.0, "W"), np.nan),
        "alt": np.where(fixed, np.nan_to_num(part.number(9, -1.0e4, 1.0e5)), np.nan),
        "quality": np.nan_to_num(part.number(6, 0.0, 9.0)),
        "satellites": part.number(7, 0.0, 999.0),
        "hdop": part.number(8, 0.0),
        "speed": part.number(11, 0.0, 1000.0) * KNOT,
        "geoid_missing": fixed.astype(np.float64),
    }


def _paogi(part: _Part) -> dict[str, Floats]:
    """AgOpenGPS with two antennas: as `_panda`, and the true heading between them."""
    return _panda(part) | {"heading": _to_yaw(part.number(12, -360.0, 360.0))}


def _zda(part: _Part) -> dict[str, Floats]:
    day, month, year = part.number(2, 1.0, 31.0), part.number(3, 1.0, 12.0), part.number(4, 1980.0, 2079.0)
    return {"time_of_day": part.time_of_day(), "day": _day(1.0e4 * day + 1.0e2 * month + year % 100.0)}


_READERS = {
    GGA: _gga,
    RMC: _rmc,
    VTG: _vtg,
    GST: _gst,
    HDT: _hdt,
    THS: _ths,
    PANDA: _panda,
    PAOGI: _paogi,
    ZDA: _zda,
}


def _utc(
    fields: Fields, sentences: Sentences, date: dt.date, file: str, name: str
) -> tuple[Floats, list[Warn]]:
    """Each sentence's UTC, s since the epoch; those without a time take their epoch's.

    Midnight is where the time of day falls by more than half a day. After a leap second the scale goes on
    evenly, so that no two instants are the same: one second ahead of the calendar.
    """
    timed = np.flatnonzero(np.isin(sentences.kind, TIMED))
    time_of_day = fields.time_of_day[timed]
    days = _midnights(time_of_day, np.isfinite(fields.values["lat"][timed]))
    stated, by_rmc = fields.day[timed] - days, sentences.kind[timed] == RMC
    stated = stated[~np.isnan(stated) & (by_rmc | ~np.isfinite(fields.day[timed][by_rmc]).any())]
    first_day, warnings = _first_day(stated, date, file, name)
    leap = time_of_day >= DAY
    since_leap = np.maximum.accumulate(leap) & ~leap & (days > days[np.argmax(leap)])
    if leap.any():
        row = int(sentences.row[timed[np.argmax(leap)]])
        warnings.append(Warn("a leap second", "times after it run 1 s ahead of UTC", name, file, row))
    utc = np.full(sentences.kind.size, np.nan)
    utc[timed] = (first_day + days) * DAY + time_of_day + since_leap
    untimed = np.flatnonzero(np.isnan(utc))
    utc[untimed] = utc[timed[_nearest_timed(sentences, timed, untimed)]]
    return utc, warnings


def _midnights(time_of_day: Floats, fixed: Bools) -> Ints:
    """How many midnights went before each sentence.

    A receiver without a fix may send any time, so only sentences with a position tell; others follow them.
    """
    telling = np.flatnonzero(fixed)
    if telling.size == 0:
        telling = np.arange(time_of_day.size)
    told = time_of_day[telling]
    change = np.diff(told, prepend=told[0])
    days = np.cumsum((change < -HALF_DAY).astype(np.int64) - (change > HALF_DAY))
    before = np.searchsorted(telling, np.arange(time_of_day.size), side="right") - 1
    return np.asarray(days[np.maximum(before, 0)], dtype=np.int64)


def _first_day(stated: Floats, date: dt.date, file: str, name: str) -> tuple[float, list[Warn]]:
    """Day of the log's start: the receiver's, or run.toml's where it tells none or its weeks rolled over.

    stated : days since the epoch by each RMC, or by each ZDA where no RMC tells one
    """
    given = float((date - dt.date(1970, 1, 1)).days)
    if stated.size == 0:
        return given, []
    first = float(np.median(stated))
    off = first - given
    if off == 0.0 or date == UNDATED:
        return first, []
    weeks = round(off / WEEK_ROLLOVER) * WEEK_ROLLOVER
    if weeks and abs(off - weeks) <= 1.0:
        return first - weeks, [Warn("RMC's date is off by 1024 weeks", "corrected", name, file)]
    shown = dt.date(1970, 1, 1) + dt.timedelta(days=first)
    return first, [Warn(f"RMC's date is {shown}, run.toml's {date}", "RMC's is used", name, file)]


def _nearest_timed(sentences: Sentences, timed: Ints, untimed: Ints) -> Ints:
    """For sentences without time: the timed one before, or the one after where their kind is sent ahead of it.

    A kind keeps its place in the burst, so the majority decides: single host times may be wrong.
    """
    after = np.searchsorted(timed, untimed)
    before = np.maximum(after - 1, 0)
    after = np.minimum(after, timed.size - 1)
    host, kind = sentences.host_ns, sentences.kind[untimed]
    to_before, to_after = host[untimed] - host[timed[before]], host[timed[after]] - host[untimed]
    sooner = (to_after >= 0) & (2 * to_after < to_before)
    ahead = np.zeros(untimed.size, dtype=np.bool_)
    for one in range(len(KINDS)):
        same = kind == one
        ahead[same] = 2 * np.count_nonzero(sooner[same]) > np.count_nonzero(same)
    return np.where(ahead, after, before)


def _epochs(fields: Fields, sentences: Sentences, utc: Floats) -> RawGnss:
    """Sentences of one instant put together. Where two speak of a value, the better source does."""
    ticks = np.rint(utc * TICKS).astype(np.int64)
    instants, first, epoch = np.unique(ticks, return_index=True, return_inverse=True)
    values = {key: np.full(first.size, np.nan) for key in GnssStream.ARRAYS}
    for kind in (RMC, PANDA, PAOGI, VTG, GST, HDT, THS, GGA):
        chosen = sentences.kind == kind
        for key in GnssStream.ARRAYS:
            said = chosen & ~np.isnan(fields.values[key])
            values[key][epoch[said]] = fields.values[key][said]
    nowhere = np.isnan(values["lat"]) | np.isnan(values["lon"])
    values["alt"] = _altitudes(instants, values["alt"])
    for key in ("lat", "lon", "alt"):
        values[key] = np.where(nowhere, np.nan, values[key])
    values["quality"] = np.nan_to_num(values["quality"])
    prefixed = bool((sentences.host_ns >= 0).all())
    host = _arrivals(sentences, first, epoch) if prefixed else None
    return RawGnss(utc[first], host, sentences.row[first], values)


def _altitudes(instants: Ints, alt: Floats) -> Floats:
    """Altitudes (N,), m, bridged where an epoch has lost its GGA; 0 where the file has none.

    RMC alone still gives a position there: a zero in the midst of a field would be a pit as deep as its altitude.
    """
    known = np.isfinite(alt)
    if not known.any():
        return np.zeros(alt.size)
    return np.asarray(np.interp(instants, instants[known], alt[known]), dtype=np.float64)


def _arrivals(sentences: Sentences, first: Ints, epoch: Ints) -> Ints:
    """When each epoch's first sentence arrived, ns.

    No checksum covers the logger's time. Sentences of an epoch come in a burst, each kind in its place, so where
    the first one's time contradicts the others', theirs less the usual delay of their kind is taken.
    """
    host = sentences.host_ns[first]
    behind = np.full((first.size, len(KINDS)), np.nan)
    behind[epoch, sentences.kind] = (sentences.host_ns - host[epoch]) * 1.0e-9
    present = np.flatnonzero(~np.isnan(behind).all(axis=0))
    behind = behind[:, present]
    late = behind - np.nanmedian(behind, axis=0)
    error = np.nanmedian(late, axis=1)
    wrong = (np.abs(error) > BURST) & (np.count_nonzero(~np.isnan(late), axis=1) > 2)
    return host + np.where(wrong, np.rint(error * 1.0e9), 0.0).astype(np.int64)


def _refusal_warnings(refused: Refusals, file: str, name: str) -> list[Warn]:
    """One warning for each reason, with its count and first line."""
    warnings = []
    for reason, count in refused.counts().items():
        row = int(refused.row[np.argmax(refused.reason == REASONS.index(reason))])
        warnings.append(Warn(f"{count} lines refused: {reason}", "dropped", name, file, row))
    return warnings


def _altitude_warnings(fields: Fields, sentences: Sentences, file: str, name: str) -> list[Warn]:
    missing = fields.geoid_missing
    if not missing.any():
        return []
    row = int(sentences.row[np.argmax(missing)])
    what = f"{int(missing.sum())} sentences without altitude or geoid separation"
    return [Warn(what, "taken as 0 m: altitudes are not ellipsoidal", name, file, row)]
