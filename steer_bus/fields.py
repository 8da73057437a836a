"""What a message class is: its ROS 2 types, carried by ``Annotated`` aliases, and its schema.

A message is a frozen dataclass made by :func:`message`; its field types say how it goes on the
wire and, where a field is a quantity, in which unit::

    @message("steerd_msgs/msg/Tick")
    class Tick:
        header: Header
        work_ns: Nanosecond

The ``ros2msg`` text and the RIHS01 hash are derived from the class alone, and the packing too
(`steerd.steer_bus.codec`).
"""

import functools
import hashlib
import json
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
    """A ROS primitive.

    Attributes:
        ros: its name.
        code: its ``struct`` code.
        size: in bytes, which is also its alignment.
        type_id: in a type description (type_description_interfaces/msg/FieldType).
    """

    ros: str
    code: str
    size: int
    type_id: int


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

_FLOAT64, _BYTE = Scalar("float64", "d", 8, 11), Scalar("uint8", "B", 1, 3)

Float64 = Annotated[float, _FLOAT64]
Float32 = Annotated[float, Scalar("float32", "f", 4, 10)]
Int64 = Annotated[int, Scalar("int64", "q", 8, 8)]
UInt64 = Annotated[int, Scalar("uint64", "Q", 8, 9)]
Int32 = Annotated[int, Scalar("int32", "i", 4, 6)]
UInt32 = Annotated[int, Scalar("uint32", "I", 4, 7)]
Int16 = Annotated[int, Scalar("int16", "h", 2, 4)]
UInt16 = Annotated[int, Scalar("uint16", "H", 2, 5)]
UInt8 = Annotated[int, _BYTE]
Byte = Annotated[int, Scalar("byte", "B", 1, 16)]
String = Annotated[str, Text()]
Bytes = Annotated[bytes, Blob()]
Float64x36 = Annotated[tuple[float, ...], Array(_FLOAT64, 36)]


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


# -- a message in the words of ROS ----------------------------------------------------------------

_SEPARATOR = "=" * 80
_NESTED_ID, _STRING_ID = 1, 17
_ARRAY_OFFSET, _SEQUENCE_OFFSET = 48, 144


@per_class
def schema_text(cls: type[Any]) -> str:
    """Give the ``ros2msg`` text of a message, its dependencies appended as ROS does.

    Units stand as comments behind the fields. Dependencies follow once each, in order of first
    use, separated by 80 ``=`` and a line ``MSG: pkg/Name``.
    """
    return _own_text(cls) + "".join(
        f"{_SEPARATOR}\nMSG: {_short_name(dependency)}\n{_own_text(dependency)}"
        for dependency in _dependencies(cls)
    )


@per_class
def type_hash(cls: type[Any]) -> str:
    """Give the RIHS01 hash (``RIHS01_`` + 64 hex digits) by which rmw_zenoh keys a topic.

    Source: REP-2011 / rosidl: SHA-256 over the JSON of the type description without defaults.
    """
    described = {
        "type_description": _description(cls),
        "referenced_type_descriptions": [
            _description(d) for d in sorted(_dependencies(cls), key=type_name)
        ],
    }
    text = json.dumps(described, separators=(", ", ": "), ensure_ascii=True)
    return "RIHS01_" + hashlib.sha256(text.encode()).hexdigest()


def _dependencies(cls: type[Any]) -> list[type[Any]]:
    found: list[type[Any]] = []
    for field in message_fields(cls):
        if isinstance(field.kind, Nested):
            for dependency in (field.kind.cls, *_dependencies(field.kind.cls)):
                if dependency not in found:
                    found.append(dependency)
    return found


def _own_text(cls: type[Any]) -> str:
    return "".join(_line(field) for field in message_fields(cls))


def _line(field: Field) -> str:
    line = f"{_ros_text(field.kind)} {field.name}"
    return f"{line}  # {field.unit}\n" if field.unit else f"{line}\n"


def _ros_text(kind: Kind) -> str:
    match kind:
        case Scalar():
            return kind.ros
        case Text():
            return "string"
        case Blob():
            return "uint8[]"
        case Array():
            return f"{kind.item.ros}[{kind.count}]"
        case Nested():
            return _short_name(kind.cls) + ("[]" if kind.many else "")


def _short_name(cls: type[Any]) -> str:
    package, _, name = type_name(cls).split("/")
    return f"{package}/{name}"


def _description(cls: type[Any]) -> dict[str, Any]:
    return {
        "type_name": type_name(cls),
        "fields": [{"name": f.name, "type": _field_type(f.kind)} for f in message_fields(cls)],
    }


def _field_type(kind: Kind) -> dict[str, Any]:
    return {
        "type_id": _type_id(kind),
        "capacity": kind.count if isinstance(kind, Array) else 0,
        "string_capacity": 0,
        "nested_type_name": type_name(kind.cls) if isinstance(kind, Nested) else "",
    }


def _type_id(kind: Kind) -> int:
    match kind:
        case Scalar():
            return kind.type_id
        case Text():
            return _STRING_ID
        case Blob():
            return _BYTE.type_id + _SEQUENCE_OFFSET
        case Array():
            return kind.item.type_id + _ARRAY_OFFSET
        case Nested():
            return _NESTED_ID + (_SEQUENCE_OFFSET if kind.many else 0)
