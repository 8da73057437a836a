"""Standard streams of a command: there, in any locale, and without what would steer a terminal."""

import os
import sys
from typing import Any, TextIO

_CONTROLS = dict.fromkeys(
    {*range(32), *range(127, 160), *range(0x202A, 0x202F), *range(0x2066, 0x206A)} - {9, 10}, "?"
)
"""Control characters but for tab and line end, and those that turn the direction of reading."""


def remove_controls(text: str) -> str:
    """Text that no terminal obeys: each control character is a question mark."""
    return text.translate(_CONTROLS)


class PlainStream:
    """A stream whose text passes `remove_controls`; `raw` is for what draws on a terminal itself.

    Attributes:
        raw: the stream behind it.
    """

    def __init__(self, raw: TextIO) -> None:
        self.raw = raw

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
