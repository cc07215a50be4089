"""NMEA 0183 sentences in a log's bytes, found and checked all at once as arrays of positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from . import decimals
from .decimals import Bools, Bytes, Floats, Ints
from .raw import Rejected

NEWLINE, RETURN, DOLLAR, STAR, COMMA, SPACE, P = (ord(c) for c in "\n\r$*, P")
OTHER = -1
MAX_SENTENCE = 255  # bytes; the standard's 82 are widely overrun
MAX_KEPT = 100_000  # rejected lines that are kept with their text
PREFIX_DIGITS = 20

NO_SENTENCE, NO_CHECKSUM, BAD_CHECKSUM, TOO_LONG, NO_HOST, BAD_FIELD, NO_TIME, OUT_OF_RANGE = range(8)
REASONS = (
    "no sentence",
    "cut off: no checksum",
    "bad checksum",
    "too long",
    "no host time in front, as the other lines have",
    "a field that is no number",
    "no time",
    "a value out of range",
)


@dataclass(frozen=True)
class Sentences:
    """Sound sentences, in file order: positions in the log's bytes, kind, line, host time (-1: none).

    commas : of all bytes, and their end
    """

    data: Bytes
    commas: Ints
    dollar: Ints
    star: Ints
    kind: Ints
    row: Ints
    host_ns: Ints

    def of(self, chosen: Bools) -> Sentences:
        """The chosen sentences."""
        picked = (self.dollar[chosen], self.star[chosen], self.kind[chosen], self.row[chosen])
        return Sentences(self.data, self.commas, *picked, self.host_ns[chosen])

    def field(self, number: int) -> tuple[Ints, Ints]:
        """Where field `number` (1: the first after the address) starts and stops; empty where missing."""
        last = self.commas.size - 1
        start = np.minimum(self.commas[np.minimum(self._first + number - 1, last)] + 1, self.star)
        stop = np.minimum(self.commas[np.minimum(self._first + number, last)], self.star)
        return start, np.maximum(start, stop)

    @cached_property
    def _first(self) -> Ints:
        """Where each sentence's first comma stands among all."""
        return np.asarray(np.searchsorted(self.commas, self.dollar), dtype=np.int64)

    def number(self, number: int) -> tuple[Floats, Bools]:
        """A field as a decimal, NaN where empty, and where it is sound."""
        return decimals.decimals(self.data, *self.field(number))

    def letter(self, number: int) -> Bytes:
        """First byte of a field, 0 where empty."""
        first: Bytes = decimals.cells(self.data, *self.field(number), 1)[0]
        return first


@dataclass(frozen=True)
class Refusals:
    """Lines that were not taken: number, why (an index into REASONS), where they begin in the bytes."""

    row: Ints
    reason: Ints
    start: Ints

    def with_more(self, row: Ints, reason: Ints, start: Ints) -> Refusals:
        """These and others, in file order."""
        starts = np.concatenate([self.start, start])
        order = np.argsort(starts, kind="stable")
        rows, reasons = np.concatenate([self.row, row]), np.concatenate([self.reason, reason])
        return Refusals(rows[order], reasons[order], starts[order])

    def listed(self, data: Bytes) -> tuple[Rejected, ...]:
        """Each refused line with its reason and how it begins; the first MAX_KEPT."""
        parts = zip(self.row[:MAX_KEPT].tolist(), self.reason.tolist(), self.start.tolist(), strict=False)
        return tuple(Rejected(row, REASONS[reason], _line_at(data, start)) for row, reason, start in parts)

    def counts(self) -> dict[str, int]:
        """How many lines were refused for each reason."""
        numbers = np.bincount(self.reason, minlength=len(REASONS)).tolist()
        return {REASONS[k]: count for k, count in enumerate(numbers) if count}


def _line_at(data: Bytes, start: int) -> str:
    return data[start : start + 120].tobytes().split(b"\n")[0].rstrip(b"\r").decode("ascii", "replace")


