"""The codec's known vectors and refusals."""

import struct
from dataclasses import replace
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from steerd.steer_bus import fields, standard
from steerd.steer_bus.codec import MAX_BYTES, CodecError, decode, encode
from steerd.steer_bus.fields import message
from steerd.steer_bus.messages import OWN_MESSAGES, WORLD, Tick, Transition, make_header, stamp_ns

HEADER = make_header(1_700_000_000_123_456_789, WORLD)


def test_times_before_the_epoch_dds_padding_and_empty_strings_of_length_zero_are_taken():
    assert standard.make_time(-1) == standard.Time(-1, 999_999_999)
    assert stamp_ns(standard.Header(standard.make_time(-1), "")) == -1
    tick = Tick(HEADER, 1, 2, 3, 4, 5)
    assert decode(Tick, encode(tick) + bytes(3)) == tick
    data = b"\0\1\0\0" + struct.pack("<iII4xqqqII", 1, 2, 0, 3, 4, 5, 6, 7)
    assert decode(Tick, data) == Tick(standard.Header(standard.Time(1, 2), ""), 3, 4, 5, 6, 7)


@pytest.mark.parametrize("bad", [
    Tick(HEADER, 0, 0, 0, -1, 0), Tick(HEADER, 2**63, 0, 0, 0, 0), Tick(HEADER, 0, 0, 0, "1", 0),
    Tick(None, 0, 0, 0, 0, 0), Transition(HEADER, 256, 0, "", ""),
    Transition(HEADER, 0, 0, "\ud800", ""), Transition(HEADER, 0, 0, "x" * MAX_BYTES, ""),
    standard.DiagnosticArray(HEADER, (standard.KeyValue("a", "b"), 3)),
])  # fmt: skip
def test_what_does_not_fit_is_refused(bad):
    with pytest.raises(CodecError):
        encode(bad)


def test_things_that_are_no_message_are_refused():
    with pytest.raises(CodecError):
        encode(3)
    with pytest.raises(TypeError):
        fields.type_name(int)

    @message("a/msg/Empty")
    class Empty:
        pass

    with pytest.raises(TypeError, match="no field"):
        fields.schema_text(Empty)

    @message("a/msg/Untyped")
    class Untyped:
        x: float

    with pytest.raises(TypeError, match=r"Untyped\.x"):
        fields.message_fields(Untyped)


@pytest.mark.parametrize(("data", "why"), [
    (b"", "missing"), (b"\0", "CDR"), (b"\0\0\0\0" + bytes(48), "CDR"), (b"\0\1\0\0", "unpack"),
    (b"\0\1\0\0" + bytes(8) + b"\xff\xff\xff\xff", "exceeds the data"),
    (b"\0\1\0\0" + bytes(8) + b"\2\0\0\0ab" + bytes(60), "NUL"),
    (b"\0\1\0\0" + bytes(8) + b"\2\0\0\0\xff\0" + bytes(60), "utf-8"),
    (encode(Tick(HEADER, 1, 2, 3, 4, 5)) + bytes(4), "left over"),
    (b"\0\1\0\0" + bytes(MAX_BYTES), "exceed"),
])  # fmt: skip
def test_bad_bytes_are_refused(data, why):
    with pytest.raises(CodecError, match=why):
        decode(Tick, data)


@pytest.mark.parametrize("cls", OWN_MESSAGES)
def test_own_messages_are_flat_with_header_first_and_texts_last(cls):
    leaves = fields.flat_leaves(cls)
    first = fields.message_fields(cls)[0]
    assert (first.name, first.kind) == ("header", fields.Nested(standard.Header))
    order = ["iIqQhHbB", "d", "s"]
    ranks = [
        next(r for r, codes in enumerate(order) if getattr(leaf.kind, "code", "s") in codes)
        for leaf in leaves[3:]
    ]
    assert ranks == sorted(ranks)
    floats = [f for f in fields.message_fields(cls) if getattr(f.kind, "code", "") == "d"]
    assert all(field.unit for field in floats)


