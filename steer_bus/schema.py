"""A message's ``ros2msg`` schema text and RIHS01 type hash, derived from its class alone."""

import hashlib
import json
from typing import Any

from steerd.steer_bus.fields import (
    Array,
    Blob,
    Field,
    Kind,
    Nested,
    Scalar,
    Text,
    message_fields,
    per_class,
    type_name,
)

SEPARATOR = "=" * 80

# Type ids of the ROS 2 type description (type_description_interfaces/msg/FieldType).
_TYPE_IDS = {
    "int8": 2, "uint8": 3, "int16": 4, "uint16": 5, "int32": 6, "uint32": 7, "int64": 8,
    "uint64": 9, "float32": 10, "float64": 11, "bool": 15, "byte": 16,
}  # fmt: skip
_NESTED_ID, _STRING_ID = 1, 17
_ARRAY_OFFSET, _SEQUENCE_OFFSET = 48, 144


@per_class
def schema_text(cls: type[Any]) -> str:
    """Give the ``ros2msg`` text of a message, its dependencies appended as ROS does.

    Units stand as comments behind the fields. Dependencies follow once each, in order of first
    use, separated by 80 ``=`` and a line ``MSG: pkg/Name``.
    """
    return _own_text(cls) + "".join(
        f"{SEPARATOR}\nMSG: {_short_name(dependency)}\n{_own_text(dependency)}"
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
    capacity = kind.count if isinstance(kind, Array) else 0
    nested = type_name(kind.cls) if isinstance(kind, Nested) else ""
    return {
        "type_id": _type_id(kind),
        "capacity": capacity,
        "string_capacity": 0,
        "nested_type_name": nested,
    }


def _type_id(kind: Kind) -> int:
    match kind:
        case Scalar():
            return _TYPE_IDS[kind.ros]
        case Text():
            return _STRING_ID
        case Blob():
            return _TYPE_IDS["uint8"] + _SEQUENCE_OFFSET
        case Array():
            return _TYPE_IDS[kind.item.ros] + _ARRAY_OFFSET
        case Nested():
            return _NESTED_ID + (_SEQUENCE_OFFSET if kind.many else 0)
