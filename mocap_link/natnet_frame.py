"""NatNet FRAMEOFDATA (message 7), 2.9 to 4.2: one definition for reading and for writing.

Layout: `docs/reference/mocap-protocols.md#m3.2`. A frame is a row of counted sections and a suffix
of stamps. From 4.1 on each section carries its byte size, which lets a reader jump over what it
does not need and over what later versions may change; older frames must be walked.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from struct import Struct
from typing import NamedTuple, TypeVar

from steerd.mocap_link.natnet_wire import (
    F32,
    I32,
    MAX_COUNT,
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
from steerd.steer_bus.quick_values import quick_init

T = TypeVar("T")

TRACKING_VALID = 1
RECORDING, MODEL_CHANGED, EDIT_MODE, BITSTREAM_CHANGED = 1, 2, 4, 8

_BODY = Struct("<i3f4ffh")
_BODY2_HEAD = Struct("<i3f4f")
_BODY2_TAIL = Struct("<fh")
_LABELED = Struct("<i3ffhf")
_LABELED2 = Struct("<i3ffh")
_TIMECODE = Struct("<IId")
_TICKS = Struct("<3Q")
_STAMPS = Struct("<IId3Q")
"""Time code and ticks of a modern frame."""
_SECTION = Struct("<ii")
"""Head of a section that says its size: count, bytes."""
_SUFFIX = Struct("<hi")
_SUFFIX_PTP = Struct("<IIhi")
_BARE_HEAD = Struct(f"<i{2 * _SECTION.size}xii")
_BARE_TAIL = Struct(f"<{5 * _SECTION.size}x{_STAMPS.format[1:]}{_SUFFIX_PTP.format[1:]}")
"""Around the rigid bodies of a frame without anything else; the sections are so many zeros."""
_FEW = 8
"""So many bodies may be all that a frame holds."""


@quick_init
@dataclass(frozen=True, slots=True)
class RigidBody:
    """One body of a frame; `position` in the server's units, `quaternion` as (x, y, z, w)."""

    id: int
    position: Point
    quaternion: Quaternion
    mean_error: float = 0.0
    params: int = TRACKING_VALID

    @property
    def tracking_valid(self) -> bool:
        """Whether the server solved this body in this frame."""
        return bool(self.params & TRACKING_VALID)


class LabeledMarker(NamedTuple):
    """One marker; `id` = model << 16 | member, `residual` is absent (0) before 3.0."""

    id: int
    x: float
    y: float
    z: float
    size: float
    params: int
    residual: float = 0.0


@dataclass(frozen=True, slots=True)
class MarkerSet:
    """Named group of marker positions."""

    name: str
    points: tuple[Point, ...] = ()


@dataclass(frozen=True, slots=True)
class Skeleton:
    """Skeleton with its bones."""

    id: int
    bodies: tuple[RigidBody, ...] = ()


@dataclass(frozen=True, slots=True)
class Asset:
    """Trained-markerset asset (4.1 and later)."""

    id: int
    bodies: tuple[RigidBody, ...] = ()
    markers: tuple[LabeledMarker, ...] = ()


@dataclass(frozen=True, slots=True)
class Analog:
    """Force plate or device: samples per channel."""

    id: int
    channels: tuple[tuple[float, ...], ...] = ()


@quick_init
@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of motion capture data; tick fields count the server's clock."""

    number: int
    rigid_bodies: tuple[RigidBody, ...] = ()
    marker_sets: tuple[MarkerSet, ...] = ()
    other_markers: tuple[Point, ...] = ()
    skeletons: tuple[Skeleton, ...] = ()
    assets: tuple[Asset, ...] = ()
    labeled_markers: tuple[LabeledMarker, ...] = ()
    force_plates: tuple[Analog, ...] = ()
    devices: tuple[Analog, ...] = ()
    software_latency: float = 0.0
    timecode: int = 0
    timecode_sub: int = 0
    timestamp: float = 0.0
    mid_exposure_ticks: int = 0
    data_received_ticks: int = 0
    transmit_ticks: int = 0
    precision_secs: int = 0
    precision_frac: int = 0
    params: int = 0


_Read = Callable[[bytes, int, int], tuple[tuple[T, ...], int]]


def _section(data: bytes, at: int, sized: bool, read: _Read[T]) -> tuple[tuple[T, ...], int]:
    n, at = read_count(data, at)
    if not sized:
        return read(data, at, n) if n else ((), at)
    at, end = read_size(data, at)
    if not n:
        return (), end
    items, at = read(data, at, n)
    if at > end:
        raise NatNetError(f"section runs {at - end} bytes over its size")
    return items, end


