"""A csv file as a session: which cells make which message, and at which time.

Streams of different rates share a file: a row gives a sample of each stream that has a value in it.
Rows are numbered as an editor numbers lines. An empty cell, or NaN in any spelling, is no value.
"""

import csv
import difflib
import itertools
import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn, TextIO

from steerd.daemon.common.errors import ExitCode, SteerdError, refusing
from steerd.daemon.common.packaged import EXAMPLE_MAP
from steerd.daemon.common.screen import Advance
from steerd.daemon.imports.import_map import NS, ColumnSpec, ImportMap
from steerd.daemon.imports.import_session import ImportReport, MessageMaker, Sample, write_import
from steerd.steer_bus.topics import ACTUATION, IMU, MOCAP, THROTTLE, VESC, WHEEL, Topic

LINE_MAX = 1 << 20  # no row is longer than this [characters]
_DELIMITERS = ",;\t| "
_NO_VALUE = frozenset(("", "nan", "+nan", "-nan", "na", "n/a", "null", "none"))
_ADVANCE_ROWS = 1000  # rows between two reports of progress
_SHOWN = 12  # column names that an error lists


def open_table(source: Path) -> TextIO:
    """Open a csv file as text; a SteerdError where it is no file, empty or unreadable."""
    with refusing(f"{source} cannot be read: "):
        if not source.is_file():
            raise SteerdError(f"{source} is not a file", "name a csv file", ExitCode.UNREADABLE)
        if not source.stat().st_size:
            raise SteerdError(f"{source} is empty", "", ExitCode.UNREADABLE)
        return source.open(encoding="utf-8-sig", newline="")


class CsvTable:
    """An open csv file: its `header` was read, its rows come next; `row` numbers the last line.

    Of several delimiters that one is taken which gives most of the `wanted` column names.

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

        `advance` is called with the bytes read so far.

        Raises:
            SteerdError: a column is missing or a cell is no number; the message says which.
        """
        wanted = [(q, name) for q, spec in columns.items() for name in (spec.column, spec.gate)]
        places = {name: self._index(q, name) for q, name in wanted if name is not None}
        for texts in self.texts():
            if self.row % _ADVANCE_ROWS == 0:
                advance(self._file.buffer.tell())
            if any(text.strip() for text in texts[len(self.header) :]):
                self.fail(f"{len(texts)} cells under {len(self.header)} column names")
            found = ((q, self._value(spec, places, texts)) for q, spec in columns.items())
            if values := {quantity: value for quantity, value in found if value is not None}:
                yield values

    def number(self, texts: list[str], column: int) -> float | None:
        """The number in a cell, None where it is empty; a SteerdError for something else."""
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
        """Refuse the row that was read last, or its cell in a column."""
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

    def _value(self, spec: ColumnSpec, places: Mapping[str, int], texts: list[str]) -> float | None:
        number = self.number(texts, places[spec.column])
        if number is None:
            return None
        if spec.gate is not None and not self.number(texts, places[spec.gate]):
            return 0.0
        value = spec.scale * number + spec.offset
        if not math.isfinite(value):
            self.fail(f"{number:g} times {spec.scale:g} overflows", column=spec.column)
        return value


def _split_header(line: str, wanted: set[str]) -> tuple[str, list[str]]:
    """Take the delimiter that gives most of the wanted names, then the most names."""
    line = line.strip().removeprefix("#").strip()
    splits: dict[str, list[str]] = {delimiter: [] for delimiter in _DELIMITERS}
    for delimiter in _DELIMITERS:
        with suppress(csv.Error):
            row = next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
            splits[delimiter] = [cell.strip() for cell in row]
    best = max(splits, key=lambda d: (len(wanted & {*splits[d]}), len(splits[d])))
    return best, splits[best]


# -- messages from rows ------------------------------------------------------------------------

