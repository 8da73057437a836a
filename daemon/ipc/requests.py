"""Requests from gateway, terminal and pages to the core, and its diagnostics as they read them.

A request is one packet. Pages and viewers, who hold no codec, write a live parameter as text,
`set NAME VALUE`.
"""

import contextlib
import socket
from collections.abc import Callable
from hashlib import blake2b
from math import isfinite

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.common.screen import remove_controls
from steerd.steer_bus.standard import DiagnosticArray

REQUEST_MAX = 4096  # largest request that is forwarded [bytes]


def pack_request(name: str, data: bytes) -> bytes:
    """A request as one packet: topic name, a zero, the message."""
    return name.encode() + b"\0" + data


def unpack_request(packet: bytes) -> tuple[str, bytes]:
    """The inverse of `pack_request`; an empty name if it is no request."""
    name, mark, data = packet.partition(b"\0")
    return (name.decode("ascii", "replace"), data) if mark else ("", b"")


def make_sender(fd: int) -> Callable[[bytes], None]:
    """Sends packets on a socket that this process was given; one that does not fit is dropped."""
    end = socket.socket(fileno=fd)
    end.setblocking(False)

    def send(packet: bytes) -> None:
        with contextlib.suppress(OSError):
            end.send(packet)

    return send


def make_badge(who: str, lease_id: int) -> int:
    """The lease as the car knows, publishes and records it, made of a request from the bus.

    A lease id is a secret that its holder drew; nobody finds it from the badge. Where certificates
    prove who sent a request, their name is part of it. 0 stays nobody.
    """
    if not lease_id:
        return 0
    digest = blake2b(lease_id.to_bytes(8, "little") + who.encode(), digest_size=8).digest()
    return int.from_bytes(digest, "little") | 1


LIVE = ("speed", "offset", "gain")  # live parameters by name: [m/s], [m], a share
SETTING_MAX = 64  # longest such text [bytes]


def format_setting(name: str, value: float) -> str:
    """The text of a setting."""
    return f"set {name} {value!r}"


def parse_setting(text: str) -> dict[str, float] | None:
    """The live parameter of such a text; None if it is none, or not finite."""
    match text.split():
        case ["set", name, value] if name in LIVE:
            with contextlib.suppress(ValueError):
                number = float(value)
                return {name: number} if isfinite(number) else None
    return None


def read_diagnostics(message: DiagnosticArray) -> dict[str, str]:
    """The supervisor's values in a diagnostics message.

    Raises:
        SteerdError: the message is not the supervisor's.
    """
    for status in message.status:
        if status.name == "steerd: supervisor":
            return {value.key: remove_controls(value.value) for value in status.values}
    raise SteerdError("this is no steerd diagnostics message")
