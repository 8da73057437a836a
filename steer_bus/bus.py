"""What every bus offers, and the bus inside one process.

Receiving is polling: a subscription is a ring that keeps the newest samples, so neither side can
ever stall the other, and nothing runs in a thread the caller did not start (the answers of
:meth:`Bus.serve` excepted).
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from steerd.steer_bus.codec import MAX_BYTES


class BusError(Exception):
    """The bus cannot do what was asked, in one line that says what to change."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message.

    Attributes:
        key: the key it was published under.
        data: the encoded message.
        seq: the publisher's counter for this key, from 1; 0 if the sender gives none.
        sent_ns: the publisher's UNIX time [ns]; 0 if the sender gives none.
    """

    key: str
    data: bytes
    seq: int = 0
    sent_ns: int = 0


class Subscription(Protocol):
    """The newest samples of a key."""

    def poll(self) -> list[Sample]:
        """Take what has arrived since the last poll, oldest first; never waits."""

    def close(self) -> None:
        """Stop receiving."""


class Token(Protocol):
    """Something declared that lasts until it is closed."""

    def close(self) -> None:
        """Withdraw it."""


Answer = Callable[[str], bytes | None]
"""Gives the value of a key, or None if there is none; may run in another thread."""


class Bus(Protocol):
    """One participant. Keys to listen to may hold ``*`` (one chunk) and ``**`` (any)."""

    def publish(self, key: str, data: bytes) -> None:
        """Send to whoever listens; never waits for a slow receiver.

        Raises:
            BusError: if the key holds a wildcard, the message is too long or the bus is closed.
        """

    def subscribe(self, key: str, depth: int = 1) -> Subscription:
        """Receive a key's newest ``depth`` samples."""

    def has_subscriber(self, key: str) -> bool:
        """Say whether anybody listens to a key."""

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


def key_matches(pattern: str, key: str) -> bool:
    """Say whether a key matches a pattern with ``*`` (one chunk) and ``**`` (any number)."""
    return _chunks_match(pattern.split("/"), key.split("/"))


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


def _chunks_match(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_chunks_match(pattern[1:], key[i:]) for i in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _chunks_match(pattern[1:], key[1:])


@dataclass(slots=True, eq=False)
class _Ring:
    pattern: str
    samples: deque[Sample]

    def poll(self) -> list[Sample]:
        taken = []
        while self.samples:
            taken.append(self.samples.popleft())
        return taken


@dataclass(slots=True, eq=False)
class LocalHub:
    """What the participants of one in-process bus share; not for use across threads."""

    rings: list[_Ring] = field(default_factory=list)
    tokens: list[str] = field(default_factory=list)
    answers: list[tuple[str, Answer]] = field(default_factory=list)


class _Held:
    """Closing removes what was declared from the hub, once."""

    def __init__(self, remove: Callable[[], None]) -> None:
        self._remove: Callable[[], None] | None = remove

    def close(self) -> None:
        remove, self._remove = self._remove, None
        if remove is not None:
            remove()


class _LocalSubscription:
    def __init__(self, ring: _Ring, held: _Held) -> None:
        self._ring, self._held = ring, held

    def poll(self) -> list[Sample]:
        return self._ring.poll()

    def close(self) -> None:
        self._held.close()


class LocalBus:
    """A participant of an in-process bus; simulations and tests use it in virtual time."""

    def __init__(self, hub: LocalHub) -> None:
        self._hub = hub
        self._held: list[_Held] = []
        self._seqs: dict[str, int] = {}
        self._closed = False

    def publish(self, key: str, data: bytes) -> None:
        """See :meth:`Bus.publish`."""
        self._check_open()
        seq = self._seqs[key] = self._seqs.get(check_key(key), 0) + 1
        sample = Sample(key, bytes(check_size(data)), seq)
        for ring in self._hub.rings:
            if key_matches(ring.pattern, key):
                ring.samples.append(sample)

    def subscribe(self, key: str, depth: int = 1) -> Subscription:
        """See :meth:`Bus.subscribe`."""
        self._check_open()
        ring = _Ring(key, deque(maxlen=depth))
        self._hub.rings.append(ring)
        return _LocalSubscription(ring, self._hold(lambda: self._hub.rings.remove(ring)))

    def has_subscriber(self, key: str) -> bool:
        """See :meth:`Bus.has_subscriber`."""
        return any(key_matches(ring.pattern, key) for ring in self._hub.rings)

    def declare_alive(self, key: str) -> Token:
        """See :meth:`Bus.declare_alive`."""
        self._check_open()
        self._hub.tokens.append(check_key(key))
        return self._hold(lambda: self._hub.tokens.remove(key))

    def alive(self, key: str) -> frozenset[str]:
        """See :meth:`Bus.alive`."""
        return frozenset(token for token in self._hub.tokens if key_matches(key, token))

    def serve(self, key: str, answer: Answer) -> Token:
        """See :meth:`Bus.serve`."""
        self._check_open()
        entry = (key, answer)
        self._hub.answers.append(entry)
        return self._hold(lambda: self._hub.answers.remove(entry))

    def query(self, key: str, timeout_s: float = 1.0) -> dict[str, bytes]:
        """See :meth:`Bus.query`; ``timeout_s`` is not needed here."""
        self._check_open()
        found = {}
        for pattern, answer in self._hub.answers:
            if key_matches(pattern, key) and (value := answer(key)) is not None:
                found[key] = value
        return found

    def close(self) -> None:
        """See :meth:`Bus.close`."""
        self._closed = True
        for held in self._held:
            held.close()

    def _hold(self, remove: Callable[[], None]) -> _Held:
        held = _Held(remove)
        self._held.append(held)
        return held

    def _check_open(self) -> None:
        if self._closed:
            raise BusError("the bus is closed")