_STREAMS: tuple[tuple[Topic, Callable[..., Any], tuple[str, ...]], ...] = (
    (MOCAP, MessageMaker.planar_pose, ("x", "y", "yaw")),
    (ACTUATION, MessageMaker.command, ("steer_cmd", "speed_cmd")),
    (VESC, MessageMaker.telemetry, ("erpm",)),
    (WHEEL, MessageMaker.wheel, ("wheel_speed",)),
    (THROTTLE, MessageMaker.throttle, ("throttle",)),
    (IMU, MessageMaker.gyro, ("yaw_rate",)),
)
"""Topics, what makes their messages, and of which quantities."""
_TOPICS = {quantity: topic for topic, _, quantities in _STREAMS for quantity in quantities}
_Timed = tuple[int, dict[str, float]]  # time of a row [ns], and the quantities that have a value
_INT32_MAX = (1 << 31) - 1  # largest UNIX time [s] and largest ERPM of a message


def import_csv(source: Path, the_map: ImportMap, out: Path, advance: Advance) -> ImportReport:
    """Turn a csv file into a session; nothing is left of that after an error.

    `advance` is called with the bytes read so far.

    Raises:
        SteerdError: something is wrong with the map, the file or the output; it says where.
    """
    if not the_map.columns:
        hint = f"copy {EXAMPLE_MAP} and name your columns"
        raise SteerdError(f"{the_map.name} has no [columns]", hint)
    notes: Counter[str] = Counter()
    topics = list(dict.fromkeys(_TOPICS[q] for q in the_map.columns if q in _TOPICS))
    with open_table(source) as file:
        table = CsvTable(source.name, file, {spec.column for spec in the_map.columns.values()})
        timed = _add_times(table, the_map, notes, advance)
        if first := next(timed, None):  # a session's stamps are not negative: no time before 1970
            the_map = replace(the_map, epoch_ns=max(the_map.epoch_ns, -first[0]))
            timed = itertools.chain([first], timed)
        samples = _samples(table, timed, the_map, notes)
        return write_import(out, source, the_map, topics, samples, notes)


def _add_times(
    table: CsvTable, the_map: ImportMap, notes: Counter[str], advance: Advance
) -> Iterator[_Timed]:
    """Rows with their times [ns], which never go back."""
    column = the_map.columns["t"].column
    last_ns, last_row = None, 0
    for values in table.rows(the_map.columns, advance):
        if "t" not in values:
            table.fail("no time, but other values", column=column)
        t = values["t"]
        if abs(t + the_map.epoch_ns / NS) > _INT32_MAX:
            hint = "scale = 0.001 in the map for milliseconds, 1e-9 for nanoseconds"
            table.fail(f"{t:g} s is no time", hint, column)
        whole = math.floor(t)  # separately, so that UNIX seconds lose no digit
        t_ns = whole * NS + round((t - whole) * NS)
        if last_ns is not None and t_ns < last_ns:
            what = f"time goes back by {(last_ns - t_ns) / NS:g} s after row {last_row}"
            table.fail(what, "sort the rows, or import each run by itself", column)
        if t_ns == last_ns:
            notes["rows repeat the time of the row before"] += 1
        last_ns, last_row = t_ns, table.row
        yield t_ns, values


def _samples(
    table: CsvTable, timed: Iterator[_Timed], the_map: ImportMap, notes: Counter[str]
) -> Iterator[Sample]:
    maker, pose = MessageMaker(the_map.epoch_ns, the_map.frame), _STREAMS[0][2]
    for t_ns, v in timed:
        if 0 < len(v.keys() & pose) < len(pose):
            notes["rows hold a part of a pose and were left out of it"] += 1
            v = {name: value for name, value in v.items() if name not in pose}
        if abs(v.get("erpm", 0.0)) > _INT32_MAX:
            column = the_map.columns["erpm"].column
            table.fail(f"{v['erpm']:g} is no motor speed", column=column)
        for topic, make, quantities in _STREAMS:
            if any(name in v for name in quantities):
                given = (v.get(name, math.nan) for name in quantities)
                yield Sample(topic, t_ns, t_ns, make(maker, t_ns, *given))
