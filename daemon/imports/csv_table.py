"""Numbers from a csv file, row by row: delimiter detected, cells checked, memory bounded.

Rows are numbered as an editor numbers lines. An empty cell, or NaN in any spelling, is no value.
"""

import csv
import difflib
import math
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple, NoReturn, TextIO

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.progress import Advance
from steerd.daemon.imports.import_map import ColumnSpec

LINE_MAX = 1 << 20  # no row is longer than this [characters]
_DELIMITERS = ",;\t| "
_NO_VALUE = frozenset(("", "nan", "+nan", "-nan", "na", "n/a", "null", "none"))
_ADVANCE_ROWS = 1000  # rows between two reports of progress
_SHOWN = 12  # column names that an error lists


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


class CsvTable:
    """An open csv file: its header was read, its rows come next.

    Args:
        name: the file's name, for messages.
        file: the file, at its start.
        wanted: column names that the header should hold.

    Attributes:
        name: the file's name.
        header: the columns' names.
        row: number of the line that was read last.

    Raises:
        SteerdError: it holds no line.
    """

    def __init__(self, name: str, file: TextIO, wanted: Collection[str] = ()) -> None:
        self.name, self.row, self._file = name, 0, file
        self._lines = self._read_lines()
        first = next((line for line in self._lines if line.strip()), None)
        if first is None:
            raise SteerdError(f"{name} holds only blank lines", "", ExitCode.UNREADABLE)
        self._delimiter, self.header = _split_header(first, set(wanted))

    def texts(self) -> Iterator[list[str]]:
        """The cells of each row."""
        try:
            yield from csv.reader(self._lines, delimiter=self._delimiter, skipinitialspace=True)
        except csv.Error as error:
            self.fail(str(error))

    def rows(
        self, columns: Mapping[str, ColumnSpec], advance: Advance
    ) -> Iterator[dict[str, float]]:
        """The quantities that have a value in a row, of rows that hold any; scaled.

        Args:
            columns: quantity to column.
            advance: called with the bytes read so far.

        Raises:
            SteerdError: a column is missing or a cell is no number; the message says which.
        """
        cells = [self._find(quantity, spec) for quantity, spec in columns.items()]
        for texts in self.texts():
            if self.row % _ADVANCE_ROWS == 0:
                advance(self._file.buffer.tell())
            if any(text.strip() for text in texts[len(self.header) :]):
                self.fail(f"{len(texts)} cells under {len(self.header)} column names")
            found = ((cell.quantity, self._value(cell, texts)) for cell in cells)
            if values := {quantity: value for quantity, value in found if value is not None}:
                yield values

    def number(self, texts: list[str], column: int) -> float | None:
        """The number in a cell; None where it holds none.

        Raises:
            SteerdError: it holds something else.
        """
        text = texts[column].strip() if column < len(texts) else ""
        if text.lower() in _NO_VALUE:
            return None
        if self._delimiter == ";" and "." not in text:
            text = text.replace(",", ".")
        try:
            number = float(text) if "_" not in text else math.inf
        except ValueError:
            number = math.inf
        if not math.isfinite(number):
            hint = "leave a cell empty where there is no sample"
            self.fail(f"{text[:40]!r} is not a number", hint, self.header[column])
        return number

    def fail(self, what: str, hint: str = "", column: str = "") -> NoReturn:
        """Refuse the row that was read last, or its cell in a column.

        Raises:
            SteerdError: always.
        """
        at = f", column {column!r}" if column else ""
        raise SteerdError(f"{self.name} row {self.row}{at}: {what}", hint)

    def _read_lines(self) -> Iterator[str]:
        """Lines of bounded length, also of a file without line ends."""
        try:
            while line := self._file.readline(LINE_MAX):
                self.row += 1
                if len(line) == LINE_MAX:
                    self.fail(f"more than {LINE_MAX} characters", "is it a text table?")
                yield line
        except UnicodeDecodeError as error:
            where = f"behind row {self.row}, byte {error.object[error.start]:#x}"
            what, hint = f"{self.name} is no UTF-8 text ({where})", "save it as UTF-8 csv"
            raise SteerdError(what, hint, ExitCode.UNREADABLE) from error
        except OSError as error:
            what = f"{self.name} cannot be read: {error.strerror}"
            raise SteerdError(what, "", ExitCode.UNREADABLE) from error

    def _find(self, quantity: str, spec: ColumnSpec) -> Cell:
        gate = None if spec.gate is None else self._index(quantity, spec.gate)
        return Cell(quantity, self._index(quantity, spec.column), spec, gate)

    def _index(self, quantity: str, column: str) -> int:
        count = self.header.count(column)
        if count == 1:
            return self.header.index(column)
        if count:
            what = f"{self.name} has {count} columns named {column!r}"
            raise SteerdError(what, "give each column its own name")
        near = difflib.get_close_matches(column.lower(), [h.lower() for h in self.header], 3, 0.4)
        names = [h for h in self.header if h.lower() in near] or self.header[:_SHOWN]
        what = f"{self.name} has no column {column[:80]!r}, which the map names for {quantity}"
        raise SteerdError(what, f"in the map, {' or '.join(repr(n[:40]) for n in names)}")

    def _value(self, cell: Cell, texts: list[str]) -> float | None:
        number, spec = self.number(texts, cell.column), cell.spec
        if number is None:
            return None
        if cell.gate is not None and not self.number(texts, cell.gate):
            return 0.0
        value = spec.scale * number + spec.offset
        if not math.isfinite(value):
            self.fail(f"{number:g} times {spec.scale:g} overflows", column=spec.column)
        return value


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
