"""NatNet MODELDEF (message 5): what the server streams, by name.

Layout: `docs/reference/mocap-protocols.md#m3.3`. From 4.1 on each item carries its size and is
always jumped by it; before, an unknown kind ends the list, and what was read until then is kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from steerd.mocap_link.natnet_wire import (
    I32,
    VEC3,
    VEC4,
    NatNetError,
    Point,
    Quaternion,
    Version,
    need,
    read_count,
    read_cstr,
    read_i32,
    read_points,
    read_size,
    write_cstr,
    write_points,
)

_MARKER_SET, _RIGID_BODY, _SKELETON, _CAMERA = 0, 1, 2, 5


@dataclass(frozen=True, slots=True)
class MarkerSetDesc:
    """Names of a marker set's markers."""

    name: str
    markers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class RigidBodyDesc:
    """A body's streaming id and geometry; `quaternion` (x, y, z, w) exists from 4.2 on."""

    name: str
    id: int
    parent_id: int = -1
    offset: Point = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    marker_positions: tuple[Point, ...] = ()
    marker_labels: tuple[int, ...] = ()
    marker_names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class SkeletonDesc:
    """A skeleton and its bones."""

    name: str
    id: int
    bodies: tuple[RigidBodyDesc, ...] = ()


@dataclass(frozen=True, slots=True)
class CameraDesc:
    """A camera's name and pose."""

    name: str
    position: Point
    quaternion: Quaternion


@dataclass(frozen=True, slots=True)
class OpaqueDesc:
    """An item of a kind we do not need (force plate, device, asset), kept as bytes."""

    kind: int
    body: bytes = b""


Description = MarkerSetDesc | RigidBodyDesc | SkeletonDesc | CameraDesc | OpaqueDesc


@dataclass(frozen=True, slots=True)
class ModelDef:
    """All descriptions; `complete` is False where an unknown kind before 4.1 ended the list."""

    items: tuple[Description, ...] = ()
    complete: bool = True

    @property
    def rigid_bodies(self) -> tuple[RigidBodyDesc, ...]:
        """The rigid bodies, in the server's order."""
        return tuple(i for i in self.items if isinstance(i, RigidBodyDesc))


def read_model_def(data: bytes, at: int, version: Version) -> ModelDef:
    """Decode the payload of MODELDEF.

    Raises:
        NatNetError: the bytes break the layout of `version`.
        struct.error: the datagram ends early (`natnet.decode` turns it into `NatNetError`).
    """
    n, at = read_count(data, at)
    items: list[Description] = []
    for _ in range(n):
        kind, at = read_i32(data, at)
        if version >= (4, 1):
            start, end = read_size(data, at)
            items.append(_read_sized(data, kind, start, end, version))
            at = end
            continue
        reader = _READERS.get(kind)
        if reader is None:
            return ModelDef(tuple(items), complete=False)
        item, at = reader(data, at, version)
        items.append(item)
    return ModelDef(tuple(items))


def _read_sized(data: bytes, kind: int, start: int, end: int, version: Version) -> Description:
    reader = _READERS.get(kind)
    if reader is None:
        return OpaqueDesc(kind, data[start:end])
    item, at = reader(data, start, version)
    if at > end:
        raise NatNetError(f"description runs {at - end} bytes over its size")
    return item


def _read_names(data: bytes, at: int, n: int) -> tuple[tuple[str, ...], int]:
    names = []
    for _ in range(n):
        name, at = read_cstr(data, at)
        names.append(name)
    return tuple(names), at


def _read_marker_set(data: bytes, at: int, version: Version) -> tuple[MarkerSetDesc, int]:
    name, at = read_cstr(data, at)
    n, at = read_count(data, at)
    markers, at = _read_names(data, at, n)
    return MarkerSetDesc(name, markers), at


