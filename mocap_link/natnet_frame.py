"""NatNet FRAMEOFDATA (message 7), 2.9 to 4.2: its rigid bodies and stamps.

Layout: `docs/reference/mocap-protocols.md#m3.2`. A frame is a row of counted sections and a suffix
of stamps. Markers, skeletons, assets, force plates and devices are passed over: from 4.1 on by the
size that each section carries, before by walking its items. Written frames have none of them.
"""

from struct import Struct

from steerd.mocap_link.natnet_wire import SECTION, Layout, NatNetError, Reader, Version
from steerd.steer_bus.quick_values import quick_value

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
