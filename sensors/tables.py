"""Delimited text as loggers and spreadsheets write it -> numeric columns with the line each row came from."""

from __future__ import annotations

import re
import stat
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray
from pyarrow import csv

from .raw import Floats, Ints, RawError, Rejected

Bools = NDArray[np.bool_]

MAX_BYTES = 2**30  # a day of a 100 Hz unit; more is a mistake, and would not fit in memory
MAX_ROWS = 10_000_000  # a day at 100 Hz
MAX_COLUMNS = 1000
MAX_BROKEN = 200_000  # rows of another length: more make it no table
HEADER_LINES = 60  # so far down a header may stand (after a logger's own preamble)
SEPARATORS = (",", ";", "\t", "|")
HEAD = 4096
BLOCK = 1 << 24
BLANK = b"\0 \t\r\n"
NULLS = ["", "nan", "NaN", "NAN", "null", "NULL", "NA", "N/A", "-", "none", "None"]


def read_bytes(path: Path) -> bytes:
    """A raw file's bytes.

    Raises RawError for what is no regular file or too large to be one pass.
    """
    try:
        info = path.stat()
        if not stat.S_ISREG(info.st_mode):
            raise RawError(f"{path.name}: is not a regular file")
        if info.st_size > MAX_BYTES:
            raise RawError(
                f"{path.name}: is {info.st_size / 2**30:.1f} GiB, over the limit of 1 GiB; split it"
            )
        data = path.read_bytes()
    except OSError as error:
        raise RawError(f"{path.name}: cannot be read: {error.strerror}") from None
    if not data[:BLOCK].strip(BLANK) and not data.strip(BLANK):
        raise RawError(f"{path.name}: is empty")
    return data


def read_head(path: Path) -> bytes:
    """The first bytes of a raw file, by which its format is told.

    Raises RawError for what is no regular file.
    """
    if not path.is_file():
        raise RawError(f"{path.name}: is not a regular file")
    with path.open("rb") as file:
        return file.read(HEAD)


def read_text(path: Path) -> bytes:
    """A text file as UTF-8; zero bytes at its end, as a power cut leaves them, are cut off."""
    text = as_utf8(read_bytes(path), path.name)
    return text.rstrip(b"\0") if text.endswith(b"\0") else text


