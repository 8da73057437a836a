"""NatNet messages: one value per message, `encode` and `decode` over whole datagrams.

Wire facts: `docs/reference/mocap-protocols.md#m3`. `decode` raises only `NatNetError`,
whatever the bytes.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import assert_never

from steerd.mocap_link import natnet_wire as wire
from steerd.mocap_link.natnet_wire import Frame, read_frame, write_frame

COMMAND_PORT = 1510
DATA_PORT = 1511
MULTICAST_GROUP = "239.255.42.99"
OLDEST_VERSION: wire.Version = (2, 9)
NEWEST_VERSION: wire.Version = (4, 2)
FRAME_ID = 7

_NAME = 256
_STREAM = struct.Struct("<QHB")
"""Of a server: clock frequency, data port, whether it multicasts."""
Version4 = tuple[int, int, int, int]


class Bare(IntEnum):
    """Messages whose payload is empty, or not read: many clients say nothing of themselves."""

    CONNECT = 0  # start a session
    REQUEST_MODEL = 4  # ask for `ModelDef`
    DISCONNECT = 9  # end of a session
    KEEP_ALIVE = 10  # a unicast client is alive
    DISCONNECT_BY_TIMEOUT = 11  # the server dropped this unicast client
    DISCOVERY = 14  # broadcast form of `CONNECT`; each server answers `ServerInfo`


@dataclass(frozen=True, slots=True)
class ServerInfo:
    """1: the server's identity, version, clock frequency [ticks/s] and stream address.

    Before 3.0 the message ends after the version; the other fields then hold their defaults.
    """

    name: str
    app_version: Version4
    natnet_version: Version4
    clock_hz: int = 0
    data_port: int = DATA_PORT
    multicast: bool = True
    group: str = MULTICAST_GROUP

    @property
    def version(self) -> wire.Version:
        """(major, minor) of the stream."""
        return self.natnet_version[0], self.natnet_version[1]


@dataclass(frozen=True, slots=True)
class Request:
    """2: a textual command such as `FrameRate`."""

    text: str


@dataclass(frozen=True, slots=True)
class Response:
    """3: answer to a `Request`; 4 bytes are a number, more are text."""

    body: bytes

    @property
    def number(self) -> float | None:
        """The answer read as f32, or None if it is text."""
        return float(wire.F32.unpack(self.body)[0]) if len(self.body) == 4 else None


@dataclass(frozen=True, slots=True)
class RigidBodyDesc:
    """A body's name and streaming id."""

    name: str
    id: int


@dataclass(frozen=True, slots=True)
class ModelDef:
    """5: what the server streams, as far as it is a rigid body, in the server's order."""

    rigid_bodies: tuple[RigidBodyDesc, ...] = ()


@dataclass(frozen=True, slots=True)
class MessageString:
    """8: text from the server."""

    text: str


@dataclass(frozen=True, slots=True)
class EchoRequest:
    """12: clock exchange; `client_stamp` is opaque to the server."""

    client_stamp: int


@dataclass(frozen=True, slots=True)
class EchoResponse:
    """13: the stamp back, with the server's clock [ticks] at reception."""

    client_stamp: int
    server_ticks: int


@dataclass(frozen=True, slots=True)
class Unrecognized:
    """100, or an id that is not NatNet's: nothing inside can be trusted."""

    id: int


Message = (
    Bare | ServerInfo | Request | Response | ModelDef | Frame | MessageString | EchoRequest
    | EchoResponse | Unrecognized
)  # fmt: skip
_BARE = {int(message): message for message in Bare}


def peek_id(data: bytes) -> int:
    """Return the message id of a datagram, -1 if it is shorter than a header."""
    return int.from_bytes(data[:2], "little") if len(data) >= wire.HEADER.size else -1


def decode(data: bytes, version: wire.Version) -> Message:
    """Decode one datagram of a stream of `version`.

    Raises:
        NatNetError: anything that the layout does not allow.
    """
    try:
        r = wire.Reader(data)
        return read_frame(r, version) if r.message_id == FRAME_ID else _decode_other(r, version)
    except struct.error as error:
        raise wire.NatNetError(str(error)) from error


def _decode_other(r: wire.Reader, version: wire.Version) -> Message:
    match r.message_id:
        case 1:
            return _read_server_info(r)
        case 2:
            return Request(wire.read_name(r.data[4:]))
        case 3:
            return Response(r.data[4:])
        case 5:
            return _read_model_def(r, version)
        case 8:
            return MessageString(wire.read_name(r.data[4:]))
        case 12:
            return EchoRequest(*r.unpack(wire.U64))
        case 13:
            return EchoResponse(*r.unpack(wire.U64), *r.unpack(wire.U64))
    return _BARE.get(r.message_id, Unrecognized(r.message_id))


def _read_server_info(r: wire.Reader) -> ServerInfo:
    name = wire.read_name(r.take(_NAME))
    a, b, c, d, *natnet = r.take(8)
    version = (natnet[0], natnet[1], natnet[2], natnet[3])
    if version[0] < 3:
        return ServerInfo(name, (a, b, c, d), version)
    clock_hz, port, multicast = r.unpack(_STREAM)
    if not clock_hz:
        raise wire.NatNetError("server clock of 0 Hz")
    group = ".".join(map(str, r.take(4)))
    return ServerInfo(name, (a, b, c, d), version, clock_hz, port, bool(multicast), group)


