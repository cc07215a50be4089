"""Numbers in text, a whole column at a time: plain decimals between given positions of a byte buffer."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

MAX_DIGITS = 18  # fit in 63 bits
MAX_WIDTH = 24
POINT, PLUS, MINUS, ZERO = ord("."), ord("+"), ord("-"), ord("0")


def cells(data: Bytes, start: Ints, stop: Ints, width: int) -> NDArray[np.uint8]:
    """Bytes of the fields [start, stop), (width, N), zero where a field is shorter."""
    text = np.empty((width, start.size), dtype=np.uint8)
    size = stop - start
    for column in range(width):
        np.multiply(data.take(start + column, mode="clip"), column < size, out=text[column])
    return text


def decimals(data: Bytes, start: Ints, stop: Ints) -> tuple[Floats, Bools]:
    """Values of the fields, and which are sound: a plain decimal, or empty (then the value is NaN).

    A decimal of at most 15 digits comes out as Python's float() gives it: its digits as an integer, divided
    by an exact power of ten, are rounded once.
    """
    mantissa, places, negative, digits, sound = _digits(data, start, stop)
    value = np.where(negative, -1.0, 1.0) * mantissa / 10.0**places
    return np.where(sound & (digits > 0), value, np.nan), sound


def integers(data: Bytes, start: Ints, stop: Ints) -> tuple[Ints, Bools]:
    """Values of the fields that are whole decimals of at most 18 digits (19 up to 2^63), and which are."""
    mantissa, places, negative, digits, sound = _digits(data, start, stop, digits_allowed=19)
    good = sound & (digits > 0) & (places == 0) & (mantissa >= 0)
    return np.where(good, np.where(negative, -mantissa, mantissa), 0), good


def _digits(
    data: Bytes, start: Ints, stop: Ints, digits_allowed: int = MAX_DIGITS
) -> tuple[Ints, Ints, Bools, Ints, Bools]:
    """Digits as an integer, how many stand after the point, sign, number of digits, whether all is sound."""
    size = stop - start
    width = int(min(max(size.max(initial=0), 1), MAX_WIDTH))
    text = cells(data, start, stop, width)
    negative = text[0] == MINUS
    sign = negative | (text[0] == PLUS)
    mantissa = np.zeros(start.size, dtype=np.int64)
    places, digits, points = (np.zeros(start.size, dtype=np.int64) for _ in range(3))
    other = np.zeros(start.size, dtype=np.int64)
    for column in text:
        value = column - ZERO  # wraps for lesser bytes, so one comparison finds the digits
        digit = value < 10
        mantissa = np.where(digit, mantissa * 10 + value, mantissa)
        digits += digit
        places += digit & (points > 0)
        points += column == POINT
        other += ~digit & (column != POINT) & (column != 0)
    sound = (other == sign) & (points <= 1) & (digits <= digits_allowed) & (size <= MAX_WIDTH)
    sound &= (digits > 0) | (size == 0)
    return mantissa, places, negative, digits, sound
