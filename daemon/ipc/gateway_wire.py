"""Requests from gateway and terminal to the core: one packet each."""

REQUEST_MAX = 4096
"""Largest request that is forwarded [bytes]."""


def pack_request(name: str, data: bytes) -> bytes:
    """A request as one packet: topic name, a zero, the message."""
    return name.encode() + b"\0" + data


def unpack_request(packet: bytes) -> tuple[str, bytes]:
    """The inverse of `pack_request`; an empty name if it is no request."""
    name, mark, data = packet.partition(b"\0")
    return (name.decode("ascii", "replace"), data) if mark else ("", b"")