def _read_model_def(r: wire.Reader, version: wire.Version) -> ModelDef:
    """Decode the payload of MODELDEF; layout: `docs/reference/mocap-protocols.md#m3.3`.

    From 4.1 on each item carries its size and is jumped by it; before, an unknown kind ends the
    list, and what was read until then is kept.
    """
    bodies: list[RigidBodyDesc] = []
    others = _describe_others(version)
    for _ in range(r.count()):
        kind = r.i32()
        end = r.sized() if version >= (4, 1) else None
        if kind == _RIGID_BODY:
            bodies.append(RigidBodyDesc(r.string(), r.i32()))
            r.skip(_behind_body_id(version))
        elif end is None:
            if kind not in others:
                break
            r.skip(others[kind])
        if end is not None:
            if r.at > end:
                raise wire.NatNetError(f"description runs {r.at - end} bytes over its size")
            r.at = end
    return ModelDef(tuple(bodies))


_MARKER_SET, _RIGID_BODY, _SKELETON, _CAMERA = 0, 1, 2, 5


def _behind_body_id(version: wire.Version) -> wire.Layout:
    """Parent's id, offset and since 4.2 a rotation; markers with place, label, since 4.0 a name."""
    own = 4 + 12 + (16 if version >= (4, 2) else 0)
    if version < (3, 0):
        return own
    return own, [16, None] if version >= (4, 0) else [16]


def _describe_others(version: wire.Version) -> dict[int, wire.Layout]:
    """Layouts of descriptions that are passed over; a camera's place and rotation close its."""
    body: wire.Layout = (None, 4, _behind_body_id(version))
    skeleton: wire.Layout = (None, 4, [body])
    return {_MARKER_SET: (None, [None]), _SKELETON: skeleton, _CAMERA: (None, 12 + 16)}


def encode(message: Message, version: wire.Version = NEWEST_VERSION) -> bytes:
    """Encode one message as a datagram of a stream of `version`.

    Raises:
        NatNetError: a value does not fit its field, or the payload exceeds 65 535 bytes.
    """
    try:
        message_id, payload = _payload(message, version)
        return wire.HEADER.pack(message_id, len(payload)) + payload
    except struct.error as error:
        raise wire.NatNetError(str(error)) from error


def _payload(message: Message, version: wire.Version) -> tuple[int, bytes]:
    match message:
        case Frame():
            return FRAME_ID, write_frame(message, version)
        case Bare():
            introduces = message in (Bare.CONNECT, Bare.DISCOVERY)
            return message, _CLIENT if introduces else b""
        case ServerInfo():
            return 1, _write_server_info(message)
        case Request():
            return 2, wire.write_cstr(message.text)
        case Response():
            return 3, message.body
        case ModelDef():
            return 5, _write_model_def(message, version)
        case MessageString():
            return 8, wire.write_cstr(message.text)
        case EchoRequest():
            return 12, wire.U64.pack(message.client_stamp)
        case EchoResponse():
            return 13, wire.U64.pack(message.client_stamp) + wire.U64.pack(message.server_ticks)
        case Unrecognized():
            return message.id, b""
        case _:
            assert_never(message)


_CLIENT = wire.write_name("steerd", _NAME) + bytes((0, 0, 0, 0, *NEWEST_VERSION, 0, 0))
"""What we say of ourselves: our name, no version of it, and the NatNet version that we speak."""


def _write_model_def(model: ModelDef, version: wire.Version) -> bytes:
    """Each body with the marker set of its name, as Motive sends them, and all markers' set."""
    items = []
    for body in model.rigid_bodies:
        items.append((_MARKER_SET, _write_marker_set(body.name)))
        items.append((_RIGID_BODY, _write_rigid_body(body, version)))
    items.append((_MARKER_SET, _write_marker_set("all")))
    sized = version >= (4, 1)
    heads = (
        wire.SECTION.pack(kind, len(item)) if sized else wire.I32.pack(kind) for kind, item in items
    )
    parts = (head + item for head, (_, item) in zip(heads, items, strict=True))
    return wire.I32.pack(len(items)) + b"".join(parts)


def _write_marker_set(name: str) -> bytes:
    return wire.write_cstr(name) + wire.I32.pack(0)


def _write_rigid_body(body: RigidBodyDesc, version: wire.Version) -> bytes:
    rotation = struct.pack("<4f", 0.0, 0.0, 0.0, 1.0) if version >= (4, 2) else b""
    markers = wire.I32.pack(0) if version >= (3, 0) else b""
    head = wire.write_cstr(body.name) + wire.I32.pack(body.id) + wire.I32.pack(-1)
    return head + bytes(12) + rotation + markers


def _write_server_info(m: ServerInfo) -> bytes:
    head = wire.write_name(m.name, _NAME) + bytes(m.app_version) + bytes(m.natnet_version)
    if m.natnet_version[0] < 3:
        return head
    group = bytes(int(part) for part in m.group.split("."))
    return head + _STREAM.pack(m.clock_hz, m.data_port, m.multicast) + group
