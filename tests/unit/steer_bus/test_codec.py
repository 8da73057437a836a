"""The codec's known vectors and refusals."""

import math
import struct

import pytest

from steerd.steer_bus.codec import MAX_BYTES, CodecError, decode, encode
from steerd.steer_bus.fields import (
    Bytes,
    Nested,
    flat_leaves,
    message,
    message_fields,
    schema_text,
    type_name,
)
from steerd.steer_bus.messages import (
    OWN_MESSAGES,
    WORLD,
    StateMessage,
    Tick,
    Transition,
    make_header,
    stamp_ns,
)
from steerd.steer_bus.standard import DiagnosticArray, Header, KeyValue, Time, make_time
from tests.property.test_codec_roundtrip import Arrays, Point, Table

HEADER = make_header(1_700_000_000_123_456_789, WORLD)


def test_tick_is_padded_to_eight():
    data = encode(Tick(HEADER, -1, 2, 3, 4, 5))
    assert data[4 + 16 :] == struct.pack("<qqqII", -1, 2, 3, 4, 5)
    data = encode(Tick(make_header(0, "ab"), -1, 2, 3, 4, 5))
    assert data[4:] == struct.pack("<iII3sxqqqII", 0, 0, 3, b"ab\0", -1, 2, 3, 4, 5)


def test_times_before_the_epoch_keep_their_nanoseconds():
    assert make_time(-1) == Time(-1, 999_999_999)
    assert stamp_ns(Header(make_time(-1), "")) == -1


def test_nan_and_infinity_pass():
    values = [math.nan, math.inf, -math.inf, *[0.0] * 18]
    state = decode(StateMessage, encode(StateMessage(HEADER, 0, 0, 0, 0, *values)))
    assert math.isnan(state.x)
    assert state.y == math.inf
    assert state.yaw == -math.inf


@pytest.mark.parametrize(
    "bad",
    [
        Tick(HEADER, 0, 0, 0, -1, 0),
        Tick(HEADER, 2**63, 0, 0, 0, 0),
        Tick(HEADER, 0, 0, 0, "1", 0),
        Tick(None, 0, 0, 0, 0, 0),
        Transition(HEADER, 256, 0, "", ""),
        Transition(HEADER, 0, 0, "\ud800", ""),
        Transition(HEADER, 0, 0, "x" * MAX_BYTES, ""),
        DiagnosticArray(HEADER, (KeyValue("a", "b"), 3)),
    ],
)
def test_what_does_not_fit_is_refused(bad):
    with pytest.raises(CodecError):
        encode(bad)


def test_things_that_are_no_message_are_refused():
    with pytest.raises(CodecError):
        encode(3)
    with pytest.raises(TypeError):
        type_name(int)

    @message("a/msg/Empty")
    class Empty:
        pass

    with pytest.raises(TypeError, match="no field"):
        schema_text(Empty)

    @message("a/msg/Untyped")
    class Untyped:
        x: float

    with pytest.raises(TypeError, match=r"Untyped\.x"):
        message_fields(Untyped)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "missing"),
        (b"\0", "CDR"),
        (b"\0\0\0\0" + bytes(48), "CDR"),
        (b"\0\1\0\0", "unpack"),
        (b"\0\1\0\0" + bytes(8) + b"\xff\xff\xff\xff", "exceeds the data"),
        (b"\0\1\0\0" + bytes(8) + b"\2\0\0\0ab" + bytes(60), "NUL"),
        (b"\0\1\0\0" + bytes(8) + b"\2\0\0\0\xff\0" + bytes(60), "utf-8"),
        (encode(Tick(HEADER, 1, 2, 3, 4, 5)) + bytes(4), "left over"),
        (b"\0\1\0\0" + bytes(MAX_BYTES), "exceed"),
    ],
)
def test_bad_bytes_are_refused(data, why):
    with pytest.raises(CodecError, match=why):
        decode(Tick, data)


def test_dds_padding_and_empty_strings_of_length_zero_are_taken():
    assert decode(Tick, encode(Tick(HEADER, 1, 2, 3, 4, 5)) + bytes(3)) == Tick(
        HEADER, 1, 2, 3, 4, 5
    )
    data = b"\0\1\0\0" + struct.pack("<iII4xqqqII", 1, 2, 0, 3, 4, 5, 6, 7)
    assert decode(Tick, data) == Tick(Header(Time(1, 2), ""), 3, 4, 5, 6, 7)


def test_a_sequence_cannot_claim_more_than_its_data():
    data = encode(Header(Time(0, 0), "")) + bytes(3) + struct.pack("<I", 2**32 - 1)
    with pytest.raises(CodecError, match="exceeds"):
        decode(DiagnosticArray, data)


@pytest.mark.parametrize("cls", OWN_MESSAGES)
def test_own_messages_are_flat_with_header_first_and_texts_last(cls):
    leaves = flat_leaves(cls)
    assert leaves is not None
    first = message_fields(cls)[0]
    assert first.name == "header"
    assert first.kind == Nested(Header)
    order = ["iIqQhHbB", "d", "s"]
    ranks = [
        next(r for r, codes in enumerate(order) if getattr(leaf.kind, "code", "s") in codes)
        for leaf in leaves[3:]
    ]
    assert ranks == sorted(ranks)
    floats = [f for f in message_fields(cls) if getattr(f.kind, "code", "") == "d"]
    assert all(field.unit for field in floats)


def test_schema_text_of_a_message_with_dependencies():
    assert schema_text(Tick) == (
        "std_msgs/Header header\n"
        "int64 due_ns  # ns\nint64 woke_ns  # ns\nint64 work_ns  # ns\n"
        "uint32 seq\nuint32 flags\n"
        + "=" * 80 + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
        + "=" * 80 + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )  # fmt: skip


@pytest.mark.parametrize("few", [(), (1.0, 2.0), (1.0, 2.0, 3.0, 4.0)])
def test_an_array_of_another_length_is_refused(few):
    arrays = Arrays(1, few, "", (1, 2, 3, 4, 5), b"", 0.0)
    with pytest.raises(CodecError, match=f"Arrays: array of {len(few)} where 3 belong"):
        encode(arrays)
    with pytest.raises(CodecError, match="cannot encode Table: array of"):
        encode(Table(1, Point(1, 0.0), (), b"", few, 0))


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
