"""Any message survives its encoding, byte-identical to rosbags; no bytes crash the decoder.

The last classes are here for what no message of ours has side by side.
"""

from dataclasses import replace
from typing import Annotated

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.fields import (
    Bytes,
    Float64,
    Nested,
    Scalar,
    Sized,
    String,
    UInt8,
    UInt32,
    message,
    message_fields,
    schema_text,
    type_hash,
    type_name,
)
from steerd.steer_bus.messages import OWN_MESSAGES
from steerd.steer_bus.standard import STANDARD_MESSAGES

Float32x3 = Annotated[tuple[float, ...], Scalar("float32[3]", 58, "f", 4, 3)]
UInt8x5 = Annotated[tuple[int, ...], Scalar("uint8[5]", 51, "B", 1, 5)]
Int16 = Annotated[int, Scalar("int16", 4, "h", 2)]


@message("a/msg/Arrays")
class Arrays:
    """Arrays and bytes beside texts."""

    first: UInt8
    few: Float32x3
    name: String
    bits: UInt8x5
    wire: Bytes
    last: Float64


@message("a/msg/Point")
class Point:
    tag: UInt8
    x: Float64


@message("a/msg/Row")
class Row:
    name: String
    few: Float32x3
    at: Point
    end: Int16


@message("a/msg/Table")
class Table:
    """Messages in a message, one and many."""

    n: UInt8
    at: Point
    rows: tuple[Row, ...]
    wire: Bytes
    few: Float32x3
    end: UInt32


ALL = (*STANDARD_MESSAGES, *OWN_MESSAGES, Arrays, Row, Table)
PROFILE = settings(derandomize=True, deadline=None, max_examples=25, database=None)
TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=20)


def value_of(kind):
    match kind:
        case Sized(is_text=True):
            return TEXT
        case Sized():
            return st.binary(max_size=40)
        case Scalar(count=count) if count:
            return st.tuples(*[value_of(replace(kind, count=0))] * count)
        case Nested(many=False):
            return message_of(kind.cls)
        case Nested():
            return st.lists(message_of(kind.cls), max_size=3).map(tuple)
        case Scalar(ros="byte"):  # rosbags takes it as signed; ROS uses 0 to 3
            return st.integers(0, 127)
        case Scalar(code="d" | "f"):
            return st.floats(width=8 * kind.size, allow_nan=False)
    signed = kind.code.islower()
    low = -(2 ** (8 * kind.size - 1)) if signed else 0
    return st.integers(low, low + 2 ** (8 * kind.size) - 1)


def message_of(cls):
    return st.builds(cls, *[value_of(field.kind) for field in message_fields(cls)])


@pytest.fixture(scope="module")
def store():
    made = get_typestore(Stores.ROS2_HUMBLE)
    for cls in ALL:
        types = get_types_from_msg(schema_text(cls), type_name(cls))
        made.register({n: t for n, t in types.items() if n not in made.types})
    return made


def to_rosbags(message, store):
    values = []
    for field in message_fields(type(message)):
        value = getattr(message, field.name)
        match field.kind:
            case Scalar(count=count) if count:
                value = np.array(value, f"={field.kind.code}")
            case Sized(is_text=False):
                value = np.frombuffer(value, np.uint8)
            case Nested(many=False):
                value = to_rosbags(value, store)
            case Nested():
                value = [to_rosbags(item, store) for item in value]
        values.append(value)
    return store.types[type_name(type(message))](*values)


@pytest.mark.parametrize("cls", ALL)
def test_round_trip_byte_identical_to_rosbags(cls, store):
    @PROFILE
    @given(message_of(cls))
    def check(message):
        data = encode(message)
        assert decode(cls, data) == message
        assert data == bytes(store.serialize_cdr(to_rosbags(message, store), type_name(cls)))

    check()


@pytest.mark.parametrize("cls", ALL)
def test_type_hash_is_rosbags(cls, store):
    assert type_hash(cls) == store.hash_rihs01(type_name(cls))


@pytest.mark.parametrize("cls", STANDARD_MESSAGES)
def test_standard_layouts_are_the_ros_definitions(cls):
    humble = get_typestore(Stores.ROS2_HUMBLE)
    if type_name(cls) not in humble.types:
        assert type_name(cls).split("/")[0] in ("ackermann_msgs", "vesc_msgs")
        return
    assert type_hash(cls) == humble.hash_rihs01(type_name(cls))


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
