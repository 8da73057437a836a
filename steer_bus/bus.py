"""What every bus offers.

Receiving is polling: a subscription is a ring that keeps the newest samples, so neither side can
ever stall the other, and nothing runs in a thread the caller did not start (the answers of
:meth:`Bus.serve` and what a subscription keeps excepted).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

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


class Token(Protocol):
    """Something declared that lasts until it is closed."""

    def close(self) -> None:
        """Withdraw it."""


class Subscription(Token, Protocol):
    """The newest samples of a key."""

    def poll(self) -> list[Sample]:
        """Take what has arrived since the last poll, oldest first; never waits."""


Answer = Callable[[str], bytes | None]
"""Gives the value of a key, or None if there is none; may run in another thread."""

Keep = Callable[[bytes], bool]
"""Whether a message is worth its place in a ring; never raises, may run in another thread."""


class Bus(Protocol):
    """One participant. Keys to listen to may hold ``*`` (one chunk) and ``**`` (any)."""

    who: str  # the name in this participant's certificate; empty without one

    def publish(self, key: str, data: bytes) -> None:
        """Send to whoever listens; never waits for a slow receiver.

        Raises:
            BusError: if the key holds a wildcard, the message is too long or the bus is closed.
        """

    def subscribe(self, key: str, depth: int = 1, keep: Keep | None = None) -> Subscription:
        """Receive a key's newest ``depth`` samples; what is not kept displaces none."""

    def declare_alive(self, key: str) -> Token:
        """Show a liveliness token until it is closed or this process dies."""

    def alive(self, key: str) -> frozenset[str]:
        """Give the tokens that are alive now."""

    def serve(self, key: str, answer: Answer) -> Token:
        """Answer queries to a key."""

    def query(self, key: str, timeout_s: float = 1.0) -> dict[str, bytes]:
        """Ask for values, by key; only keys that ``key`` matches are answered."""

    def close(self) -> None:
        """Leave the bus, in bounded time; a second close does nothing."""


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