def _read_rigid_body(data: bytes, at: int, version: Version) -> tuple[RigidBodyDesc, int]:
    name, at = read_cstr(data, at)
    body_id, at = read_i32(data, at)
    parent, at = read_i32(data, at)
    offset: Point = VEC3.unpack_from(data, at)
    at += VEC3.size
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    positions: tuple[Point, ...] = ()
    labels: tuple[int, ...] = ()
    names: tuple[str, ...] = ()
    if version >= (4, 2):
        quaternion = VEC4.unpack_from(data, at)
        at += VEC4.size
    if version >= (3, 0):
        k, at = read_count(data, at)
        positions, at = read_points(data, at, k)
        end = need(data, at, 4 * k)
        labels = tuple(v for (v,) in I32.iter_unpack(data[at:end]))
        at = end
        if version >= (4, 0):
            names, at = _read_names(data, at, k)
    return RigidBodyDesc(name, body_id, parent, offset, quaternion, positions, labels, names), at


def _read_skeleton(data: bytes, at: int, version: Version) -> tuple[SkeletonDesc, int]:
    name, at = read_cstr(data, at)
    skeleton_id, at = read_i32(data, at)
    n, at = read_count(data, at)
    bones = []
    for _ in range(n):
        bone, at = _read_rigid_body(data, at, version)
        bones.append(bone)
    return SkeletonDesc(name, skeleton_id, tuple(bones)), at


def _read_camera(data: bytes, at: int, version: Version) -> tuple[CameraDesc, int]:
    name, at = read_cstr(data, at)
    position = VEC3.unpack_from(data, at)
    quaternion = VEC4.unpack_from(data, at + VEC3.size)
    return CameraDesc(name, position, quaternion), at + VEC3.size + VEC4.size


_READERS: dict[int, Callable[[bytes, int, Version], tuple[Description, int]]] = {
    _MARKER_SET: _read_marker_set,
    _RIGID_BODY: _read_rigid_body,
    _SKELETON: _read_skeleton,
    _CAMERA: _read_camera,
}


def write_model_def(model: ModelDef, version: Version) -> bytes:
    """Encode the payload of MODELDEF in the layout of `version`."""
    parts = [I32.pack(len(model.items))]
    for item in model.items:
        kind, body = _write_item(item, version)
        parts.append(I32.pack(kind))
        if version >= (4, 1):
            parts.append(I32.pack(len(body)))
        parts.append(body)
    return b"".join(parts)


def _write_item(item: Description, version: Version) -> tuple[int, bytes]:
    match item:
        case MarkerSetDesc():
            names = b"".join(map(write_cstr, item.markers))
            return _MARKER_SET, write_cstr(item.name) + I32.pack(len(item.markers)) + names
        case RigidBodyDesc():
            return _RIGID_BODY, _write_rigid_body(item, version)
        case SkeletonDesc():
            head = write_cstr(item.name) + I32.pack(item.id) + I32.pack(len(item.bodies))
            return _SKELETON, head + b"".join(_write_rigid_body(b, version) for b in item.bodies)
        case CameraDesc():
            pose = VEC3.pack(*item.position) + VEC4.pack(*item.quaternion)
            return _CAMERA, write_cstr(item.name) + pose
        case OpaqueDesc():
            return item.kind, item.body


def _write_rigid_body(body: RigidBodyDesc, version: Version) -> bytes:
    parts = [write_cstr(body.name), I32.pack(body.id), I32.pack(body.parent_id)]
    parts.append(VEC3.pack(*body.offset))
    if version >= (4, 2):
        parts.append(VEC4.pack(*body.quaternion))
    if version >= (3, 0):
        k = len(body.marker_positions)
        parts += [I32.pack(k), write_points(body.marker_positions)]
        labels = (*body.marker_labels, *(0 for _ in range(k)))[:k]
        parts += [I32.pack(label) for label in labels]
        if version >= (4, 0):
            names = (*body.marker_names, *("" for _ in range(k)))[:k]
            parts += [write_cstr(name) for name in names]
    return b"".join(parts)
