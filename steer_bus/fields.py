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
import typing
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, TypeVar, cast, dataclass_transform

from steerd.steer_bus.quick_values import quick_value


@dataclass(frozen=True, slots=True)
class Scalar:
    """A ROS primitive, or a fixed-length array of it, held as a tuple."""

    ros: str  # its type in a schema
    type_id: int  # in a type description (type_description_interfaces/msg/FieldType)
    code: str  # ``struct`` code of one number
    size: int  # of one number in bytes, which is also its alignment
    count: int = 0  # numbers of an array; 0 for one alone


@dataclass(frozen=True, slots=True)
class Sized:
    """Bytes behind their ``uint32`` length: a ROS ``string`` with its NUL, or ``uint8[]``."""

    ros: str
    type_id: int
    is_text: bool  # held as ``str``, in UTF-8, else as ``bytes``


@dataclass(frozen=True, slots=True)
class Nested:
    """Another message in place, or (``many``) a sequence of it held as a tuple."""

    cls: type[Any]
    many: bool = False

    @property
    def ros(self) -> str:
        """Its type in a schema."""
        return _short_name(self.cls) + ("[]" if self.many else "")

    @property
    def type_id(self) -> int:
        """In a type description."""
        return 145 if self.many else 1


Kind = Scalar | Sized | Nested

Float64 = Annotated[float, Scalar("float64", 11, "d", 8)]
Float32 = Annotated[float, Scalar("float32", 10, "f", 4)]
Int64 = Annotated[int, Scalar("int64", 8, "q", 8)]
UInt64 = Annotated[int, Scalar("uint64", 9, "Q", 8)]
Int32 = Annotated[int, Scalar("int32", 6, "i", 4)]
UInt32 = Annotated[int, Scalar("uint32", 7, "I", 4)]
UInt16 = Annotated[int, Scalar("uint16", 5, "H", 2)]
UInt8 = Annotated[int, Scalar("uint8", 3, "B", 1)]
Byte = Annotated[int, Scalar("byte", 16, "B", 1)]
String = Annotated[str, Sized("string", 17, is_text=True)]
Bytes = Annotated[bytes, Sized("uint8[]", 147, is_text=False)]
Float64x36 = Annotated[tuple[float, ...], Scalar("float64[36]", 59, "d", 8, 36)]


@dataclass(frozen=True, slots=True)
class Field:
    """One field of a message: name, wire kind, and unit or meaning (empty if none is given)."""

    name: str
    kind: Kind
    unit: str


C = TypeVar("C")
R = TypeVar("R")


def cached(derive: Callable[[type[Any]], R]) -> Callable[[type[Any]], R]:
    """Remember what a function derives from a message class."""
    return cast("Callable[[type[Any]], R]", functools.cache(derive))


@dataclass_transform(frozen_default=True)
def message(ros_type: str) -> Callable[[type[C]], type[C]]:
    """Make a class a frozen, slotted message of the ROS type ``pkg/msg/Name``; no defaults."""

    def decorate(cls: type[C]) -> type[C]:
        cls.__ros_type__ = ros_type  # type: ignore[attr-defined]
        return quick_value(cls)

    return decorate


def type_name(cls: type[Any]) -> str:
    """The ROS type ``pkg/msg/Name`` of a message class; TypeError if it is none."""
    name = getattr(cls, "__ros_type__", None)
    if not isinstance(name, str):
        raise TypeError(f"{cls!r} is not a message class")
    return name


@cached
def message_fields(cls: type[Any]) -> tuple[Field, ...]:
    """Give the fields of a message class in wire order.

    Raises:
        TypeError: if the class is no message, has no field, or a field has no ROS type.
    """
    name = type_name(cls)
    hints = typing.get_type_hints(cls, include_extras=True)
    found = tuple(_field(name, f.name, hints[f.name]) for f in fields(cls))
    if not found:
        raise TypeError(f"{name} has no field")
    return found


@cached
def leaves_of(cls: type[Any]) -> tuple[Field, ...]:
    """Give a message's fields in wire order, those of a message inside it by their dotted path."""
    found: list[Field] = []
    for field in message_fields(cls):
        if isinstance(field.kind, Nested) and not field.kind.many:
            inner = leaves_of(field.kind.cls)
            found += (replace(leaf, name=f"{field.name}.{leaf.name}") for leaf in inner)
        else:
            found.append(field)
    return tuple(found)


def flat_leaves(cls: type[Any]) -> tuple[Field, ...] | None:
    """Give a message's leaves, or None if it holds a sequence of messages."""
    found = leaves_of(cls)
    return None if any(isinstance(leaf.kind, Nested) for leaf in found) else found


def _field(owner: str, name: str, hint: Any) -> Field:
    notes, args = getattr(hint, "__metadata__", ()), typing.get_args(hint)
    for kind in notes:
        if isinstance(kind, Scalar | Sized):
            return Field(name, kind, next((n for n in notes if isinstance(n, str)), ""))
    if hasattr(hint, "__ros_type__"):
        return Field(name, Nested(hint), "")
    if typing.get_origin(hint) is tuple and len(args) == 2 and hasattr(args[0], "__ros_type__"):
        return Field(name, Nested(args[0], many=True), "")
    raise TypeError(f"{owner}.{name}: {hint!r} has no ROS type")


# -- a message in the words of ROS ----------------------------------------------------------------


@cached
def schema_text(cls: type[Any]) -> str:
    """Give the ``ros2msg`` text of a message, its dependencies appended as ROS does.

    Units stand as comments behind the fields. Dependencies follow once each, in order of first
    use, separated by 80 ``=`` and a line ``MSG: pkg/Name``.
    """
    return _own_text(cls) + "".join(
        f"{'=' * 80}\nMSG: {_short_name(dependency)}\n{_own_text(dependency)}"
        for dependency in _dependencies(cls)
    )


@cached
def type_hash(cls: type[Any]) -> str:
    """Give the RIHS01 hash (``RIHS01_`` + 64 hex digits) by which rmw_zenoh keys a topic.

    Source: REP-2011 / rosidl: SHA-256 over the JSON of the type description without defaults.
    """
    others = [_description(d) for d in sorted(_dependencies(cls), key=type_name)]
    described = {"type_description": _description(cls), "referenced_type_descriptions": others}
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
    units = ((f, f"  # {f.unit}" if f.unit else "") for f in message_fields(cls))
    return "".join(f"{field.kind.ros} {field.name}{unit}\n" for field, unit in units)


def _short_name(cls: type[Any]) -> str:
    package, _, name = type_name(cls).split("/")
    return f"{package}/{name}"


def _description(cls: type[Any]) -> dict[str, Any]:
    described = []
    for field in message_fields(cls):
        kind = field.kind
        of_type = {
            "type_id": kind.type_id,
            "capacity": kind.count if isinstance(kind, Scalar) else 0,
            "string_capacity": 0,
            "nested_type_name": type_name(kind.cls) if isinstance(kind, Nested) else "",
        }
        described.append({"name": field.name, "type": of_type})
    return {"type_name": type_name(cls), "fields": described}
