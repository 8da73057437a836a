"""Lines for a terminal: broken between words, never inside one, and free of control characters."""

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from html import escape
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TextIO, TypeVar

if TYPE_CHECKING:
    from steerd.sysid.report.report import Line

WIDTH = 80  # columns of the narrowest terminal that reports are made for
NBSP = "\u00a0"  # joins what must stand on one line, a figure and its unit; shown as a space
_COMMAND = re.compile("`steerd [^`]*`")
T = TypeVar("T")
TEXT_MAX = 200  # text from a file is cut after so many characters


def clean(text: str, length: int = TEXT_MAX) -> str:
    """Text from a file, safe for a terminal: no control characters, not too long."""
    shown = "".join(c if c.isprintable() else "?" for c in text[:length])
    return shown + ("…" if len(text) > length else "")


def cut(text: str, width: int) -> str:
    """At most so many columns of a text, the last of them a mark where something is left out."""
    return text if len(text) <= width else f"{text[: width - 1]}…"


def show(value: float, form: str) -> str:
    """A number in a format, or a dash of that width where it is not known (NaN, infinite)."""
    if isfinite(value):
        return format(value, form)
    return format("–", f">{len(format(0.0, form))}")


def wrap(text: str, first: str = "", rest: str = "", width: int = WIDTH) -> list[str]:
    """Lines of at most `width` columns of a paragraph; a longer word has a line of its own.

    No line breaks at `NBSP`, nor within a command, which is to be copied. The first line begins
    with `first`, the others with `rest`.
    """
    lines = textwrap.wrap(
        _COMMAND.sub(lambda found: join_words(found[0]), text),
        width,
        initial_indent=first,
        subsequent_indent=rest,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return [line.replace(NBSP, " ") for line in lines]


def wrap_command(command: str, first: str = "", rest: str = "", width: int = WIDTH) -> list[str]:
    """A command line to copy: broken before options, with the shell's continuation; see `wrap`."""
    lines: list[str] = []
    line = ""
    for part in re.split(r" (?=-)", command):
        head = rest if lines else first
        if line and len(head) + len(line) + 1 + len(part) + 2 > width:
            lines.append(f"{head}{line} \\")
            line = part
        else:
            line = f"{line} {part}" if line else part
    return [*lines, f"{rest if lines else first}{line}"]


def below_home(path: Path) -> str:
    """A path as a shell takes it, from `~` on where it lies below the user's own folder."""
    home = Path.home()
    return f"~/{path.relative_to(home)}" if path.is_relative_to(home) else str(path)


def join_words(text: str) -> str:
    """The text with spaces at which no line breaks."""
    return text.replace(" ", NBSP)


def print_labelled(label: str, text: str, file: TextIO) -> None:
    """Print a label and a text; only a terminal gets broken lines, indented by the label's width.

    The text is paragraphs, one per line; an indented one is to be copied and stays as it is.
    """
    if not file.isatty():
        print(label + text, file=file)
        return
    width = shutil.get_terminal_size((WIDTH, 24)).columns
    indent = " " * len(label)
    for i, paragraph in enumerate(text.splitlines() or [""]):
        if paragraph.startswith(" "):
            print(paragraph, file=file)
        else:
            print("\n".join(wrap(paragraph, indent if i else label, indent, width)), file=file)


WARNINGS_SHOWN = 10


def print_warnings(texts: Sequence[str]) -> None:
    """Print warnings about a session's file on standard error; the command goes on."""
    for text in texts[:WARNINGS_SHOWN]:
        print_labelled("warning: ", clean(text), sys.stderr)
    if len(texts) > WARNINGS_SHOWN:
        print(f"warning: and {len(texts) - WARNINGS_SHOWN} more", file=sys.stderr)


_CONTROLS = dict.fromkeys(
    {*range(32), *range(127, 160), *range(0x202A, 0x202F), *range(0x2066, 0x206A)} - {9, 10}, "?"
)
"""Control characters but for tab and line end, and those that turn the direction of reading."""


def remove_controls(text: str) -> str:
    """Text that no terminal obeys: each control character is a question mark."""
    return text.translate(_CONTROLS)


class PlainStream:
    """A stream whose text passes `remove_controls`; `raw` is for what draws there itself."""

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw  # the stream behind it

    def write(self, text: str) -> int:
        """Write what a terminal may show."""
        return self.raw.write(remove_controls(text))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.raw, name)


def raw(stream: TextIO) -> TextIO:
    """The stream for a program's own escape sequences."""
    return stream.raw if isinstance(stream, PlainStream) else stream


def prepare_streams() -> None:
    """Give the process three streams, whatever it was started with.

    A closed one is the null device: the next file that is opened would take its number. What a
    locale cannot write is a question mark.
    """
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:  # the lowest that is free
        os.set_inheritable(fd, True)
    os.close(fd)
    sys.stdin = sys.stdin or os.fdopen(0, encoding="utf-8", closefd=False)
    for name, number in (("stdout", 1), ("stderr", 2)):
        stream = getattr(sys, name) or os.fdopen(number, "w", encoding="utf-8", closefd=False)
        stream.reconfigure(errors="replace")
        setattr(sys, name, PlainStream(stream))


