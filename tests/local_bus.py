"""A bus inside one process, for tests: the double of `ZenohBus` that the bus contract holds too."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any

from steerd.steer_bus.topics import Answer, BusError, Keep, Sample, check_key, check_size


def key_matches(pattern: str, key: str) -> bool:
    """Say whether a key matches a pattern with ``*`` (one chunk) and ``**`` (any number)."""
    return _chunks_match(pattern.split("/"), key.split("/"))


def _chunks_match(pattern: list[str], key: list[str]) -> bool:
    if not pattern:
        return not key
    if pattern[0] == "**":
        return any(_chunks_match(pattern[1:], key[i:]) for i in range(len(key) + 1))
    return bool(key) and pattern[0] in ("*", key[0]) and _chunks_match(pattern[1:], key[1:])


class _Held:
    """Closing removes what was declared from the hub, once."""

    def __init__(self, place: list[Any], what: Any) -> None:
        self._place, self._what = place, what
        place.append(what)

    def close(self) -> None:
        if self._place:
            self._place.remove(self._what)
        self._place = []


class _Ring(_Held):
    def __init__(self, hub: "LocalHub", pattern: str, depth: int, keep: Keep | None) -> None:
        super().__init__(hub.rings, self)
        self.pattern, self.keep, self.samples = pattern, keep, deque[Sample](maxlen=depth)

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


class LocalBus:
    """A participant of an in-process bus."""

    def __init__(self, hub: LocalHub, who: str = "") -> None:
        self._hub, self.who = hub, who
        self._held: list[_Held] = []
        self._seqs: dict[str, int] = {}
        self._closed = False

    def publish(self, key: str, data: bytes) -> None:
        self._check_open()
        seq = self._seqs[key] = self._seqs.get(check_key(key), 0) + 1
        sample = Sample(key, bytes(check_size(data)), seq, sender=id(self).to_bytes(16))
        for ring in self._hub.rings:
            if key_matches(ring.pattern, key) and (not ring.keep or ring.keep(sample.data)):
                ring.samples.append(sample)

    def subscribe(self, key: str, depth: int = 1, keep: Keep | None = None) -> _Ring:
        self._check_open()
        ring = _Ring(self._hub, key, depth, keep)
        self._held.append(ring)
        return ring

    def declare_alive(self, key: str) -> None:
        self._hold(self._hub.tokens, check_key(key))

    def alive(self, key: str) -> frozenset[str]:
        return frozenset(token for token in self._hub.tokens if key_matches(key, token))

    def serve(self, key: str, answer: Answer) -> None:
        self._hold(self._hub.answers, (key, answer))

    def query(self, key: str, timeout_s: float = 1.0) -> dict[str, bytes]:
        self._check_open()
        found = {}
        for pattern, answer in self._hub.answers:
            if key_matches(pattern, key) and (value := answer(key)) is not None:
                found[key] = value
        return found

    def close(self) -> None:
        self._closed = True
        for held in self._held:
            held.close()

    def _hold(self, place: list[Any], what: Any) -> None:
        self._check_open()
        self._held.append(_Held(place, what))

    def _check_open(self) -> None:
        if self._closed:
            raise BusError("the bus is closed")


def is_heard(bus: Any, key: str) -> bool:
    """Whether anybody listens to a key, on this bus or on zenoh's."""
    if isinstance(bus, LocalBus):
        return any(key_matches(ring.pattern, key) for ring in bus._hub.rings)
    if key not in bus._publishers:
        bus._publishers[key] = bus._declare(key)
    return bool(bus._publishers[key].handle.matching_status.matching)
