"""VRPN wire: cookie, framed messages, descriptions, poses; encode and decode.

All numbers are big-endian. A message is a header of six i32 (length, sec, usec, sender, type,
sequence), a payload, and zeros up to a multiple of 8. The length field counts header and payload
WITHOUT the padding (the protocol's own text says otherwise; its code does not). Wire facts:
`docs/reference/mocap-protocols.md#m4`.
"""

from dataclasses import dataclass
from struct import Struct

COOKIE_SIZE = 24
MAX_MESSAGE = 65_536

SENDER_DESCRIPTION = -1
TYPE_DESCRIPTION = -2
DISCONNECT = -5

POSE_TYPE = "vrpn_Tracker Pos_Quat"
PING_TYPE = "vrpn_Base ping_message"
PONG_TYPE = "vrpn_Base pong_message"
CONTROL_SENDER = "VRPN Control"

COOKIE = b"vrpn: ver. 07.38  0".ljust(COOKIE_SIZE, b"\0")
"""What each side sends first."""
_COOKIE_HEAD = COOKIE[:14]
_HEADER = Struct(">6i")
_I32 = Struct(">i")
_POSE = Struct(">ii7d")


class VrpnError(ValueError):
    """Bytes that are not VRPN; a TCP stream cannot be resumed behind them."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message; `sender` and `type` are ids of the side that sent it.

    For the descriptions (type < 0) `sender` holds the described id.
    """

    type: int
    sender: int
    sec: int = 0
    usec: int = 0
    payload: bytes = b""
    sequence: int = 0

    @property
    def stamp_us(self) -> int:
        """The sender's stamp [us] on its own, unknown epoch."""
        return self.sec * 1_000_000 + self.usec


def check_cookie(data: bytes) -> str:
    """Return the peer's version.

    Raises:
        VrpnError: not a VRPN 7 peer; a different minor version is fine.
    """
    if len(data) < COOKIE_SIZE or not data.startswith(_COOKIE_HEAD):
        raise VrpnError(f"not a VRPN 7 server: it began with {data[:COOKIE_SIZE]!r}")
    return data[11:16].decode("ascii", "replace")


def encode(message: Message) -> bytes:
    """Encode one message with its padding.

    Raises:
        struct.error: a field does not fit 32 bits.
    """
    m, size = message, len(message.payload)
    head = _HEADER.pack(_HEADER.size + size, m.sec, m.usec, m.sender, m.type, m.sequence)
    return head + m.payload + bytes(-size % 8)


def decode_stream(buffer: bytes | bytearray) -> tuple[list[Message], int]:
    """Decode all whole messages at the front of a stream; give them and how many bytes they took.

    Raises:
        VrpnError: a length that no message has.
    """
    messages, at, total = [], 0, len(buffer)
    while total - at >= _HEADER.size:
        length, sec, usec, sender, kind, sequence = _HEADER.unpack_from(buffer, at)
        if not _HEADER.size <= length <= MAX_MESSAGE:
            raise VrpnError(f"message of {length} bytes")
        end = at + length + -length % 8
        if end > total:
            break
        payload = bytes(buffer[at + _HEADER.size : at + length])
        messages.append(Message(kind, sender, sec, usec, payload, sequence))
        at = end
    return messages, at


class Stream:
    """What a peer sends on one connection: its cookie, then messages."""

    def __init__(self) -> None:
        self.version = ""  # the peer's, once its cookie came
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Message]:
        """Take any piece of the stream; the messages that are whole now. Raises VrpnError."""
        self._buffer += data
        if not self.version:
            if len(self._buffer) < COOKIE_SIZE:
                return []
            self.version = check_cookie(bytes(self._buffer[:COOKIE_SIZE]))
            del self._buffer[:COOKIE_SIZE]
        messages, used = decode_stream(self._buffer)
        del self._buffer[:used]
        return messages


def make_description(kind: int, described_id: int, name: str) -> Message:
    """Build the message that gives an id its name (`SENDER_` or `TYPE_DESCRIPTION`)."""
    text = name.encode() + b"\0"
    return Message(kind, described_id, payload=_I32.pack(len(text)) + text)


def read_description(payload: bytes) -> str:
    """Read the name out of a description.

    Raises:
        VrpnError: shorter than it says.
    """
    if len(payload) < 4:
        raise VrpnError("description without a length")
    (size,) = _I32.unpack_from(payload)
    if not 0 <= size <= len(payload) - 4:
        raise VrpnError(f"description of {size} bytes in {len(payload)}")
    return payload[4 : 4 + size].split(b"\0", 1)[0].decode("utf-8", "replace")


Place = tuple[tuple[float, float, float], tuple[float, float, float, float]]
"""Position [m], and quaternion as (x, y, z, w)."""


def write_pose(sensor: int, place: Place) -> bytes:
    """Encode the payload of a pose."""
    return _POSE.pack(sensor, 0, *place[0], *place[1])


def read_pose(payload: bytes) -> tuple[int, Place]:
    """Decode the payload of a pose: its sensor and where it is.

    Raises:
        VrpnError: not 64 bytes.
    """
    if len(payload) != _POSE.size:
        raise VrpnError(f"pose of {len(payload)} bytes")
    sensor, _, x, y, z, qx, qy, qz, qw = _POSE.unpack(payload)
    return sensor, ((x, y, z), (qx, qy, qz, qw))