def test_schema_text_of_a_message_with_dependencies():
    assert fields.schema_text(Tick) == (
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
        wire: fields.Bytes

    most = Long(bytes(MAX_BYTES - 8))
    data = encode(most)
    assert (len(data), decode(Long, data)) == (MAX_BYTES, most)
    with pytest.raises(CodecError, match=rf"^Long of {MAX_BYTES + 1} bytes exceeds {MAX_BYTES}$"):
        encode(Long(bytes(MAX_BYTES - 7)))
    with pytest.raises(CodecError, match=rf"^Long: {MAX_BYTES + 1} bytes exceed {MAX_BYTES}$"):
        decode(Long, data + b"\0")


# Any message survives its encoding, byte-identical to rosbags; no bytes crash the decoder.
Float32x3 = Annotated[tuple[float, ...], fields.Scalar("float32[3]", 58, "f", 4, 3)]
UInt8x5 = Annotated[tuple[int, ...], fields.Scalar("uint8[5]", 51, "B", 1, 5)]
Int16 = Annotated[int, fields.Scalar("int16", 4, "h", 2)]


@message("a/msg/Arrays")
class Arrays:
    first: fields.UInt8
    few: Float32x3
    name: fields.String
    bits: UInt8x5
    wire: fields.Bytes
    last: fields.Float64


@message("a/msg/Point")
class Point:
    tag: fields.UInt8
    x: fields.Float64


@message("a/msg/Row")
class Row:
    name: fields.String
    few: Float32x3
    at: Point
    end: Int16


@message("a/msg/Table")
class Table:
    n: fields.UInt8
    at: Point
    rows: tuple[Row, ...]
    wire: fields.Bytes
    few: Float32x3
    end: fields.UInt32


ALL = (*standard.STANDARD_MESSAGES, *OWN_MESSAGES, Arrays, Row, Table)
PROFILE = settings(derandomize=True, deadline=None, max_examples=25, database=None)
TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)


def value_of(kind):
    match kind:
        case fields.Sized(is_text=True):
            return TEXT
        case fields.Sized():
            return st.binary(max_size=40)
        case fields.Scalar(count=count) if count:
            return st.tuples(*[value_of(replace(kind, count=0))] * count)
        case fields.Nested(many=False):
            return message_of(kind.cls)
        case fields.Nested():
            return st.lists(message_of(kind.cls), max_size=3).map(tuple)
        case fields.Scalar(ros="byte"):  # rosbags takes it as signed; ROS uses 0 to 3
            return st.integers(0, 127)
        case fields.Scalar(code="d" | "f"):
            return st.floats(width=8 * kind.size, allow_nan=False)
    signed = kind.code.islower()
    low = -(2 ** (8 * kind.size - 1)) if signed else 0
    return st.integers(low, low + 2 ** (8 * kind.size) - 1)


def message_of(cls):
    return st.builds(cls, *[value_of(field.kind) for field in fields.message_fields(cls)])


@pytest.fixture(scope="module")
def store():
    """ROS's own definitions, so that their hashes judge ours, and of what ROS has none, ours."""
    made = get_typestore(Stores.ROS2_HUMBLE)
    for cls in ALL:
        types = get_types_from_msg(fields.schema_text(cls), fields.type_name(cls))
        own = {n: t for n, t in types.items() if n not in made.types}
        assert {n.split("/")[0] for n in own} <= {"ackermann_msgs", "vesc_msgs", "steerd_msgs", "a"}
        made.register(own)
    return made


def to_rosbags(message, store):
    values = []
    for field in fields.message_fields(type(message)):
        value = getattr(message, field.name)
        match field.kind:
            case fields.Scalar(count=count) if count:
                value = np.array(value, f"={field.kind.code}")
            case fields.Sized(is_text=False):
                value = np.frombuffer(value, np.uint8)
            case fields.Nested(many=False):
                value = to_rosbags(value, store)
            case fields.Nested():
                value = [to_rosbags(item, store) for item in value]
        values.append(value)
    return store.types[fields.type_name(type(message))](*values)


@pytest.mark.parametrize("cls", ALL)
def test_type_hash_and_round_trip_are_byte_identical_to_rosbags(cls, store):
    assert fields.type_hash(cls) == store.hash_rihs01(fields.type_name(cls))

    @PROFILE
    @given(message_of(cls))
    def check(message):
        data = encode(message)
        assert decode(cls, data) == message
        assert data == bytes(store.serialize_cdr(to_rosbags(message, store), fields.type_name(cls)))

    check()


@pytest.mark.parametrize("cls", ALL)
def test_truncation_at_every_byte_is_refused(cls):
    @settings(PROFILE, max_examples=3)
    @given(message_of(cls))
    def check(message):
        data = encode(message)
        for length in range(len(data)):
            try:
                decode(cls, data[:length])
            except CodecError:
                continue
            pytest.fail(f"{length} of {len(data)} bytes were taken")

    check()