MARGIN = 12  # columns of a label
_ROWS = 3  # of a paragraph where the screen is short


def format_screen(lines: "Iterable[Line]", most: int = 0) -> str:
    """A report on a terminal of `most` lines, 0 for as many as there are.

    What matters least is left out where it would not fit: notes, and what a paragraph says beyond
    its third line.
    """
    found = [(line, _lay_out(line, most > 0)) for line in lines]
    room = most - sum(len(rows) for line, rows in found if line.label != "note")
    shown: list[str] = []
    for line, rows in found:
        if most and line.label == "note":
            rows, room = rows[: max(room, 0)], room - len(rows)
        shown += rows
    if most:
        del shown[most - 1 : -1]
    return "\n".join(shown)


def _lay_out(line: "Line", short: bool) -> list[str]:
    label = f"{line.label:<{MARGIN}}"
    if line.whole or not line.text:
        return [f"{label}{line.text}".rstrip()]
    rows = wrap(line.text, label, " " * MARGIN)
    if not short or len(rows) <= _ROWS:
        return rows
    return [*rows[: _ROWS - 1], f"{rows[_ROWS - 1][: WIDTH - 2]} …"]


def shown(cls: type[T]) -> type[T]:
    """A class whose `str` is its screen: `repr` is its verdict or its first line.

    In a notebook its `cards`, if it has any, stand above the screen, which then is folded.
    """

    def line(self: T) -> str:
        lines = str(self).strip().splitlines()
        first = next((text for text in lines if text.startswith("verdict ")), lines[0])
        return f"<steerd.{cls.__name__}: {' '.join(first.split())}>"

    def page(self: T) -> str:
        screen = f"<pre>{escape(str(self))}</pre>"
        cards = "".join(
            f'<div style="padding:.4em .8em;border:1px solid #8888;border-radius:8px">'
            f"<small>{escape(label)}</small><br><b>{escape(figure)}</b><br>"
            f"<small>{escape(text)}</small></div>"
            for label, figure, text in getattr(self, "cards", ())
        )
        if not cards:
            return screen
        row = f'<div style="display:flex;flex-wrap:wrap;gap:.6em">{cards}</div>'
        return f"{row}<details><summary>all of it</summary>{screen}</details>"

    cls.__repr__ = line  # type: ignore[assignment]
    cls._repr_html_ = page  # type: ignore[attr-defined]
    return cls


_SHOWN = 3  # stretches


def describe_holes(dropped: str, holes: Sequence[tuple[int, int]], start_ns: int) -> str:
    """How many records are missing, and where; empty where none is.

    The recorder counted those that it `dropped`; the holes and the session's start are [UNIX ns].
    """
    if not holes:
        return ""
    spans = [((first - start_ns) * 1e-9, (last - start_ns) * 1e-9) for first, last in holes]
    shown = ", ".join(f"{first:.2f} to {last:.2f} s" for first, last in spans[:_SHOWN])
    more = f" and {len(spans) - _SHOWN} more stretches" if len(spans) > _SHOWN else ""
    seconds = sum(last - first for first, last in spans)
    count = "records" if dropped in ("", "0") else f"{dropped} records"
    return f"{count} were dropped within {seconds:.2f} s: {shown}{more}"


# -- progress of a long command: a bar on a terminal, nothing elsewhere ----------------------------

Advance = Callable[[float], None]  # called with the amount of work done, in the unit of the total


class Step(Protocol):
    """Called with the amount of work done, and the name of the next step where it has one."""

    def __call__(self, done: float, step: str = "", /) -> None:
        """Move the bar."""


def watched(items: Iterable[T], advance: Callable[[int], None], every: int = 500) -> Iterator[T]:
    """The items as they are; `advance` is called with their number at each of `every`."""
    for count, item in enumerate(items):
        if count % every == 0:
            advance(count)
        yield item


@contextmanager
def show_progress(label: str, total: float, *, even: bool = False) -> Iterator[Step]:
    """A bar on standard error if that is a terminal; work at an `even` rate shows the time left."""
    if not sys.stderr.isatty():
        yield lambda done, step="", /: None
        return
    from rich import progress as bars
    from rich.console import Console

    text = bars.TextColumn("{task.description}")
    # The spinner and the elapsed time move during a long step that reports no share of its own.
    columns = bars.SpinnerColumn("line"), text, bars.BarColumn(), bars.TaskProgressColumn()
    times = (bars.TimeElapsedColumn(), bars.TextColumn("left"), bars.TimeRemainingColumn())
    shown = (*columns, *(times if even else times[:1]))
    console = Console(file=raw(sys.stderr))
    with bars.Progress(*shown, console=console, transient=True) as progress:
        task = progress.add_task(label, total=total)

        def move(done: float, step: str = "", /) -> None:
            progress.update(task, completed=done, description=f"{label}: {step}" if step else None)

        yield move
