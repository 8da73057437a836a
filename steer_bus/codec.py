"""Messages to and from ROS 2 CDR (XCDR1, little endian), derived from the message class alone.

Wire rules (`docs/reference/sessions-and-bus.md#b1.2`): four bytes ``00 01 00 00``, then the
fields in order; alignment counts from byte 4; a primitive is aligned to its own size; a string is
``uint32`` length with its NUL, bytes, NUL; a fixed array has no length; a sequence starts with
its ``uint32`` count.

A flat message (no sequence of messages) is one cached ``struct.Struct`` per set of string lengths,
so encoding it is one ``pack``.
"""

# Why: docs/decisions/messages-and-sessions.md#d2

import functools
import operator
import struct
from collections.abc import Callable, Iterator
from itertools import groupby, islice
from typing import Any, TypeVar

from steerd.steer_bus.fields import Kind, Nested, Scalar, Sized, cached, leaves_of, message_fields

MAX_BYTES = 63 << 10
"""Largest encoded message; the bus drops 64 KiB and more, its own framing included."""

_HEADER = b"\x00\x01\x00\x00"
MAX_TRAILING = 3  # DDS pads a payload to a multiple of four
_MAX_LAYOUTS = 256
_LENGTH = struct.Struct("<I")

M = TypeVar("M")


class CodecError(ValueError):
    """A message that cannot be encoded, or bytes that are not the message they should be."""


def encode(msg: Any) -> bytes:
    """Encode a message as CDR with its 4-byte header.

    Raises:
        CodecError: if a value does not fit its type or the result exceeds ``MAX_BYTES``.
    """
    try:
        data = _encoder(type(msg))(msg)
    except (struct.error, OverflowError, UnicodeError, TypeError, AttributeError) as error:
        raise CodecError(f"cannot encode {type(msg).__name__}: {error}") from error
    if len(data) > MAX_BYTES:
        raise CodecError(f"{type(msg).__name__} of {len(data)} bytes exceeds {MAX_BYTES}")
    return data


def decode(cls: type[M], data: bytes) -> M:
    """Decode CDR bytes as a message of class ``cls``.

    Raises:
        CodecError: on a wrong header, truncation, lengths outside the data, invalid UTF-8, more
            than three trailing bytes, or more than ``MAX_BYTES``.
    """
    name = cls.__name__
    if len(data) > MAX_BYTES:
        raise CodecError(f"{name}: {len(data)} bytes exceed {MAX_BYTES}")
    if data[:2] != _HEADER[:2]:
        raise CodecError(f"{name}: not little-endian CDR (header {data[:4].hex() or 'missing'})")
    values: list[Any] = []
    try:
        end = read_steps(_steps(cls), data, len(_HEADER), values)
    except (struct.error, UnicodeError, IndexError) as error:
        raise CodecError(f"{name}: {error}") from error
    if len(data) - end > MAX_TRAILING:
        raise CodecError(f"{name}: {len(data) - end} bytes left over")
    made: M = _builder(cls)(iter(values))
    return made


# -- encoding ------------------------------------------------------------------------------------


@cached
def _encoder(cls: type[Any]) -> Callable[[Any], bytes]:
    leaves = leaves_of(cls)
    kinds = [leaf.kind for leaf in leaves]
    if any(isinstance(kind, Nested) for kind in kinds):
        return lambda msg: _HEADER + _append(bytearray(), msg)
    getter = operator.attrgetter(*(leaf.name for leaf in leaves))
    read = getter if len(leaves) > 1 else lambda msg: (getter(msg),)
    sized = [i for i, kind in enumerate(kinds) if isinstance(kind, Sized)]
    arrays = [(i, k.count) for i, k in enumerate(kinds) if isinstance(k, Scalar) and k.count][::-1]

    @functools.lru_cache(maxsize=_MAX_LAYOUTS)
    def layout_for(*lengths: int) -> struct.Struct:
        remaining = iter(lengths)
        return _layout([token for kind in kinds for token in _tokens(kind, remaining)])

    def encode_one_text(msg: Any) -> bytes:
        # Most records hold one text, the frame: without the loops below they take a third less.
        args = [*read(msg)]
        blob = args[at] = _prefixed(args[at])
        return layout_for(len(blob)).pack(_HEADER, *args)

    def encode_flat(msg: Any) -> bytes:
        args = list(read(msg))
        for i in sized:
            args[i] = _prefixed(args[i])
        lengths = [len(args[i]) for i in sized]
        for i, count in arrays:
            args[i : i + 1] = _checked(args[i], count)
        return layout_for(*lengths).pack(_HEADER, *args)

    if len(sized) != 1 or arrays:
        return encode_flat
    at = sized[0]
    return encode_one_text


