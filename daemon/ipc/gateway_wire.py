"""Requests from gateway and terminal to the core: one packet each."""

import struct
from hashlib import blake2b

REQUEST_MAX = 4096
"""Largest request that is forwarded [bytes]."""


def pack_request(name: str, data: bytes) -> bytes:
    """A request as one packet: topic name, a zero, the message."""
    return name.encode() + b"\0" + data


def unpack_request(packet: bytes) -> tuple[str, bytes]:
    """The inverse of `pack_request`; an empty name if it is no request."""
    name, mark, data = packet.partition(b"\0")
    return (name.decode("ascii", "replace"), data) if mark else ("", b"")


def make_badge(who: str, lease_id: int) -> int:
    """The lease as the car knows, publishes and records it, made of a request from the bus.

    A lease id is a secret that its holder drew; nobody finds it from the badge. Where certificates
    prove who sent a request, their name is part of it. 0 stays nobody.
    """
    if not lease_id:
        return 0
    digest = blake2b(lease_id.to_bytes(8, "little") + who.encode(), digest_size=8).digest()
    return int(struct.unpack("<Q", digest)[0]) | 1
