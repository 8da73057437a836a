"""Primitives of the NatNet wire, and FRAMEOFDATA (message 7), 2.9 to 4.2: rigid bodies and stamps.

Little-endian, packed, NUL-terminated UTF-8 strings. Every read is bounds-checked: `struct` refuses
to read past the end, counts are capped, and a missing NUL is an error. `NatNetError` is the only
exception that decoding lets out. A frame (`docs/reference/mocap-protocols.md#m3.2`) is a row of
counted sections and a suffix of stamps. Markers, skeletons, assets, force plates and devices are
passed over: from 4.1 on by the size that each section carries, before by walking its items.
Written frames have none of them.
"""

from struct import Struct
from typing import Any

from steerd.steer_bus.quick_values import quick_value

MAX_COUNT = 10_000
"""No section of a real frame has more items; a larger count is corruption."""

Version = tuple[int, int]

HEADER = Struct("<HH")
I32 = Struct("<i")
F32 = Struct("<f")
U64 = Struct("<Q")
SECTION = Struct("<ii")
"""Head of a section that says its size: count, bytes."""
Layout = int | None | tuple["Layout", ...] | list["Layout"]
"""What is passed over: so many bytes; None: a string; a tuple: one after the other; a list: a count
and each of its parts so often."""


class NatNetError(ValueError):
    """Bytes that are not a NatNet message of the stated version."""


class Reader:
    """A datagram to its `end`, and the offset `at` behind what was read; begins behind the header.

    Bytes beyond the length in the header are ignored, missing ones refused. Every method reads on,
    and raises `NatNetError` where the bytes are not what it reads, or `struct.error` where the
    datagram ends early (`natnet.decode` turns it into `NatNetError`).
    """

    __slots__ = ("at", "data", "end", "message_id")

    def __init__(self, data: bytes) -> None:
        self.message_id, size = HEADER.unpack_from(data)
        end = HEADER.size + size
        if len(data) < end:
            raise NatNetError(f"datagram ends at {len(data)}, {end} needed")
        self.data, self.at, self.end = data[:end], HEADER.size, end

    def unpack(self, layout: Struct) -> tuple[Any, ...]:
        """A structure's values."""
        values = layout.unpack_from(self.data, self.at)
        self.at += layout.size
        return values

    def i32(self) -> int:
        """A signed 32-bit integer."""
        (value,) = I32.unpack_from(self.data, self.at)
        self.at += 4
        return int(value)

    def count(self) -> int:
        """An item count, at most `MAX_COUNT`."""
        (n,) = I32.unpack_from(self.data, self.at)
        if not 0 <= n <= MAX_COUNT:
            raise NatNetError(f"count {n} at byte {self.at}")
        self.at += 4
        return int(n)

    def sized(self) -> int:
        """A byte size; the offset behind what has this size."""
        (size,) = I32.unpack_from(self.data, self.at)
        end = self.at + 4 + size
        if size < 0 or end > self.end:
            raise NatNetError(f"section of {size} bytes at byte {self.at}")
        self.at += 4
        return int(end)

    def take(self, size: int) -> bytes:
        """So many bytes."""
        start, self.at = self.at, self.at + size
        if self.at > self.end:
            raise NatNetError(f"datagram ends at {self.end}, {self.at} needed")
        return self.data[start : self.at]

    def string(self) -> str:
        """A NUL-terminated string."""
        end = self.data.find(0, self.at)
        if end < 0:
            raise NatNetError(f"unterminated string at byte {self.at}")
        start, self.at = self.at, end + 1
        return self.data[start:end].decode("utf-8", "replace")

    def skip(self, layout: Layout) -> None:
        """Pass over what a layout describes."""
        if layout is None:
            self.string()
        elif isinstance(layout, int):
            self.take(layout)
        else:
            n = self.count() if isinstance(layout, list) else 1
            for part in layout:
                if isinstance(part, int):
                    self.take(n * part)
                else:
                    for _ in range(n):
                        self.skip(part)


def read_name(data: bytes) -> str:
    """Read a name of fixed width; Motive leaves stack garbage behind its NUL."""
    return data.split(b"\0", 1)[0].decode("utf-8", "replace")


def write_cstr(text: str) -> bytes:
    """Encode a NUL-terminated string; embedded NULs would end it early and are dropped."""
    return text.replace("\0", "").encode() + b"\0"


def write_name(text: str, width: int) -> bytes:
    """Encode a fixed-width name, always with a closing NUL."""
    return text.encode()[: width - 1].ljust(width, b"\0")


# -- FRAMEOFDATA ------------------------------------------------------------------------------

TRACKING_VALID = 1
RECORDING, MODEL_CHANGED, EDIT_MODE, BITSTREAM_CHANGED = 1, 2, 4, 8

Point = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]

_BODY = Struct("<i3f4ffh")
_BODY2_HEAD = Struct("<i3f4f")
_BODY2_TAIL = Struct("<fh")
_TIMECODE = Struct("<IId")
_STAMPS = Struct("<IId3Q")
"""Time code and ticks of a modern frame."""
_SUFFIX = Struct("<hi")
_SUFFIX_PTP = Struct("<IIhi")
_HEAD = Struct("<i8xi")
_HEAD_SIZED = Struct("<i16xii")
"""What is written before the bodies: frame number, two empty sections, number of bodies."""
_TAIL2 = Struct("<16xIIdhi")
_TAIL = Struct("<16xIId3Qhi")
_TAIL_SIZED = Struct("<40xIId3QIIhi")
"""And behind them: empty sections (before 3.0 a latency of 0 as the last), stamps and suffix."""