@functools.lru_cache(maxsize=1024)
def _prefixed(value: str | bytes) -> bytes:
    raw = value if isinstance(value, bytes) else value.encode() + b"\x00"
    return _LENGTH.pack(len(raw)) + raw


def _checked(items: tuple[float, ...], count: int) -> tuple[float, ...]:
    if len(items) != count:
        raise TypeError(f"array of {len(items)} where {count} belong")
    return items


_Token = tuple[int, int, str]  # alignment, size, struct code


def _tokens(kind: Kind, lengths: Iterator[int]) -> list[_Token]:
    if isinstance(kind, Scalar):
        return [(kind.size, kind.size, kind.code)] * (kind.count or 1)
    size = next(lengths)
    return [(_LENGTH.size, size, f"{size}s")]


def _layout(tokens: list[_Token], offset: int = 0, head: str = f"{len(_HEADER)}s") -> struct.Struct:
    """What stands in line behind a head, from so many bytes behind an alignment on."""
    parts = ["<", head]
    for align, size, code in tokens:
        pad = -offset % align
        parts.append("x" * pad + code)
        offset += pad + size
    return struct.Struct("".join(parts))


def _append(data: bytearray, msg: Any) -> bytearray:
    """Append a message to data that are counted from behind the header, and give them back."""
    for leaf in leaves_of(type(msg)):
        value, kind = operator.attrgetter(leaf.name)(msg), leaf.kind
        if isinstance(kind, Scalar):
            values = _checked(value, kind.count) if kind.count else (value,)
            data += bytes(-len(data) % kind.size)
            data += struct.pack(f"<{len(values)}{kind.code}", *values)
        elif isinstance(kind, Sized):
            data += bytes(-len(data) % _LENGTH.size) + _prefixed(value)
        else:
            data += bytes(-len(data) % _LENGTH.size) + _LENGTH.pack(len(value))
            for item in value:
                _append(data, item)
    return data


# -- decoding ------------------------------------------------------------------------------------

_Step = tuple[struct.Struct, ...] | Sized | type[Any]


@cached
def _steps(cls: type[Any]) -> tuple[_Step, ...]:
    """Give what to read in order: runs of primitives (one layout per phase), texts, sequences."""
    steps: list[_Step] = []
    kinds: Iterator[Any] = (leaf.kind for leaf in leaves_of(cls))
    for fixed, group in groupby(kinds, lambda kind: isinstance(kind, Scalar)):
        if fixed:
            run = [token for kind in group for token in _tokens(kind, iter(()))]
            steps.append(tuple(_layout(run, phase, "") for phase in range(8)))
        else:
            steps += (kind.cls if isinstance(kind, Nested) else kind for kind in group)
    return tuple(steps)


def read_steps(steps: tuple[_Step, ...], data: bytes, pos: int, values: list[Any]) -> int:
    """Append what stands behind a place of the data, and give the place behind it.

    Raises:
        CodecError: on lengths outside the data and a string without its NUL.
        struct.error, UnicodeError: on truncation and invalid UTF-8.
    """
    for step in steps:
        if isinstance(step, tuple):
            layout = step[(pos - 4) % 8]
            values += layout.unpack_from(data, pos)
            pos += layout.size
            continue
        pos += -pos % 4
        (count,) = _LENGTH.unpack_from(data, pos)
        pos += 4
        if count > len(data) - pos:
            raise CodecError(f"length {count} at byte {pos - 4} exceeds the data")
        if isinstance(step, Sized):
            raw = data[pos : pos + count]
            # A few DDS vendors write an empty string with length 0.
            if step.is_text and raw[-1:] not in (b"", b"\x00"):
                raise CodecError("string without its NUL")
            values.append(raw[:-1].decode() if step.is_text else bytes(raw))
            pos += count
        else:
            items, pos = _read_items(step, data, pos, count)
            values.append(items)
    return pos


def _read_items(cls: type[Any], data: bytes, pos: int, count: int) -> tuple[tuple[Any, ...], int]:
    steps, build = _steps(cls), _builder(cls)
    items = []
    for _ in range(count):
        values: list[Any] = []
        pos = read_steps(steps, data, pos, values)
        items.append(build(iter(values)))
    return tuple(items), pos


@cached
def _builder(cls: type[Any]) -> Callable[[Iterator[Any]], Any]:
    parts = [_part(field.kind) for field in message_fields(cls)]
    return lambda values: cls(*[part(values) for part in parts])


def _part(kind: Kind) -> Callable[[Iterator[Any]], Any]:
    if isinstance(kind, Nested) and not kind.many:
        return _builder(kind.cls)
    if isinstance(kind, Scalar) and kind.count:
        return lambda values: tuple(islice(values, kind.count))
    return next
