"""The ROS 2 types that a message field can have, carried by ``Annotated`` aliases.

A message is a frozen dataclass made by :func:`message`; its field types say how it goes on the
wire and, where a field is a quantity, in which unit::

    @message("steerd_msgs/msg/Tick")
    class Tick:
        header: Header
        work_ns: Nanosecond

`steerd.steer_bus.codec` derives the packing from this and `steerd.steer_bus.schema` the
text.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import (
    Annotated,
    Any,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

from steerd.steer_bus.quick_values import quick_init


@dataclass(frozen=True, slots=True)
class Scalar:
    """A ROS primitive: its name, its ``struct`` code and its size in bytes (= its alignment)."""

    ros: str
    code: str
    size: int


@dataclass(frozen=True, slots=True)
class Text:
    """A ROS ``string``: ``uint32`` length with the NUL, UTF-8 bytes, NUL."""


@dataclass(frozen=True, slots=True)
class Blob:
    """A ROS ``uint8[]``, held as ``bytes``."""


@dataclass(frozen=True, slots=True)
class Array:
    """A fixed-length array of ``count`` primitives, held as a tuple."""

    item: Scalar
    count: int


@dataclass(frozen=True, slots=True)
class Nested:
    """Another message in place, or (``many``) a sequence of it held as a tuple."""

    cls: type[Any]
    many: bool = False


Kind = Scalar | Text | Blob | Array | Nested

_FLOAT64 = Scalar("float64", "d", 8)

Float64 = Annotated[float, _FLOAT64]
Float32 = Annotated[float, Scalar("float32", "f", 4)]
Int64 = Annotated[int, Scalar("int64", "q", 8)]
UInt64 = Annotated[int, Scalar("uint64", "Q", 8)]
Int32 = Annotated[int, Scalar("int32", "i", 4)]
UInt32 = Annotated[int, Scalar("uint32", "I", 4)]
Int16 = Annotated[int, Scalar("int16", "h", 2)]
UInt16 = Annotated[int, Scalar("uint16", "H", 2)]
UInt8 = Annotated[int, Scalar("uint8", "B", 1)]
Byte = Annotated[int, Scalar("byte", "B", 1)]
Bool = Annotated[bool, Scalar("bool", "?", 1)]
String = Annotated[str, Text()]
Bytes = Annotated[bytes, Blob()]
Float64x36 = Annotated[tuple[float, ...], Array(_FLOAT64, 36)]

Metre = Annotated[Float64, "m"]
MetrePerSecond = Annotated[Float64, "m/s"]
MetrePerSecond2 = Annotated[Float64, "m/s^2"]
Radian = Annotated[Float64, "rad"]
RadianPerSecond = Annotated[Float64, "rad/s"]
PerMetre = Annotated[Float64, "1/m"]
PerRadian = Annotated[Float64, "1/rad"]
Second = Annotated[Float64, "s"]
KilogramMetre2 = Annotated[Float64, "kg m^2"]
Ampere = Annotated[Float64, "A"]
Volt = Annotated[Float64, "V"]
Celsius = Annotated[Float64, "degC"]
Unitless = Annotated[Float64, "1"]
Nanosecond = Annotated[Int64, "ns"]
Millisecond = Annotated[Int64, "ms"]


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message: name, wire kind, and unit or meaning (empty if none is given)."""

    name: str
    kind: Kind
    unit: str


@dataclass(frozen=True, slots=True)
class Leaf:
    """A field of a flattened message, named by its dotted path from the root."""

    path: str
    kind: Scalar | Text | Blob | Array


C = TypeVar("C")
R = TypeVar("R")


def per_class(derive: Callable[[type[Any]], R]) -> Callable[[type[Any]], R]:
    """Remember what a function derives from a message class."""
    known: dict[type[Any], R] = {}

    @functools.wraps(derive)
    def derive_once(cls: type[Any]) -> R:
        try:
            return known[cls]
        except KeyError:
            return known.setdefault(cls, derive(cls))

    return derive_once


@dataclass_transform(frozen_default=True)
def message(ros_type: str) -> Callable[[type[C]], type[C]]:
    """Make a class a frozen, slotted message of the ROS type ``pkg/msg/Name``; no defaults."""

    def decorate(cls: type[C]) -> type[C]:
        made = dataclass(frozen=True, slots=True)(cls)
        made.__ros_type__ = ros_type  # type: ignore[attr-defined]
        return quick_init(made)

    return decorate


def type_name(cls: type[Any]) -> str:
    """Give the ROS type ``pkg/msg/Name`` of a message class.

    Raises:
        TypeError: if the class was not made by :func:`message`.
    """
    name = getattr(cls, "__ros_type__", None)
    if not isinstance(name, str):
        raise TypeError(f"{cls!r} is not a message class")
    return name


@per_class
def message_fields(cls: type[Any]) -> tuple[Field, ...]:
    """Give the fields of a message class in wire order.

    Raises:
        TypeError: if the class is no message, has no field, or a field has no ROS type.
    """
    name = type_name(cls)
    hints = get_type_hints(cls, include_extras=True)
    found = tuple(_field(name, f.name, hints[f.name]) for f in fields(cls))
    if not found:
        raise TypeError(f"{name} has no field")
    return found


@per_class
def flat_leaves(cls: type[Any]) -> tuple[Leaf, ...] | None:
    """Give a message's leaves in wire order, or None if it holds a sequence of messages."""
    leaves: list[Leaf] = []
    for field in message_fields(cls):
        if not isinstance(field.kind, Nested):
            leaves.append(Leaf(field.name, field.kind))
            continue
        inner = None if field.kind.many else flat_leaves(field.kind.cls)
        if inner is None:
            return None
        leaves += (Leaf(f"{field.name}.{leaf.path}", leaf.kind) for leaf in inner)
    return tuple(leaves)


def _field(owner: str, name: str, hint: Any) -> Field:
    if get_origin(hint) is Annotated:
        notes = get_args(hint)[1:]
        kinds = [n for n in notes if isinstance(n, Scalar | Text | Blob | Array)]
        units = [n for n in notes if isinstance(n, str)]
        if kinds:
            return Field(name, kinds[0], units[0] if units else "")
    if hasattr(hint, "__ros_type__"):
        return Field(name, Nested(hint), "")
    args = get_args(hint)
    if get_origin(hint) is tuple and len(args) == 2 and hasattr(args[0], "__ros_type__"):
        return Field(name, Nested(args[0], many=True), "")
    raise TypeError(f"{owner}.{name}: {hint!r} has no ROS type")
