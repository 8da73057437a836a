"""The codec on classes that it has never seen, against a writer that pads field by field.

Encoders are made once for each class and kept; these classes are new in each test, so that the
making is what is tested.
"""

import struct
from typing import Annotated

import pytest

from steerd.steer_bus.codec import MAX_BYTES, CodecError, decode, encode, read_text
from steerd.steer_bus.fields import (
    Array,
    Bytes,
    Float64,
    Int16,
    Scalar,
    String,
    UInt8,
    UInt32,
    message,
)

Float32x3 = Annotated[tuple[float, ...], Array(Scalar("float32", "f", 4), 3)]
UInt8x5 = Annotated[tuple[int, ...], Array(Scalar("uint8", "B", 1), 5)]


def cdr(*parts):
    """Bytes of (struct code, value) parts; texts and blobs are themselves, a count is an int."""
    out = b""
    for part in parts:
        if isinstance(part, tuple):
            code, *values = part
            for value in values:
                out += bytes(-len(out) % struct.calcsize(code)) + struct.pack("<" + code, value)
        else:
            raw = part.encode() + b"\0" if isinstance(part, str) else part
            out += bytes(-len(out) % 4)
            out += struct.pack("<I", raw if isinstance(raw, int) else len(raw))
            out += b"" if isinstance(raw, int) else raw
    return b"\0\1\0\0" + out


def classes():
    """New message classes: arrays, texts, a nested one, a sequence of nested ones."""

    @message("a/msg/Point")
    class Point:
        tag: UInt8
        x: Float64

    @message("a/msg/Arrays")
    class Arrays:
        first: UInt8
        few: Float32x3
        name: String
        bits: UInt8x5
        wire: Bytes
        last: Float64

    @message("a/msg/Text")
    class Text:
        n: UInt8
        name: String
        at: Point
        end: Int16

    @message("a/msg/Row")
    class Row:
        name: String
        few: Float32x3
        at: Point

    @message("a/msg/Table")
    class Table:
        n: UInt8
        at: Point
        rows: tuple[Row, ...]
        wire: Bytes
        few: Float32x3
        end: UInt32

    return Point, Arrays, Text, Row, Table


def both_ways(value, expected):
    assert encode(value) == expected
    assert encode(value) == expected, "and again, with what was kept"
    assert decode(type(value), expected) == value


@pytest.mark.parametrize("name", ["", "a", "ab", "abc", "abcd", "größer"])
@pytest.mark.parametrize("wire", [b"", b"1", b"12345"])
def test_arrays_beside_texts(name, wire):
    _, arrays, *_ = classes()
    few, bits = (0.5, -1.5, 2.25), (1, 2, 3, 4, 255)
    parts = [("B", 7), ("f", *few), name, ("B", *bits), wire, ("d", 0.1)]
    both_ways(arrays(7, few, name, bits, wire, 0.1), cdr(*parts))


@pytest.mark.parametrize("name", ["", "x", "four", "eight---", "µ"])
def test_one_text_and_a_message_within(name):
    point, _, text, *_ = classes()
    expected = cdr(("B", 9), name, ("B", 3), ("d", -0.7), ("h", -300))
    both_ways(text(9, name, point(3, -0.7), -300), expected)


@pytest.mark.parametrize("names", [(), ("a",), ("", "bb", "three"), tuple("abcdefghij")])
@pytest.mark.parametrize("wire", [b"", b"xyz"])
def test_sequences_of_messages(names, wire):
    point, _, _, row, table = classes()
    few = (1.0, 2.0, -0.5)
    rows = tuple(row(name, few, point(i, i / 3)) for i, name in enumerate(names))
    parts = [("B", 1), ("B", 2), ("d", 1e300), len(names)]
    for i, name in enumerate(names):
        parts += [name, ("f", *few), ("B", i), ("d", i / 3)]
    parts += [wire, ("f", *few), ("I", 2**32 - 1)]
    both_ways(table(1, point(2, 1e300), rows, wire, few, 2**32 - 1), cdr(*parts))


@pytest.mark.parametrize("few", [(), (1.0, 2.0), (1.0, 2.0, 3.0, 4.0)])
def test_an_array_of_another_length_is_refused(few):
    point, arrays, _, row, table = classes()
    said = f"cannot encode Arrays: array of {len(few)} where 3 belong"
    with pytest.raises(CodecError, match=said):
        encode(arrays(1, few, "", (1, 2, 3, 4, 5), b"", 0.0))
    good = (0.0, 0.0, 0.0)
    for bad in (
        table(1, point(1, 0.0), (row("", few, point(1, 0.0)),), b"", good, 0),
        table(1, point(1, 0.0), (), b"", few, 0),
    ):
        with pytest.raises(CodecError, match="cannot encode Table: array of"):
            encode(bad)


def test_the_longest_message():
    @message("a/msg/Long")
    class Long:
        wire: Bytes

    most = Long(bytes(MAX_BYTES - 8))
    data = encode(most)
    assert len(data) == MAX_BYTES
    assert decode(Long, data) == most
    with pytest.raises(CodecError, match=rf"^Long of {MAX_BYTES + 1} bytes exceeds {MAX_BYTES}$"):
        encode(Long(bytes(MAX_BYTES - 7)))
    with pytest.raises(CodecError, match=rf"^Long: {MAX_BYTES + 1} bytes exceed {MAX_BYTES}$"):
        decode(Long, data + b"\0")


def test_what_is_wrong_with_bytes_is_said_exactly():
    point, _, text, *_ = classes()
    good = encode(point(1, 2.0))
    for bad, said in (
        (b"", "Point: not little-endian CDR (header missing)"),
        (b"\0\0\1\2\3\4", "Point: not little-endian CDR (header 00000102)"),
        (good + bytes(4), "Point: 4 bytes left over"),
        (good[:-1], "Point: "),
    ):
        with pytest.raises(CodecError) as caught:
            decode(point, bad)
        assert str(caught.value).startswith(said)
    assert decode(point, good + bytes(3)) == point(1, 2.0)
    wire = b"\0\1\0\0" + struct.pack("<B3xI", 1, 1000) + b"abc"
    with pytest.raises(CodecError, match=r"^length 1000 at byte 8 exceeds the data$"):
        decode(text, wire)
    exact = b"\0\1\0\0" + struct.pack("<B3xI", 1, 4) + b"abc"
    with pytest.raises(CodecError, match=r"^length 4 at byte 8 exceeds the data$"):
        decode(text, exact)


def test_a_text_without_its_end_is_refused():
    assert read_text(b"") == ""
    assert read_text(b"\0") == ""
    assert read_text(b"ab\0") == "ab"
    with pytest.raises(CodecError, match=r"^string without its NUL$"):
        read_text(b"ab")