def _jump_sections(data: bytes, at: int, count: int) -> int:
    """Offset behind sections that say their size and are not read."""
    for _ in range(count):
        n, size = _SECTION.unpack_from(data, at)
        end = at + _SECTION.size + size
        if not 0 <= n <= MAX_COUNT or size < 0 or end > len(data):
            read_size(data, read_count(data, at)[1])  # which says what is wrong
        at = end
    return at


def _read_marker_sets(data: bytes, at: int, n: int) -> tuple[tuple[MarkerSet, ...], int]:
    sets = []
    for _ in range(n):
        name, at = read_cstr(data, at)
        k, at = read_count(data, at)
        points, at = read_points(data, at, k)
        sets.append(MarkerSet(name, points))
    return tuple(sets), at


def _read_bodies(data: bytes, at: int, n: int) -> tuple[tuple[RigidBody, ...], int]:
    end = need(data, at, 38 * n)
    return tuple(
        RigidBody(i, (x, y, z), (qx, qy, qz, qw), err, params)
        for i, x, y, z, qx, qy, qz, qw, err, params in _BODY.iter_unpack(data[at:end])
    ), end


def _read_bodies2(data: bytes, at: int, n: int) -> tuple[tuple[RigidBody, ...], int]:
    bodies = []
    for _ in range(n):
        i, x, y, z, qx, qy, qz, qw = _BODY2_HEAD.unpack_from(data, at)
        k, at = read_count(data, at + _BODY2_HEAD.size)
        # k positions (12 B), k ids (4 B), k sizes (4 B): 3.0 moved them to the description
        at = need(data, at, 20 * k)
        err, params = _BODY2_TAIL.unpack_from(data, at)
        at += _BODY2_TAIL.size
        bodies.append(RigidBody(i, (x, y, z), (qx, qy, qz, qw), err, params))
    return tuple(bodies), at


def _read_skeletons(
    data: bytes, at: int, n: int, read_bodies: _Read[RigidBody]
) -> tuple[tuple[Skeleton, ...], int]:
    skeletons = []
    for _ in range(n):
        i, at = read_i32(data, at)
        k, at = read_count(data, at)
        bodies, at = read_bodies(data, at, k)
        skeletons.append(Skeleton(i, bodies))
    return tuple(skeletons), at


def _read_assets(data: bytes, at: int, n: int) -> tuple[tuple[Asset, ...], int]:
    assets = []
    for _ in range(n):
        i, at = read_i32(data, at)
        k, at = read_count(data, at)
        bodies, at = _read_bodies(data, at, k)
        m, at = read_count(data, at)
        markers, at = _read_labeled(data, at, m)
        assets.append(Asset(i, bodies, markers))
    return tuple(assets), at


def _read_labeled(data: bytes, at: int, n: int) -> tuple[tuple[LabeledMarker, ...], int]:
    end = need(data, at, _LABELED.size * n)
    return tuple(map(LabeledMarker._make, _LABELED.iter_unpack(data[at:end]))), end


def _read_labeled2(data: bytes, at: int, n: int) -> tuple[tuple[LabeledMarker, ...], int]:
    end = need(data, at, _LABELED2.size * n)
    return tuple(LabeledMarker(*m) for m in _LABELED2.iter_unpack(data[at:end])), end


def _read_analog(data: bytes, at: int, n: int) -> tuple[tuple[Analog, ...], int]:
    boards = []
    for _ in range(n):
        i, at = read_i32(data, at)
        k, at = read_count(data, at)
        channels = []
        for _ in range(k):
            m, at = read_count(data, at)
            end = need(data, at, 4 * m)
            channels.append(tuple(v for (v,) in F32.iter_unpack(data[at:end])))
            at = end
        boards.append(Analog(i, tuple(channels)))
    return tuple(boards), at


def _read_rigid_bodies(
    data: bytes, at: int, sized: bool, read_bodies: _Read[RigidBody]
) -> tuple[tuple[RigidBody, ...], int]:
    n, at = read_count(data, at)
    if not sized:
        return read_bodies(data, at, n)
    at, end = read_size(data, at)
    bodies, at = read_bodies(data, at, n)
    if at != end:
        raise NatNetError(f"{n} rigid bodies in a section of another size")
    return bodies, end


