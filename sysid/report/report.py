"""What a command found, as one value; pages and screens are made of it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from math import degrees, floor, isfinite, log10
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from steerd.sysid.report.drawing import Diagrams

Tone = Literal["", "quiet", "strong"]
DEGREES = degrees(1.0)
SCALES = {"m": (1e3, "mm"), "s": (1e3, "ms"), "rad": (DEGREES, "°"), "1": (1.0, "")}
"""Unit that people read, by the SI unit: factor and name; what is not listed stays in SI."""
PLACES = 8  # digits after the point that are still read; smaller numbers get an exponent


class Cell(NamedTuple):
    """Text of a table that stands out, or does not, and the page that it leads to, if any."""

    text: str
    tone: Tone = ""
    link: str = ""


@dataclass(frozen=True)
class Table:
    """A table of figures; its first column names the rows."""

    heads: Sequence[str]  # a name for each column
    rows: Sequence[Sequence[str | Cell]]  # cells in the columns' order
    words: Sequence[int] = ()  # numbers of the columns that hold sentences, which may be broken

    @property
    def cells(self) -> list[list[Cell]]:
        """The rows, every cell with its tone."""
        return [[c if isinstance(c, Cell) else Cell(c) for c in row] for row in self.rows]

    def pick(self, *heads: str) -> "Table":
        """The same rows with these columns alone."""
        at = [self.heads.index(head) for head in heads]
        words = [place for place, i in enumerate(at) if i in self.words]
        return Table(heads, [[row[i] for i in at] for row in self.rows], words)


class Card(NamedTuple):
    """A figure that is read first: what it is, its value, a few words about it."""

    label: str
    figure: str
    text: str


class Fold(NamedTuple):
    """Text below a headline, shown when asked for."""

    headline: str
    text: str


@dataclass(frozen=True)
class Section:
    """A headed part; what is empty is left out."""

    title: str = ""  # its heading
    text: str = ""  # a paragraph about it; `steerd …` in backquotes is shown as a command
    notes: Sequence[str] = ()  # what a reader should know, each set off
    table: Table | None = None  # figures
    figures: Sequence["Diagrams"] = ()  # drawn where they are shown
    fold: Fold | None = None  # what few will read


class Line(NamedTuple):
    """A paragraph of a terminal's screen."""

    label: str  # what it is; empty where it goes on with what is above it
    text: str
    whole: bool = False  # whether its line is never broken: a command to copy, columns


SPACE = Line("", "")


@dataclass(frozen=True)
class Report:
    """A report, results first; sections and figures may be made while they are read, once."""

    title: str  # what it answers
    sections: Iterable[Section]  # in reading order
    foot: str  # who wrote it, conventions
    subject: str = ""  # names of what it is about: sessions, a car
    about: str = ""  # facts about that
    lead: str = ""  # the result in a sentence or two
    verdict: str = ""  # the result in a word; empty where there is none
    grade: str = ""  # how good that is: `good`, `fair` or `bad`
    cards: Sequence[Card] = ()  # figures that are read first
    screen: Sequence[Line] = ()  # what a terminal shows
    figures: Iterable["Diagrams"] = ()  # what a notebook's figure shows


def format_table(table: Table) -> Iterator[str]:
    """Lines for a terminal: names to the left, figures to the right of their columns."""
    rows = [[*table.heads], *([cell.text for cell in row] for row in table.cells)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for row in rows:
        cells = [
            f"{text:<{width}}" if i == 0 or i in table.words else f"{text:>{width}}"
            for i, (text, width) in enumerate(zip(row, widths, strict=True))
        ]
        yield "  ".join(cells).rstrip()


def with_error(value: float, sd: float | None, sign: str = "") -> str:
    """A value and its standard error to two digits of the latter; `?` where that is not known."""
    if not sd or not isfinite(sd):
        return f"{value:{sign}.5g} ± ?"
    places = 1 - floor(log10(sd))
    if places > PLACES:
        return f"{value:{sign}.3g} ± {sd:.2g}"
    digits = max(places, 0)
    return f"{round(value, places):{sign}.{digits}f} ± {round(sd, places):.{digits}f}"


def finite(value: Any) -> Any:
    """A value as JSON holds it: a number that is not finite is null, a dataclass an object."""
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    elif hasattr(value, "item"):  # a number of NumPy's
        value = value.item()
    match value:
        case float():
            return value if isfinite(value) else None
        case dict():
            return {key: finite(each) for key, each in value.items()}
        case list() | tuple():
            return [finite(each) for each in value]
    return value
