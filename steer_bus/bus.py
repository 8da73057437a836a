"""What travels on the bus (`steerd.steer_bus.zenoh_bus`), and what it refuses."""

from collections.abc import Callable
from dataclasses import dataclass

from steerd.steer_bus.codec import MAX_BYTES


class BusError(Exception):
    """The bus cannot do what was requested, in one line that says what to change."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message."""

    key: str  # the key it was published under
    data: bytes  # the encoded message
    seq: int = 0  # the publisher's counter for this key, from 1; 0 if the sender gives none
    sent_ns: int = 0  # the publisher's UNIX time [ns]; 0 if the sender gives none
    sender: bytes = b""  # the publisher's id of 16 bytes; empty if the sender gives none


Answer = Callable[[str], bytes | None]
"""Gives the value of a key, or None if there is none; may run in another thread."""

Keep = Callable[[bytes], bool]
"""Whether a message is worth its place in a ring; never raises, may run in another thread."""


def check_size(data: bytes) -> bytes:
    """Give a message back if the bus carries it.

    Raises:
        BusError: above ``MAX_BYTES``, which a receiver would drop silently.
    """
    if len(data) > MAX_BYTES:
        raise BusError(f"a message of {len(data)} bytes exceeds {MAX_BYTES}")
    return data


def check_key(key: str) -> str:
    """Give a key back if a message may be published under it.

    Raises:
        BusError: if it is empty, has an empty chunk, or holds one of ``* $ # ?``.
    """
    if not all(key.split("/")) or any(mark in key for mark in "*$#?"):
        raise BusError(f"{key!r} is no key to publish under")
    return key
