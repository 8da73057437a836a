"""Primitives of the NatNet wire: little-endian, packed, NUL-terminated UTF-8 strings.

Every read is bounds-checked: `struct` refuses to read past the end, counts are capped, and a
missing NUL is an error. `NatNetError` is the only exception that decoding lets out.
"""

from struct import Struct

MAX_COUNT = 10_000
"""No section of a real frame has more items; a larger count is corruption."""

Version = tuple[int, int]

HEADER = Struct("<HH")
I32 = Struct("<i")
F32 = Struct("<f")
U64 = Struct("<Q")
SECTION = Struct("<ii")
"""Head of a section that says its size: count, bytes."""


class NatNetError(ValueError):
    """Bytes that are not a NatNet message of the stated version."""


def read_i32(data: bytes, at: int) -> tuple[int, int]:
    """Read a signed 32-bit integer; returns it and the offset behind it."""
    return I32.unpack_from(data, at)[0], at + 4


def read_count(data: bytes, at: int) -> tuple[int, int]:
    """Read an item count.

    Raises:
        NatNetError: negative, or above `MAX_COUNT`.
    """
    (n,) = I32.unpack_from(data, at)
    if not 0 <= n <= MAX_COUNT:
        raise NatNetError(f"count {n} at byte {at}")
    return n, at + 4


def read_size(data: bytes, at: int) -> tuple[int, int]:
    """Read a byte size; returns the offsets of what has this size.

    Raises:
        NatNetError: negative, or past the end of the datagram.
    """
    (size,) = I32.unpack_from(data, at)
    start, end = at + 4, at + 4 + size
    if size < 0 or end > len(data):
        raise NatNetError(f"section of {size} bytes at byte {at}")
    return start, end


def read_cstr(data: bytes, at: int) -> tuple[str, int]:
    """Read a NUL-terminated string.

    Raises:
        NatNetError: no NUL before the end.
    """
    end = data.find(0, at)
    if end < 0:
        raise NatNetError(f"unterminated string at byte {at}")
    return data[at:end].decode("utf-8", "replace"), end + 1


def read_name(data: bytes, at: int, width: int) -> str:
    """Read a fixed-width name; Motive leaves stack garbage behind its NUL."""
    return data[at : at + width].split(b"\0", 1)[0].decode("utf-8", "replace")


def need(data: bytes, at: int, size: int) -> int:
    """Return the offset `size` bytes on.

    Raises:
        NatNetError: the datagram ends before that.
    """
    end = at + size
    if end > len(data):
        raise NatNetError(f"datagram ends at {len(data)}, {end} needed")
    return end


Layout = int | None | tuple["Layout", ...] | list["Layout"]
"""What is passed over: so many bytes; None: a string; a tuple: one after the other; a list: a count
and each of its parts so often."""


def skip(data: bytes, at: int, layout: Layout) -> int:
    """Return the offset behind what a layout describes.

    Raises:
        NatNetError: the datagram ends before that, or a count is none.
    """
    if layout is None:
        return read_cstr(data, at)[1]
    if isinstance(layout, int):
        return need(data, at, layout)
    n = 1
    if isinstance(layout, list):
        n, at = read_count(data, at)
    for part in layout:
        if isinstance(part, int):
            at = need(data, at, n * part)
        else:
            for _ in range(n):
                at = skip(data, at, part)
    return at


def write_cstr(text: str) -> bytes:
    """Encode a NUL-terminated string; embedded NULs would end it early and are dropped."""
    return text.replace("\0", "").encode() + b"\0"


def write_name(text: str, width: int) -> bytes:
    """Encode a fixed-width name, always with a closing NUL."""
    return text.encode()[: width - 1].ljust(width, b"\0")
