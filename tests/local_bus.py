"""A bus inside one process, for tests: the double of `ZenohBus` that the bus contract holds too."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import zenoh  # noqa: TID251

from steerd.steer_bus.topics import Answer, BusError, Keep, Sample, check_key, check_size


def key_matches(pattern: str, key: str) -> bool:
    """Say whether a key matches a pattern with ``*`` (one chunk) and ``**`` (any number)."""
    return zenoh.KeyExpr(pattern).intersects(zenoh.KeyExpr(key))


@dataclass(slots=True, eq=False)
class _Held:
    """What a participant declared on its hub: a ring (with a place for samples) or a value."""

    bus: "LocalBus"
    key: str
    value: Any = None
    samples: deque[Sample] = field(default_factory=deque)

    def poll(self) -> list[Sample]:
        taken = list(self.samples)
        self.samples.clear()
        return taken


@dataclass(slots=True, eq=False)
class LocalHub:
    """What the participants of one in-process bus share; not for use across threads."""

    rings: list[_Held] = field(default_factory=list)
    tokens: list[_Held] = field(default_factory=list)
    answers: list[_Held] = field(default_factory=list)


class LocalBus:
    """A participant of an in-process bus."""

    def __init__(self, hub: LocalHub, who: str = "") -> None:
        self.hub, self.who = hub, who
        self._seqs: dict[str, int] = {}
        self._closed = False

    def publish(self, key: str, data: bytes) -> None:
        self._check_open()
        seq = self._seqs[key] = self._seqs.get(check_key(key), 0) + 1
        sample = Sample(key, bytes(check_size(data)), seq, sender=id(self).to_bytes(16))
        for ring in self.hub.rings:
            if key_matches(ring.key, key) and (not ring.value or ring.value(sample.data)):
                ring.samples.append(sample)

    def subscribe(self, key: str, depth: int = 1, keep: Keep | None = None) -> _Held:
        return self._hold(self.hub.rings, _Held(self, key, keep, deque(maxlen=depth)))

    def declare_alive(self, key: str) -> None:
        self._hold(self.hub.tokens, _Held(self, check_key(key)))

    def alive(self, key: str) -> frozenset[str]:
        return frozenset(each.key for each in self.hub.tokens if key_matches(key, each.key))

    def serve(self, key: str, answer: Answer) -> None:
        self._hold(self.hub.answers, _Held(self, key, answer))

    def query(self, key: str, timeout_s: float = 1.0) -> dict[str, bytes]:
        self._check_open()
        asked = [each.value(key) for each in self.hub.answers if key_matches(each.key, key)]
        given = [value for value in asked if value is not None]
        return {key: given[-1]} if given else {}

    def close(self) -> None:
        self._closed = True
        for place in (self.hub.rings, self.hub.tokens, self.hub.answers):
            place[:] = [each for each in place if each.bus is not self]

    def _hold(self, place: list[_Held], what: _Held) -> _Held:
        self._check_open()
        place.append(what)
        return what

    def _check_open(self) -> None:
        if self._closed:
            raise BusError("the bus is closed")


def is_heard(bus: Any, key: str) -> bool:
    """Whether anybody listens to a key, on this bus or on zenoh's."""
    if isinstance(bus, LocalBus):
        return any(key_matches(ring.key, key) for ring in bus.hub.rings)
    if key not in bus._publishers:
        bus._publishers[key] = bus._declare(key)
    return bool(bus._publishers[key].handle.matching_status.matching)