def scan(data: Bytes, kinds: Sequence[str]) -> tuple[Sentences, Refusals, int]:
    """The sound sentences of the given kinds, what was refused, and how many sound ones were passed over.

    kinds : what follows the two letters of the talker, such as "GGA"; a kind that begins with "P" is a whole
        address, such as "PANDA".
    """
    ends = np.flatnonzero((data == NEWLINE) | (data == RETURN))
    newlines = np.flatnonzero(data == NEWLINE)
    dollar = np.flatnonzero(data == DOLLAR)
    stop = np.append(ends, data.size)[np.searchsorted(ends, dollar)]
    stop = np.minimum(stop, np.append(dollar[1:], data.size)[: dollar.size])
    stars = np.flatnonzero(data == STAR)
    star = np.append(stars, data.size)[np.searchsorted(stars, dollar)]
    row = np.searchsorted(newlines, dollar) + 1
    kind = _kinds(data, dollar, kinds)
    host_ns = _host_times(data, dollar)
    reason = _soundness(data, dollar, star, stop)
    wanted = (reason < 0) & (kind != OTHER)
    if np.count_nonzero(host_ns[wanted] >= 0) * 2 > np.count_nonzero(wanted):
        reason = np.where(wanted & (host_ns < 0), NO_HOST, reason)
    else:
        host_ns = np.full_like(host_ns, -1)
    bad, chosen = reason >= 0, (reason < 0) & (kind != OTHER)
    commas = np.append(np.flatnonzero(data == COMMA), data.size)
    sentences = Sentences(data, commas, dollar, star, kind, row, host_ns).of(chosen)
    refused = Refusals(row[bad], reason[bad], dollar[bad]).with_more(*_bare_lines(data, newlines, row))
    return sentences, refused, int(np.count_nonzero(~bad & ~chosen))


def _soundness(data: Bytes, dollar: Ints, star: Ints, stop: Ints) -> Ints:
    """Why each candidate is refused, -1 where it is sound.

    The checksum is the exclusive or of all bytes between `$` and `*`: the difference of two running totals.
    """
    running = np.bitwise_xor.accumulate(data)
    padded = np.append(data, np.zeros(3, dtype=np.uint8))
    inside = np.minimum(star, data.size - 1)
    total = running[np.maximum(inside - 1, 0)] ^ running[dollar]
    stated = _hex(padded[inside + 1]) * 16 + _hex(padded[inside + 2])
    reason = np.where(total == stated, -1, BAD_CHECKSUM)
    reason = np.where(star + 2 >= stop, NO_CHECKSUM, reason)
    return np.where(stop - dollar > MAX_SENTENCE, TOO_LONG, reason)


def _hex(byte: Bytes) -> Ints:
    """Value of a hexadecimal digit; more than two digits can hold for any other byte."""
    table = np.full(256, 1000, dtype=np.int64)
    for value, digit in enumerate("0123456789ABCDEF"):
        table[[ord(digit), ord(digit.lower())]] = value
    return np.asarray(table[byte])


def _kinds(data: Bytes, dollar: Ints, kinds: Sequence[str]) -> Ints:
    """Which of `kinds` each address names: a talker's two letters (not P.) and the kind, or all of it."""
    padded = np.append(data, np.zeros(8, dtype=np.uint8))
    address = [padded[dollar + k] for k in range(1, 7)]
    five = address[5] == COMMA
    kind = np.full(dollar.size, OTHER, dtype=np.int64)
    for number, name in enumerate(kinds):
        whole = name.startswith("P")
        same = five & (whole | (address[0] != P))
        for letter, byte in zip(name, address if whole else address[2:], strict=False):
            same &= byte == ord(letter)
        kind[same] = number
    return kind


def _host_times(data: Bytes, dollar: Ints) -> Ints:
    """The whole number at the line's start, a space between it and `$`; -1 where there is none."""
    length = np.zeros(dollar.size, dtype=np.int64)
    running = data[np.maximum(dollar - 1, 0)] == SPACE
    for k in range(2, PREFIX_DIGITS + 2):
        at = dollar - k
        byte = data[np.maximum(at, 0)]
        running &= (at >= 0) & (byte >= ord("0")) & (byte <= ord("9"))
        length += running
    start = dollar - 1 - length
    before = data[np.maximum(start - 1, 0)]
    fresh = (start <= 0) | (before == NEWLINE) | (before == RETURN)
    value, good = decimals.integers(data, np.maximum(start, 0), np.maximum(dollar - 1, 0))
    return np.where(good & fresh & (length > 0), value, -1)


def _bare_lines(data: Bytes, newlines: Ints, rows_with_dollar: Ints) -> tuple[Ints, Ints, Ints]:
    """Lines that hold no `$` and are not blank, as (row, reason, start)."""
    starts = np.concatenate([np.zeros(1, dtype=np.int64), newlines + 1])
    stops = np.append(newlines, data.size)
    bare = np.ones(starts.size, dtype=np.bool_)
    bare[rows_with_dollar - 1] = False
    at = np.minimum(starts, data.size - 1)
    blank = (stops == starts) | ((stops - starts == 1) & (data[at] == RETURN))
    lines = np.flatnonzero(bare & ~blank)
    return lines + 1, np.full(lines.size, NO_SENTENCE, dtype=np.int64), starts[lines]