def read_frame(data: bytes, at: int, version: Version, *, detail: bool = True) -> Frame:
    """Decode the payload of FRAMEOFDATA.

    Args:
        data: the datagram, ending where the payload ends.
        at: offset of the payload.
        version: NatNet (major, minor) of the stream, from SERVERINFO.
        detail: False jumps over all sections but the rigid bodies where sizes allow it (4.1+).

    Raises:
        NatNetError: the bytes break the layout of `version`.
        struct.error: the datagram ends early (`natnet.decode` turns it into `NatNetError`).
    """
    modern, sized = version >= (3, 0), version >= (4, 1)
    if sized and not detail:
        return _read_bare_frame(data, at)
    read_bodies = _read_bodies if modern else _read_bodies2
    number, at = read_i32(data, at)
    marker_sets, at = _section(data, at, sized, _read_marker_sets)
    other, at = _section(data, at, sized, read_points)
    bodies, at = _read_rigid_bodies(data, at, sized, read_bodies)
    skeletons, at = _section(data, at, sized, lambda d, a, n: _read_skeletons(d, a, n, read_bodies))
    assets: tuple[Asset, ...] = ()
    if sized:
        assets, at = _section(data, at, sized, _read_assets)
    labeled, at = _section(data, at, sized, _read_labeled if modern else _read_labeled2)
    plates, at = _section(data, at, sized, _read_analog)
    devices: tuple[Analog, ...] = ()
    latency = 0.0
    mid = received = transmit = 0
    if modern:
        devices, at = _section(data, at, sized, _read_analog)
    else:
        (latency,) = F32.unpack_from(data, at)
        at += 4
    timecode, timecode_sub, timestamp = _TIMECODE.unpack_from(data, at)
    at += _TIMECODE.size
    if modern:
        mid, received, transmit = _TICKS.unpack_from(data, at)
        at += _TICKS.size
    secs, frac, params = _read_suffix(data, at)
    return Frame(
        number, bodies, marker_sets, other, skeletons, assets, labeled, plates, devices,
        latency, timecode, timecode_sub, timestamp, mid, received, transmit, secs, frac, params,
    )  # fmt: skip


def _read_bare_frame(data: bytes, at: int) -> Frame:
    """Number, rigid bodies and stamps of a frame whose sections say their sizes (4.1+)."""
    whole = _read_bodies_only(data, at)
    if whole is not None:
        return whole
    number, at = read_i32(data, at)
    at = _jump_sections(data, at, 2)  # marker sets, other markers
    bodies, at = _read_rigid_bodies(data, at, True, _read_bodies)
    at = _jump_sections(data, at, 5)  # skeletons, assets, labelled markers, plates, devices
    timecode, timecode_sub, timestamp, mid, received, transmit = _STAMPS.unpack_from(data, at)
    secs, frac, params = _read_suffix(data, at + _STAMPS.size)
    return Frame(
        number, bodies, (), (), (), (), (), (), (),
        0.0, timecode, timecode_sub, timestamp, mid, received, transmit, secs, frac, params,
    )  # fmt: skip


def _read_bodies_only(data: bytes, at: int) -> Frame | None:
    """A frame of 4.1 and later with few rigid bodies and nothing else, in one piece, or None.

    Whatever is wrong with a frame is for the general way to say.
    """
    left = len(data) - at - _bare_layout(0).size
    count = left // _BODY.size
    if not 0 <= count <= _FEW or count * _BODY.size != left:
        return None
    number, known, size = _BARE_HEAD.unpack_from(data, at)
    behind = at + _BARE_HEAD.size + left
    stamps = _BARE_TAIL.unpack_from(data, behind)
    if known != count or size != left or stamps[-1] or any(data[at + 4 : at + 20]):
        return None
    if any(data[behind : behind + 40]):
        return None
    bodies, _ = _read_bodies(data, at + _BARE_HEAD.size, count)
    return Frame(number, bodies, (), (), (), (), (), (), (), 0.0, *stamps[:-1])


def _read_suffix(data: bytes, at: int) -> tuple[int, int, int]:
    # The rest's length, not the version, shows whether the PTP stamp is there: decoders that
    # trust the version read the "models changed" bit from the stamp.
    left = len(data) - at
    if left == _SUFFIX_PTP.size:
        secs, frac, params, end = _SUFFIX_PTP.unpack_from(data, at)
    elif left == _SUFFIX.size:
        secs = frac = 0
        params, end = _SUFFIX.unpack_from(data, at)
    else:
        raise NatNetError(f"{left} bytes behind the stamps, expected 6 or 14")
    if end:
        raise NatNetError(f"end of data is {end}, expected 0")
    return secs, frac, params


