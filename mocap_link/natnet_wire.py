"""Primitives of the NatNet wire: little-endian, packed, NUL-terminated UTF-8 strings.

Every read is bounds-checked: `struct` refuses to read past the end, counts are capped, and a
missing NUL is an error. `NatNetError` is the only exception that decoding lets out.
"""

from struct import Struct
from typing import Any

MAX_COUNT = 10_000
"""No section of a real frame has more items; a larger count is corruption."""

Version = tuple[int, int]

HEADER = Struct("<HH")
I32 = Struct("<i")
F32 = Struct("<f")
U64 = Struct("<Q")
SECTION = Struct("<ii")
"""Head of a section that says its size: count, bytes."""
Layout = int | None | tuple["Layout", ...] | list["Layout"]
"""What is passed over: so many bytes; None: a string; a tuple: one after the other; a list: a count
and each of its parts so often."""


class NatNetError(ValueError):
    """Bytes that are not a NatNet message of the stated version."""


class Reader:
    """A datagram to its `end`, and the offset `at` behind what was read; begins behind the header.

    Every method reads on, and raises `NatNetError` where the bytes are not what it reads, or
    `struct.error` where the datagram ends early (`natnet.decode` turns it into `NatNetError`).
    """

    __slots__ = ("at", "data", "end")

    def __init__(self, data: bytes) -> None:
        self.data, self.at, self.end = data, HEADER.size, len(data)

    def unpack(self, layout: Struct) -> tuple[Any, ...]:
        """A structure's values."""
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def i32(self) -> int:
        """A signed 32-bit integer."""
        (value,) = I32.unpack_from(self.data, self.at)
        self.at += 4
        return int(value)

    def count(self) -> int:
        """An item count, at most `MAX_COUNT`."""
        (n,) = I32.unpack_from(self.data, self.at)
        if not 0 <= n <= MAX_COUNT:
            raise NatNetError(f"count {n} at byte {self.at}")
        self.at += 4
        return int(n)

    def sized(self) -> int:
        """A byte size; the offset behind what has this size."""
        (size,) = I32.unpack_from(self.data, self.at)
        end = self.at + 4 + size
        if size < 0 or end > self.end:
            raise NatNetError(f"section of {size} bytes at byte {self.at}")
        self.at += 4
        return int(end)

    def take(self, size: int) -> bytes:
        """So many bytes."""
        start, self.at = self.at, self.at + size
        if self.at > self.end:
            raise NatNetError(f"datagram ends at {self.end}, {self.at} needed")
        return self.data[start : self.at]

    def string(self) -> str:
        """A NUL-terminated string."""
        end = self.data.find(0, self.at)
        if end < 0:
            raise NatNetError(f"unterminated string at byte {self.at}")
        start, self.at = self.at, end + 1
        return self.data[start:end].decode("utf-8", "replace")

    def skip(self, layout: Layout) -> None:
        """Pass over what a layout describes."""
        if layout is None:
            self.string()
        elif isinstance(layout, int):
            self.take(layout)
        else:
            n = self.count() if isinstance(layout, list) else 1
            for part in layout:
                if isinstance(part, int):
                    self.take(n * part)
                else:
                    for _ in range(n):
                        self.skip(part)


def read_name(data: bytes) -> str:
    """Read a name of fixed width; Motive leaves stack garbage behind its NUL."""
    return data.split(b"\0", 1)[0].decode("utf-8", "replace")


def write_cstr(text: str) -> bytes:
    """Encode a NUL-terminated string; embedded NULs would end it early and are dropped."""
    return text.replace("\0", "").encode() + b"\0"


def write_name(text: str, width: int) -> bytes:
    """Encode a fixed-width name, always with a closing NUL."""
    return text.encode()[: width - 1].ljust(width, b"\0")