@quick_value
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


@quick_value
class Frame:
    """One frame of motion capture data; tick fields count the server's clock.

    Before 3.0 there are no ticks: they are 0 then, and `timestamp` [s since start] stands alone.
    """

    number: int
    rigid_bodies: tuple[RigidBody, ...] = ()
    timestamp: float = 0.0
    mid_exposure_ticks: int = 0
    data_received_ticks: int = 0
    transmit_ticks: int = 0
    params: int = 0


_PLATES: Layout = [(4, [[4]])]
"""Boards (an id each) with channels of samples: force plates, and devices."""
_BEFORE: Layout = ([(None, [12])], [12])
"""Before the bodies, where sections do not say their size: marker sets, other markers."""
_BEHIND2: Layout = ([(4, [(_BODY2_HEAD.size, [20], _BODY2_TAIL.size)])], [22], _PLATES, 4)
_BEHIND: Layout = ([(4, [_BODY.size])], [26], _PLATES, _PLATES)
"""Behind them: skeletons (an id, bodies), labelled markers, plates; then devices, before 3.0 the
software latency. 3.0 moved a body's markers (place, id, size) to its description."""


def read_frame(r: Reader, version: Version) -> Frame:
    """Decode the payload of FRAMEOFDATA of a stream of `version`, which SERVERINFO says.

    Raises:
        NatNetError, struct.error: as the reader does.
    """
    number = r.i32()
    modern = version >= (3, 0)
    bodies = _read_sized_sections(r) if version >= (4, 1) else _walk_sections(r, modern)
    mid = received = transmit = 0
    if modern:
        _, _, timestamp, mid, received, transmit = r.unpack(_STAMPS)
    else:
        _, _, timestamp = r.unpack(_TIMECODE)
    return Frame(number, bodies, timestamp, mid, received, transmit, _read_suffix(r))


def _read_sized_sections(r: Reader) -> tuple[RigidBody, ...]:
    _jump_sections(r, 2)  # marker sets, other markers
    n, end = r.count(), r.sized()
    bodies = _read_bodies(r, n)
    if r.at != end:
        raise NatNetError(f"{n} rigid bodies in a section of another size")
    _jump_sections(r, 5)  # skeletons, assets, markers, plates, devices
    return bodies


def _jump_sections(r: Reader, count: int) -> None:
    """Pass over sections that say their size."""
    empty = r.at + count * SECTION.size
    if not any(r.data[r.at : empty]) and empty <= r.end:
        r.at = empty
        return
    for _ in range(count):
        r.count()
        r.at = r.sized()


def _walk_sections(r: Reader, modern: bool) -> tuple[RigidBody, ...]:
    r.skip(_BEFORE)
    bodies = (_read_bodies if modern else _read_bodies2)(r, r.count())
    r.skip(_BEHIND if modern else _BEHIND2)
    return bodies


def _read_bodies(r: Reader, n: int) -> tuple[RigidBody, ...]:
    return tuple(
        RigidBody(i, (x, y, z), (qx, qy, qz, qw), err, params)
        for i, x, y, z, qx, qy, qz, qw, err, params in _BODY.iter_unpack(r.take(_BODY.size * n))
    )


def _read_bodies2(r: Reader, n: int) -> tuple[RigidBody, ...]:
    bodies = []
    for _ in range(n):
        i, x, y, z, qx, qy, qz, qw = r.unpack(_BODY2_HEAD)
        r.skip([20])
        bodies.append(RigidBody(i, (x, y, z), (qx, qy, qz, qw), *r.unpack(_BODY2_TAIL)))
    return tuple(bodies)


def _read_suffix(r: Reader) -> int:
    # The rest's length, not the version, shows whether the PTP stamp is there: decoders that
    # trust the version read the "models changed" bit from the stamp.
    left = r.end - r.at
    if left not in (_SUFFIX.size, _SUFFIX_PTP.size):
        raise NatNetError(f"{left} bytes behind the stamps, expected 6 or 14")
    *_, params, end = r.unpack(_SUFFIX if left == _SUFFIX.size else _SUFFIX_PTP)
    if end:
        raise NatNetError(f"end of data is {end}, expected 0")
    return int(params)


def write_frame(frame: Frame, version: Version) -> bytes:
    """Encode the payload of FRAMEOFDATA in the layout of `version`; before 3.0 without ticks.

    Raises:
        struct.error: a value does not fit its field.
    """
    f, n = frame, len(frame.rigid_bodies)
    ticks = (f.mid_exposure_ticks, f.data_received_ticks, f.transmit_ticks)
    if version < (3, 0):
        bodies = b"".join(map(_write_body2, f.rigid_bodies))
        return _HEAD.pack(f.number, n) + bodies + _TAIL2.pack(0, 0, f.timestamp, f.params, 0)
    bodies = b"".join(
        _BODY.pack(b.id, *b.position, *b.quaternion, b.mean_error, b.params) for b in f.rigid_bodies
    )
    if version < (4, 1):
        return _HEAD.pack(f.number, n) + bodies + _TAIL.pack(0, 0, f.timestamp, *ticks, f.params, 0)
    head = _HEAD_SIZED.pack(f.number, n, len(bodies))
    return head + bodies + _TAIL_SIZED.pack(0, 0, f.timestamp, *ticks, 0, 0, f.params, 0)


def _write_body2(b: RigidBody) -> bytes:
    head = _BODY2_HEAD.pack(b.id, *b.position, *b.quaternion)
    return head + bytes(4) + _BODY2_TAIL.pack(b.mean_error, b.params)
