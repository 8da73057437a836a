"""NatNet messages: one value per message, `encode` and `decode` over whole datagrams.

Wire facts: `docs/reference/mocap-protocols.md#m3`. `decode` raises only `NatNetError`,
whatever the bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from steerd.mocap_link.natnet_frame import Frame, read_frame, write_frame
from steerd.mocap_link.natnet_model import ModelDef, read_model_def, write_model_def
from steerd.mocap_link.natnet_wire import (
    F32,
    HEADER,
    U64,
    NatNetError,
    Version,
    need,
    read_name,
    write_cstr,
    write_name,
)

COMMAND_PORT = 1510
DATA_PORT = 1511
MULTICAST_GROUP = "239.255.42.99"
OLDEST_VERSION: Version = (2, 9)
NEWEST_VERSION: Version = (4, 2)
FRAME_ID = 7

_NAME = 256
Version4 = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Connect:
    """0: start a session (also what NatNetLib sends as a ping).

    `bitstream` appends the request for a stream version that Motive 3 and later honour for
    unicast clients; None sends the classic 264 bytes.
    """

    name: str = "steerd"
    app_version: Version4 = (0, 0, 0, 0)
    natnet_version: Version4 = (4, 2, 0, 0)
    bitstream: Version4 | None = None


@dataclass(frozen=True, slots=True)
class Discovery:
    """14: broadcast form of `Connect`; each server answers `ServerInfo`."""

    name: str = "steerd"
    app_version: Version4 = (0, 0, 0, 0)
    natnet_version: Version4 = (4, 2, 0, 0)


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
    def version(self) -> Version:
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
        return float(F32.unpack(self.body)[0]) if len(self.body) == 4 else None


@dataclass(frozen=True, slots=True)
class RequestModelDef:
    """4: ask for `ModelDef`."""


@dataclass(frozen=True, slots=True)
class RequestFrame:
    """6: ask for one frame."""


@dataclass(frozen=True, slots=True)
class MessageString:
    """8: text from the server."""

    text: str


@dataclass(frozen=True, slots=True)
class Disconnect:
    """9: end of a session."""


@dataclass(frozen=True, slots=True)
class KeepAlive:
    """10: a unicast client is alive."""


@dataclass(frozen=True, slots=True)
class DisconnectByTimeout:
    """11: the server dropped this unicast client."""


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
    Connect
    | Discovery
    | ServerInfo
    | Request
    | Response
    | RequestModelDef
    | ModelDef
    | RequestFrame
    | Frame
    | MessageString
    | Disconnect
    | KeepAlive
    | DisconnectByTimeout
    | EchoRequest
    | EchoResponse
    | Unrecognized
)

_EMPTY_BY_ID: dict[int, Message] = {
    4: RequestModelDef(),
    6: RequestFrame(),
    9: Disconnect(),
    10: KeepAlive(),
    11: DisconnectByTimeout(),
}
_ID_BY_EMPTY = {type(message): message_id for message_id, message in _EMPTY_BY_ID.items()}


def peek_id(data: bytes) -> int:
    """Return the message id of a datagram, -1 if it is shorter than a header."""
    return int.from_bytes(data[:2], "little") if len(data) >= HEADER.size else -1


def has_exact_length(data: bytes) -> bool:
    """Whether the header's length is the datagram's (a server that breaks it is worth a note)."""
    return len(data) >= 4 and HEADER.unpack_from(data)[1] == len(data) - 4


def decode(data: bytes, version: Version, *, detail: bool = True) -> Message:
    """Decode one datagram of a stream of `version`.

    Bytes beyond the header's length are ignored, missing ones refused; `detail` as in
    `natnet_frame.read_frame`.

    Raises:
        NatNetError: anything that the layout does not allow.
    """
    try:
        message_id, size = HEADER.unpack_from(data)
        if len(data) != size + 4:
            need(data, 4, size)
            data = data[: size + 4]
        if message_id == FRAME_ID:
            return read_frame(data, 4, version, detail=detail)
        return _decode_other(message_id, data, version)
    except struct.error as error:
        raise NatNetError(str(error)) from error


def _decode_other(message_id: int, data: bytes, version: Version) -> Message:
    match message_id:
        case 0:
            return _read_connect(data)
        case 1:
            return _read_server_info(data)
        case 2:
            return Request(read_name(data, 4, len(data)))
        case 3:
            return Response(data[4:])
        case 5:
            return read_model_def(data, 4, version)
        case 8:
            return MessageString(read_name(data, 4, len(data)))
        case 12:
            return EchoRequest(U64.unpack_from(data, 4)[0])
        case 13:
            return EchoResponse(U64.unpack_from(data, 4)[0], U64.unpack_from(data, 12)[0])
        case 14:
            connect = _read_connect(data)
            return Discovery(connect.name, connect.app_version, connect.natnet_version)
    return _EMPTY_BY_ID.get(message_id) or Unrecognized(message_id)


def _read_version(data: bytes, at: int) -> Version4:
    a, b, c, d = data[at : need(data, at, 4)]
    return a, b, c, d


def _read_connect(data: bytes) -> Connect:
    name = read_name(data, 4, _NAME)
    if len(data) < 4 + _NAME + 8:
        # third-party clients send nothing or "Ping": any length asks for a session
        return Connect(name, natnet_version=(0, 0, 0, 0))
    at = 4 + _NAME
    bitstream = _read_version(data, at + 9) if len(data) >= at + 13 else None
    return Connect(name, _read_version(data, at), _read_version(data, at + 4), bitstream)


def _read_server_info(data: bytes) -> ServerInfo:
    at = 4 + _NAME
    name = read_name(data, 4, _NAME)
    app, natnet = _read_version(data, at), _read_version(data, at + 4)
    if natnet[0] < 3:
        return ServerInfo(name, app, natnet)
    clock_hz, port, multicast = struct.unpack_from("<QHB", data, at + 8)
    if not clock_hz:
        raise NatNetError("server clock of 0 Hz")
    group = ".".join(str(b) for b in _read_version(data, at + 19))
    return ServerInfo(name, app, natnet, clock_hz, port, bool(multicast), group)


def encode(message: Message, version: Version = NEWEST_VERSION) -> bytes:
    """Encode one message as a datagram of a stream of `version`.

    Raises:
        NatNetError: a value does not fit its field, or the payload exceeds 65 535 bytes.
    """
    try:
        message_id, payload = _payload(message, version)
        return HEADER.pack(message_id, len(payload)) + payload
    except struct.error as error:
        raise NatNetError(str(error)) from error


def _payload(message: Message, version: Version) -> tuple[int, bytes]:
    match message:
        case Frame():
            return FRAME_ID, write_frame(message, version)
        case Connect():
            return 0, _write_client(message) + _write_bitstream(message.bitstream)
        case Discovery():
            return 14, _write_client(message)
        case ServerInfo():
            return 1, _write_server_info(message)
        case Request():
            return 2, write_cstr(message.text)
        case Response():
            return 3, message.body
        case ModelDef():
            return 5, write_model_def(message, version)
        case MessageString():
            return 8, write_cstr(message.text)
        case EchoRequest():
            return 12, U64.pack(message.client_stamp)
        case EchoResponse():
            return 13, U64.pack(message.client_stamp) + U64.pack(message.server_ticks)
        case Unrecognized():
            return message.id, b""
    return _ID_BY_EMPTY[type(message)], b""


def _write_client(m: Connect | Discovery) -> bytes:
    return write_name(m.name, _NAME) + bytes(m.app_version) + bytes(m.natnet_version)


def _write_bitstream(bitstream: Version4 | None) -> bytes:
    return b"" if bitstream is None else b"\0" + bytes(bitstream) + bytes(4)


def _write_server_info(m: ServerInfo) -> bytes:
    head = write_name(m.name, _NAME) + bytes(m.app_version) + bytes(m.natnet_version)
    if m.natnet_version[0] < 3:
        return head
    group = bytes(int(part) for part in m.group.split("."))
    return head + struct.pack("<QHB", m.clock_hz, m.data_port, m.multicast) + group