def write_frame(frame: Frame, version: Version) -> bytes:
    """Encode the payload of FRAMEOFDATA in the layout of `version`.

    Fields that `version` does not have (assets before 4.1, ticks and devices before 3.0) are
    left out.

    Raises:
        struct.error: a value does not fit its field.
    """
    modern, sized = version >= (3, 0), version >= (4, 1)
    if sized and _is_bare(frame):
        return _write_bare_frame(frame)
    bodies = _write_bodies if modern else _write_bodies2

    def section(n: int, body: bytes) -> bytes:
        return (_SECTION.pack(n, len(body)) if sized else I32.pack(n)) + body

    f = frame
    parts = [
        I32.pack(f.number),
        section(len(f.marker_sets), b"".join(_write_marker_set(s) for s in f.marker_sets)),
        section(len(f.other_markers), write_points(f.other_markers)),
        section(len(f.rigid_bodies), bodies(f.rigid_bodies)),
        section(len(f.skeletons), b"".join(_group(s, bodies) for s in f.skeletons)),
    ]
    if sized:
        parts.append(section(len(f.assets), b"".join(_write_asset(a) for a in f.assets)))
    parts += [
        section(len(f.labeled_markers), _write_labeled(f.labeled_markers, modern)),
        section(len(f.force_plates), b"".join(map(_write_analog, f.force_plates))),
    ]
    if modern:
        parts.append(section(len(f.devices), b"".join(map(_write_analog, f.devices))))
    else:
        parts.append(F32.pack(f.software_latency))
    code = (f.timecode, f.timecode_sub, f.timestamp)
    ticks = (f.mid_exposure_ticks, f.data_received_ticks, f.transmit_ticks)
    parts.append(_STAMPS.pack(*code, *ticks) if modern else _TIMECODE.pack(*code))
    if sized:
        parts.append(_SUFFIX_PTP.pack(f.precision_secs, f.precision_frac, f.params, 0))
    else:
        parts.append(_SUFFIX.pack(f.params, 0))
    return b"".join(parts)


def _is_bare(f: Frame) -> bool:
    return not (
        f.marker_sets or f.other_markers or f.skeletons or f.assets or f.labeled_markers
        or f.force_plates or f.devices
    )  # fmt: skip


def _write_bare_frame(f: Frame) -> bytes:
    """A frame of 4.1 and later with rigid bodies and nothing else, in one piece."""
    count = len(f.rigid_bodies)
    bodies = [
        value
        for b in f.rigid_bodies
        for value in (b.id, *b.position, *b.quaternion, b.mean_error, b.params)
    ]
    return _bare_layout(count).pack(
        f.number, count, count * _BODY.size, *bodies,
        f.timecode, f.timecode_sub, f.timestamp,
        f.mid_exposure_ticks, f.data_received_ticks, f.transmit_ticks,
        f.precision_secs, f.precision_frac, f.params, 0,
    )  # fmt: skip


@lru_cache(maxsize=32)
def _bare_layout(bodies: int) -> Struct:
    """Two empty sections before the bodies and five behind them are so many zeros."""
    body, stamps, suffix = (each.format[1:] for each in (_BODY, _STAMPS, _SUFFIX_PTP))
    empty = _SECTION.size
    return Struct(f"<i{2 * empty}xii{body * bodies}{5 * empty}x{stamps}{suffix}")


def _write_marker_set(s: MarkerSet) -> bytes:
    return write_cstr(s.name) + I32.pack(len(s.points)) + write_points(s.points)


def _write_bodies(bodies: tuple[RigidBody, ...]) -> bytes:
    return b"".join(
        _BODY.pack(b.id, *b.position, *b.quaternion, b.mean_error, b.params) for b in bodies
    )


def _write_bodies2(bodies: tuple[RigidBody, ...]) -> bytes:
    return b"".join(
        _BODY2_HEAD.pack(b.id, *b.position, *b.quaternion)
        + I32.pack(0)
        + _BODY2_TAIL.pack(b.mean_error, b.params)
        for b in bodies
    )


def _group(
    group: Skeleton | Asset, write_bodies: Callable[[tuple[RigidBody, ...]], bytes]
) -> bytes:
    return I32.pack(group.id) + I32.pack(len(group.bodies)) + write_bodies(group.bodies)


def _write_asset(asset: Asset) -> bytes:
    markers = I32.pack(len(asset.markers)) + _write_labeled(asset.markers, modern=True)
    return _group(asset, _write_bodies) + markers


def _write_labeled(markers: tuple[LabeledMarker, ...], modern: bool) -> bytes:
    if modern:
        return b"".join(_LABELED.pack(*m) for m in markers)
    return b"".join(_LABELED2.pack(*m[:6]) for m in markers)


def _write_analog(board: Analog) -> bytes:
    parts = [I32.pack(board.id), I32.pack(len(board.channels))]
    for channel in board.channels:
        parts.append(I32.pack(len(channel)))
        parts += [F32.pack(v) for v in channel]
    return b"".join(parts)
