"""Lines for a terminal: broken between words, never inside one, and free of control characters."""

import re
import shutil
import textwrap
from math import isfinite
from pathlib import Path
from typing import TextIO

WIDTH = 80
"""Columns of the narrowest terminal that reports are made for."""
NBSP = "\u00a0"
"""Joins what must stand on one line, a figure and its unit for instance; shown as a space."""
_COMMAND = re.compile("`steerd [^`]*`")
TEXT_MAX = 200
"""Text from a file is cut after so many characters."""


def clean(text: str, length: int = TEXT_MAX) -> str:
    """Text from a file, safe for a terminal: no control characters, not too long."""
    shown = "".join(c if c.isprintable() else "?" for c in text[:length])
    return shown + ("…" if len(text) > length else "")


def show(value: float, form: str) -> str:
    """A number in a format, or a dash of that width where it is not known (NaN, infinite)."""
    if isfinite(value):
        return format(value, form)
    return format("–", f">{len(format(0.0, form))}")


def wrap(text: str, first: str = "", rest: str = "", width: int = WIDTH) -> list[str]:
    """Lines of at most `width` columns; a longer word has a line of its own.

    Args:
        text: one paragraph; `NBSP` is a space at which no line breaks, nor does one within a
            command, which is to be copied.
        first: the head of the first line.
        rest: the indent of the others.
        width: columns.
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
    """A command line to copy: broken before options, with the shell's continuation.

    Args:
        command: as it is typed.
        first: the head of the first line.
        rest: the indent of the others.
        width: columns.
    """
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
    """Print a label and a text; only a terminal gets broken lines, a file or pipe does not.

    Args:
        label: the head of the first line, also the width by which later lines are indented.
        text: paragraphs, one per line; an indented one is to be copied and stays as it is.
        file: where to.
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