def as_utf8(data: bytes, file: str) -> bytes:
    """Text with byte order mark or in UTF-16 as plain UTF-8."""
    for mark, codec in ((b"\xef\xbb\xbf", ""), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        if data.startswith(mark):
            body = data[len(mark) :]
            return body.decode(codec, "replace").encode() if codec else body
    if len(data) > 3 and data[1] == 0 and data[3] == 0 and data[0] != 0:
        return data.decode("utf-16-le", "replace").encode()
    if b"\0" in data[:4096].rstrip(b"\0"):
        raise RawError(f"{file}: holds zero bytes: it is not text; export it as CSV")
    return data


@dataclass(frozen=True)
class Header:
    """Names of the columns, the separator, the number of lines up to and with the header."""

    names: tuple[str, ...]
    separator: str
    lines: int


def _split(line: str, separator: str) -> tuple[str, ...]:
    return tuple(cell.strip().strip('"').strip() for cell in line.split(separator))


def find_header(text: bytes, file: str, wanted: Iterable[str] = ()) -> Header:
    """The first line that holds all `wanted` names; without one, the first that is neither empty nor `sep=`.

    The separator is what `sep=` says, else whichever splits the header into the most cells.
    """
    lines = text[:65536].decode("utf-8", "replace").splitlines()[:HEADER_LINES]
    stated = re.fullmatch(r'"?sep=(.)"?', lines[0].strip()) if lines else None
    separators = (stated.group(1),) if stated else SEPARATORS
    names = set(wanted)
    candidates = []
    for number, line in enumerate(lines, start=1):
        if not line.strip() or (stated and number == 1):
            continue
        separator = max(separators, key=line.count)
        candidates.append(Header(_split(line, separator), separator, number))
    if not candidates:
        raise RawError(f"{file}: has no header line")
    best = next((header for header in candidates if names and names <= set(header.names)), candidates[0])
    if len(best.names) > MAX_COLUMNS:
        raise RawError(
            f"{file}, row {best.lines}: {len(best.names)} columns; a log has at most {MAX_COLUMNS}"
        )
    return best


@dataclass(frozen=True)
class Table:
    """Columns of a delimited text.

    columns : by name, as numbers or (where something in them is no number) as text
    rows : (N,) line in the file of each row
    dropped : lines with a wrong number of cells, or cut off
    """

    file: str
    header: Header
    columns: Mapping[str, pa.ChunkedArray]
    rows: Ints
    dropped: tuple[Rejected, ...]

    def floats(self, name: str) -> Floats:
        """A column as numbers, NaN where a cell is empty or no number."""
        column = self.columns[name]
        if pa.types.is_string(column.type):
            return _coerced(column)
        return np.asarray(column.cast(pa.float64()).to_numpy(), dtype=np.float64)

    def integers(self, name: str) -> tuple[Ints, Bools]:
        """A column as 64-bit integers and where a cell held one; exact where every cell is an integer."""
        column = self.columns[name]
        if pa.types.is_string(column.type):
            return _whole(column)
        if pa.types.is_floating(column.type):
            return _rounded(self.floats(name))
        valid = np.asarray(column.is_valid().to_numpy(), dtype=np.bool_)
        filled = column.fill_null(0) if column.null_count else column
        return np.asarray(filled.to_numpy(), dtype=np.int64), valid

    def is_whole(self, name: str) -> bool:
        """Whether (nearly) all cells of a column are integers, none written with a decimal point."""
        column = self.columns[name]
        if pa.types.is_integer(column.type):
            return True
        return bool(pa.types.is_string(column.type) and _mostly(_integer_cells(column)))

    @cached_property
    def size(self) -> int:
        """Number of rows."""
        return int(self.rows.size)


def _coerced(column: pa.ChunkedArray) -> Floats:
    import pandas as pd  # half a second to import, and few files need it

    text = pd.Series(column.to_numpy(zero_copy_only=False), dtype=object)
    return np.asarray(pd.to_numeric(text, errors="coerce"), dtype=np.float64)


def _mostly(flags: Bools) -> bool:
    return bool(2 * np.count_nonzero(flags) > flags.size)


def _integer_cells(column: pa.ChunkedArray) -> Bools:
    match = pc.match_substring_regex(column, r"^\s*[+-]?[0-9]{1,18}\s*$|^\s*[+-]?[0-8][0-9]{18}\s*$")
    return np.asarray(match.fill_null(False).to_numpy(), dtype=np.bool_)


def _whole(column: pa.ChunkedArray) -> tuple[Ints, Bools]:
    cells = _integer_cells(column)
    if not _mostly(cells):
        return _rounded(_coerced(column))
    whole = np.zeros(cells.size, dtype=np.int64)
    digits = pc.utf8_ltrim(pc.utf8_trim_whitespace(column.filter(pa.array(cells))), characters="+")
    whole[cells] = digits.cast(pa.int64()).to_numpy()
    return whole, cells


def _rounded(values: Floats) -> tuple[Ints, Bools]:
    valid = np.isfinite(values) & (np.abs(values) < 9.0e18)
    return np.rint(np.where(valid, values, 0.0)).astype(np.int64), valid


def parse_table(data: bytes, header: Header, file: str, kinds: Mapping[str, str] | None = None) -> Table:
    """The table below a header.

    kinds : columns to read, "int" or "float" (a hint; what does not fit is kept as text); None: all, as text

    Raises RawError : there is none.
    """
    if data.count(b"\n") > MAX_ROWS:
        raise RawError(f"{file}: has more than {MAX_ROWS} rows; split it")
    body, cut = _body(data, header, file)
    names = _columns(header, body, file)
    header = Header(names, header.separator, header.lines)
    body = _plain(body, header.separator)
    types = {name: pa.int64() if kind == "int" else pa.float64() for name, kind in (kinds or {}).items()}
    try:
        table, dropped = (
            _parse(body, header, types, strict=True) if kinds else _parse(body, header, {}, False)
        )
    except pa.ArrowException:
        table, dropped = _lenient(body, header, list(types), file)
    rows = _line_numbers(table.num_rows, header.lines, dropped)
    columns = {name: table.column(name) for name in table.column_names}
    return Table(file, header, columns, rows, tuple(dropped + cut))


def _lenient(body: bytes, header: Header, names: list[str], file: str) -> tuple[pa.Table, list[Rejected]]:
    text = body.decode("utf-8", "replace").encode()
    try:
        return _parse(text, header, dict.fromkeys(names, pa.string()), strict=False)
    except pa.ArrowException as error:
        reason = str(error).splitlines()[0][:120]
        raise RawError(f"{file}: cannot be read as a table ({reason}); export it again as CSV") from None


def _body(data: bytes, header: Header, file: str) -> tuple[bytes, list[Rejected]]:
    """What follows the header; a last line without line end stands apart: it may be cut off anywhere."""
    start = 0
    for _ in range(header.lines):
        end = data.find(b"\n", start)
        if end < 0:
            raise RawError(f"{file}: has a header but no rows")
        start = end + 1
    body = data[start:]
    if not body[:BLOCK].strip() and not body.strip():
        raise RawError(f"{file}: has a header but no rows")
    if body.endswith((b"\n\n", b"\n\r\n")):
        return body.rstrip(b"\r\n") + b"\n", []
    if body.endswith((b"\n", b"\r")):
        return body, []
    last = body.rfind(b"\n") + 1
    if last == 0:
        raise RawError(f"{file}: its only row is cut off")
    number = header.lines + 1 + body.count(b"\n")
    tail = body[last : last + 80].decode("utf-8", "replace")
    return body[:last], [Rejected(number, "cut off: no line end", tail)]


def _columns(header: Header, body: bytes, file: str) -> tuple[str, ...]:
    """The header's names, one more or less where rows or header end in a separator."""
    names = list(header.names)
    first = body[: body.find(b"\n")].rstrip(b"\r")
    cells = first.count(header.separator.encode()) + 1
    if cells == len(names) + 1 and first.rstrip().endswith(header.separator.encode()):
        names.append("")
    while names and not names[-1] and cells < len(names):
        names.pop()
    named = [name or f" unnamed {k}" for k, name in enumerate(names)]
    doubled = {name for name in named if named.count(name) > 1}
    if doubled:
        raise RawError(f"{file}, row {header.lines}: two columns are called '{min(doubled)}'; rename one")
    return tuple(named)


def _plain(body: bytes, separator: str) -> bytes:
    """No quotes; decimal points for decimal commas (which only other separators allow, or quotes)."""
    if b'"' in body:
        body = re.sub(rb'"([+-]?[0-9]+),([0-9eE+-]+)"', rb"\1.\2", body).replace(b'"', b"")
    if separator != "," and b"," in body:
        body = body.replace(b",", b".")
    return body


def _parse(
    body: bytes, header: Header, types: Mapping[str, pa.DataType], strict: bool
) -> tuple[pa.Table, list[Rejected]]:
    dropped: list[Rejected] = []

    def note(row: csv.InvalidRow) -> str:
        reason = f"with {row.actual_columns} cells instead of {row.expected_columns}"
        dropped.append(Rejected(row.number + header.lines, reason, row.text[:80]))
        return "skip" if len(dropped) < MAX_BROKEN else "error"

    names = list(types) or list(header.names)
    table = csv.read_csv(
        pa.BufferReader(body),
        read_options=csv.ReadOptions(column_names=list(header.names), block_size=BLOCK, use_threads=strict),
        parse_options=csv.ParseOptions(
            delimiter=header.separator,
            quote_char=False,
            ignore_empty_lines=False,
            invalid_row_handler=None if strict else note,
        ),
        convert_options=csv.ConvertOptions(
            include_columns=names,
            column_types=dict(types) or dict.fromkeys(names, pa.string()),
            null_values=NULLS,
            strings_can_be_null=False,
            check_utf8=False,
        ),
    )
    return table, dropped


def _line_numbers(count: int, header_lines: int, dropped: list[Rejected]) -> Ints:
    """Line of each row kept, when the dropped ones stood between them."""
    if not dropped:
        return np.arange(header_lines + 1, header_lines + 1 + count, dtype=np.int64)
    lines = np.arange(header_lines + 1, header_lines + 1 + count + len(dropped), dtype=np.int64)
    return np.setdiff1d(lines, np.array([line.row for line in dropped], dtype=np.int64), assume_unique=True)
