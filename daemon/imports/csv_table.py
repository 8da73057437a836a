"""Numbers from a csv file, row by row: delimiter detected, cells checked, memory bounded.

Rows are numbered as an editor numbers lines. An empty cell, or NaN in any spelling, is no value.
"""

import csv
import difflib
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, NoReturn, TextIO

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.progress import Advance
from steerd.daemon.imports.import_map import ColumnSpec

LINE_MAX = 1 << 20
"""No row is longer than this [characters]."""
_DELIMITERS = ",;\t| "
_NO_VALUE = frozenset(("", "nan", "+nan", "-nan", "na", "n/a", "null", "none"))
_ADVANCE_ROWS = 1000
"""Rows between two reports of progress."""
_SHOWN = 12
"""Column names that an error lists."""


class CsvRow(NamedTuple):
    """The quantities that have a value in one line of the file."""

    number: int
    values: dict[str, float]


class Cell(NamedTuple):
    """Column index of a quantity, its scaling, and the column index of its gate."""

    quantity: str
    column: int
    spec: ColumnSpec
    gate: int | None


def open_table(source: Path) -> TextIO:
    """Open a csv file as text.

    Raises:
        SteerdError: it is no regular file, is empty, or cannot be opened.
    """
    try:
        if not source.is_file():
            what = "is not a file" if source.exists() else "does not exist"
            raise SteerdError(f"{source} {what}", "name a csv file", ExitCode.UNREADABLE)
        if not source.stat().st_size:
            raise SteerdError(f"{source} is empty", "", ExitCode.UNREADABLE)
        return source.open(encoding="utf-8-sig", newline="")
    except OSError as error:
        what = f"{source} cannot be read: {error.strerror}"
        raise SteerdError(what, "", ExitCode.UNREADABLE) from error


def read_header(name: str, file: TextIO) -> tuple[str, list[str]]:
    """The delimiter and the columns' names of an open table; the rows come next in the file.

    Raises:
        SteerdError: it holds no line.
    """
    return _split_header(_first_line(name, _lines(name, file))[1], set())


def read_table(
    name: str, file: TextIO, columns: Mapping[str, ColumnSpec], advance: Advance
) -> Iterator[CsvRow]:
    """Read the rows of an open table.

    Args:
        name: the file's name, for messages.
        file: the file, at its start.
        columns: quantity to column.
        advance: called with the bytes read so far.

    Yields:
        Rows that hold any value; scaled.

    Raises:
        SteerdError: a column is missing or a cell is no number; the message says which.
    """
    lines = _lines(name, file)
    before, line = _first_line(name, lines)
    delimiter, header = _split_header(line, {spec.column for spec in columns.values()})
    cells = tuple(_find(name, header, q, spec) for q, spec in columns.items())
    reader = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    try:
        for texts in reader:
            number = before + reader.line_num
            if number % _ADVANCE_ROWS == 0:
                advance(file.buffer.tell())
            if len(texts) > len(header) and any(text.strip() for text in texts[len(header) :]):
                _fail(name, number, f"{len(texts)} cells under {len(header)} column names")
            found = ((c.quantity, _value(name, number, c, texts, delimiter)) for c in cells)
            values = {quantity: value for quantity, value in found if value is not None}
            if values:
                yield CsvRow(number, values)
    except csv.Error as error:
        _fail(name, before + reader.line_num, str(error))


def fail_cell(name: str, row: int, column: str, what: str, hint: str = "") -> NoReturn:
    """Refuse one cell.

    Raises:
        SteerdError: always.
    """
    raise SteerdError(f"{name} row {row}, column {column!r}: {what}", hint)


def _fail(name: str, row: int, what: str, hint: str = "") -> NoReturn:
    raise SteerdError(f"{name} row {row}: {what}", hint)


def _lines(name: str, file: TextIO) -> Iterator[str]:
    """Lines of bounded length, also of a file without line ends."""
    number = 0
    try:
        while line := file.readline(LINE_MAX):
            number += 1
            if len(line) == LINE_MAX:
                _fail(name, number, f"more than {LINE_MAX} characters", "is it a text table?")
            yield line
    except UnicodeDecodeError as error:
        what = f"{name} is no UTF-8 text (behind row {number}, byte {error.object[error.start]:#x})"
        raise SteerdError(what, "save it as UTF-8 csv", ExitCode.UNREADABLE) from error
    except OSError as error:
        what = f"{name} cannot be read: {error.strerror}"
        raise SteerdError(what, "", ExitCode.UNREADABLE) from error


def _first_line(name: str, lines: Iterator[str]) -> tuple[int, str]:
    for number, line in enumerate(lines, 1):
        if line.strip():
            return number, line
    raise SteerdError(f"{name} holds only blank lines", "", ExitCode.UNREADABLE)


def _split_header(line: str, wanted: set[str]) -> tuple[str, list[str]]:
    """Take the delimiter that gives most of the wanted names, then the most names."""
    line = line.strip().removeprefix("#").strip()
    splits = {d: _split(line, d) for d in _DELIMITERS}
    best = max(_DELIMITERS, key=lambda d: (len(wanted & set(splits[d])), len(splits[d])))
    return best, splits[best]


def _split(line: str, delimiter: str) -> list[str]:
    try:
        row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        return []
    return [cell.strip() for cell in row]


def _find(name: str, header: list[str], quantity: str, spec: ColumnSpec) -> Cell:
    gate = None if spec.gate is None else _index(name, header, quantity, spec.gate)
    return Cell(quantity, _index(name, header, quantity, spec.column), spec, gate)


def _index(name: str, header: list[str], quantity: str, column: str) -> int:
    found = [i for i, cell in enumerate(header) if cell == column]
    if len(found) == 1:
        return found[0]
    if found:
        what = f"{name} has {len(found)} columns named {column!r}"
        raise SteerdError(what, "give each column its own name")
    near = difflib.get_close_matches(column.lower(), [h.lower() for h in header], 3, 0.4)
    names = [h for h in header if h.lower() in near] or header[:_SHOWN]
    what = f"{name} has no column {column[:80]!r}, which the map names for {quantity}"
    raise SteerdError(what, f"in the map, {' or '.join(repr(n[:40]) for n in names)}")


def _value(name: str, row: int, cell: Cell, texts: list[str], delimiter: str) -> float | None:
    number = _number(name, row, cell.spec.column, texts, cell.column, delimiter)
    if number is None:
        return None
    if cell.gate is not None:
        gate = _number(name, row, cell.spec.gate or "", texts, cell.gate, delimiter)
        if gate is None or gate == 0.0:
            return 0.0
    value = cell.spec.scale * number + cell.spec.offset
    if not math.isfinite(value):
        fail_cell(name, row, cell.spec.column, f"{number:g} times {cell.spec.scale:g} overflows")
    return value


def _number(
    name: str, row: int, column: str, texts: list[str], index: int, delimiter: str
) -> float | None:
    text = texts[index].strip() if index < len(texts) else ""
    if text.lower() in _NO_VALUE:
        return None
    if delimiter == ";" and "." not in text:
        text = text.replace(",", ".")
    try:
        number = float(text) if "_" not in text else math.inf
    except ValueError:
        number = math.inf
    if math.isfinite(number):
        return number
    what = f"{text[:40]!r} is not a number"
    fail_cell(name, row, column, what, "leave a cell empty where there is no sample")
