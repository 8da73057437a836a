"""The bus over zenoh: a hub in the daemon, spokes anywhere on this host.

Nothing is found by scouting: the hub listens on one named endpoint, a spoke dials it. The hub is a
zenoh router so that spokes see each other. Settings come from measurements with zenoh 1.10: DROP
and a queue of 16 lose nothing at 3000 messages/s (the default queue of 2 does, silently),
BLOCK can hold ``put`` for 5 s, an undrained FIFO stalls the sender, and a session left open keeps
the process from exiting (`docs/reference/sessions-and-bus.md#b2`).

Receiving is polling: a subscription is a ring that keeps the newest samples, so neither side can
ever stall the other, and nothing runs in a thread the caller did not start (the answers of
:meth:`ZenohBus.serve` and what a subscription keeps excepted).
"""

import json
import struct
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from hashlib import blake2b
from typing import Any

import zenoh  # noqa: TID251

from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.fields import type_name
from steerd.steer_bus.lab import (
    Lab,
    is_private,
    make_access_settings,
    make_plain_access,
    make_tls_settings,
)
from steerd.steer_bus.topics import Answer, BusError, Keep, Sample

_ATTACHMENT = struct.Struct("<qqB16s")  # rmw_zenoh's: sequence, UNIX ns, 16, publisher id
_GID_SIZE = 16
_CLOSE_TIMEOUT_S = 2.0
_LEASE_MS = 1000  # after how long a silent peer counts as dead. Not the command watchdog


@dataclass(frozen=True, slots=True)
class Profile:
    """How a participant joins."""

    hub: bool  # listen on ``endpoint`` and forward between spokes; otherwise dial it
    endpoint: str  # a zenoh locator such as ``tcp/127.0.0.1:7447``
    lab: Lab | None = None  # whose certificates it shows and asks for (mutual TLS); None: plain
    insecure_lan: bool = False  # allow a plain-text hub on an address that others can reach
    pose_key: str | None = None  # beside the car's own, where a hub's operators may publish poses
    settings: Mapping[str, Any] = field(default_factory=dict)  # further ones, by their ``/`` path

    @property
    def who(self) -> str:
        """The name in this participant's certificate; empty for a hub and without one."""
        return self.lab.name if self.lab and not self.hub else ""


def make_settings(profile: Profile) -> dict[str, Any]:
    """Make the zenoh settings of a profile.

    Raises:
        BusError: if a hub would listen where others can reach it and not ask who they are.
    """
    lab = profile.lab
    if profile.hub and (lab or not profile.insecure_lan):
        _check_private(profile)
    access = make_access_settings(lab, profile.pose_key) if lab else make_plain_access()
    return {
        **(make_tls_settings(lab, hub=profile.hub) if lab else {}),
        **(access if profile.hub else {}),
        "mode": "router" if profile.hub else "client",
        "listen/endpoints": [profile.endpoint] if profile.hub else [],
        "connect/endpoints": [] if profile.hub else [profile.endpoint],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": False,
        "transport/link/protocols": [profile.endpoint.split("/")[0]],
        "transport/link/tx/lease": _LEASE_MS,
        "transport/link/tx/queue/size/real_time": 16,
        "transport/link/tx/queue/size/data": 16,
        "transport/link/tx/queue/size/data_low": 16,
        "transport/link/rx/max_message_size": 65536,
        **profile.settings,
    }


class ZenohBus:
    """One participant; use it with ``with``.

    Keys to listen to may hold ``*`` (one chunk) and ``**`` (any). ``who`` is the name in this
    participant's certificate; empty without one.
    """

    def __init__(self, profile: Profile) -> None:
        """Join.

        Raises:
            BusError: if the hub's port is taken, no hub answers, or a setting is unknown.
        """
        self.who = profile.who
        self._session = _open(profile)
        self.zid = str(self._session.info.zid())  # the session's id in hexadecimal digits
        self._publishers: dict[str, _Publisher] = {}
        self._held: list[Any] = []  # zenoh withdraws what nobody refers to
        self._closed = False

    def __enter__(self) -> "ZenohBus":
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def name_publisher(self, key: str, gid: bytes) -> None:
        """Publish a key under this id from now on: rmw_zenoh derives it from a token's text."""
        self._publishers[key] = replace(self._declare(key), gid=gid)

    def publish(self, key: str, data: bytes) -> None:
        """Send to whoever listens; never waits for a slow receiver.

        Priority and encoding are the topic table's.

        Raises:
            BusError: if the key holds a wildcard, the message is too long or the bus is closed.
        """
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._declare(key)
        publisher.seq += 1
        now_ns = MonotonicClock.realtime_ns()
        stamp = _ATTACHMENT.pack(publisher.seq, now_ns, _GID_SIZE, publisher.gid)
        try:
            publisher.handle.put(topics.check_size(data), attachment=stamp)
        except zenoh.ZError as error:
            raise BusError(f"cannot publish {key}: {error}") from error

    def subscribe(self, key: str, depth: int = 1, keep: Keep | None = None) -> "Subscription":
        """Receive a key's newest ``depth`` samples; what is not kept displaces none.

        ``keep`` runs in a thread of its own: whoever sends faster than it decides is held back on
        their own connection.
        """
        if keep is None:
            ring: Any = zenoh.handlers.RingChannel(depth)
            handle = self._ask(lambda: self._session.declare_subscriber(key, ring))
            return Subscription(handle, handle.try_recv)
        kept: deque[zenoh.Sample] = deque(maxlen=depth)

        def take(sample: zenoh.Sample) -> None:
            if keep(sample.payload.to_bytes()):
                kept.append(sample)

        handler: Any = zenoh.handlers.Callback(take)
        handle = self._ask(lambda: self._session.declare_subscriber(key, handler))
        return Subscription(handle, lambda: kept.popleft() if kept else None)

    def declare_alive(self, key: str) -> None:
        """Show a liveliness token until the bus is closed or this process dies."""
        self._held.append(
            self._ask(lambda: self._session.liveliness().declare_token(topics.check_key(key)))
        )

    def alive(self, key: str) -> frozenset[str]:
        """Give the tokens that are alive now; waits up to a second for the peers' answers."""
        replies = self._ask(lambda: self._session.liveliness().get(key, timeout=1.0))
        return frozenset(str(r.ok.key_expr) for r in replies if r.ok is not None)

    def serve(self, key: str, answer: Answer) -> None:
        """Answer queries to a key; ``answer`` runs in zenoh's callback thread."""

        def reply(query: zenoh.Query) -> None:
            with query:
                key = str(query.key_expr)
                value = answer(key)
                if value is not None:
                    query.reply(key, value)

        self._held.append(self._ask(lambda: self._session.declare_queryable(key, reply)))

    def query(self, key: str, timeout_s: float = 1.0) -> dict[str, bytes]:
        """Ask for values, by key; only keys that ``key`` matches are answered."""
        replies = self._ask(lambda: self._session.get(key, timeout=timeout_s))
        return {str(r.ok.key_expr): r.ok.payload.to_bytes() for r in replies if r.ok is not None}

    def close(self) -> None:
        """Leave the bus, in bounded time; a second close does nothing.

        Raises:
            BusError: if zenoh does not close within two seconds.
        """
        if self._closed:
            return
        self._closed = True
        worker = threading.Thread(target=self._session.close, daemon=True)
        worker.start()
        worker.join(_CLOSE_TIMEOUT_S)
        if worker.is_alive():
            raise BusError(f"zenoh did not close within {_CLOSE_TIMEOUT_S:.0f} s")

    def _declare(self, key: str) -> "_Publisher":
        topic = topics.find_topic(topics.check_key(key))
        encoding = zenoh.Encoding.APPLICATION_CDR
        if topic is not None:
            encoding = encoding.with_schema(type_name(topic.message))
        priority = getattr(zenoh.Priority, topic.priority if topic else "DATA")
        drop = zenoh.CongestionControl.DROP
        handle = self._ask(lambda: self._session.declare_publisher(
            key, encoding=encoding, priority=priority, congestion_control=drop
        ))  # fmt: skip
        gid = blake2b((self.zid + key).encode(), digest_size=_GID_SIZE).digest()
        return _Publisher(handle, gid)

    def _ask(self, call: Callable[[], Any]) -> Any:
        if self._closed:
            raise BusError("the bus is closed")
        try:
            return call()
        except zenoh.ZError as error:
            raise BusError(f"zenoh refuses: {error}") from error


@dataclass(slots=True)
class _Publisher:
    handle: Any
    gid: bytes
    seq: int = 0


class Subscription:
    """The newest samples of a key."""

    def __init__(self, handle: Any, take: Callable[[], zenoh.Sample | None]) -> None:
        self._handle, self._take = handle, take  # zenoh withdraws what nobody refers to

    def poll(self) -> list[Sample]:
        """Take what has arrived since the last poll, oldest first; never waits."""
        taken = []
        while (sample := self._take()) is not None:
            taken.append(_make_sample(sample))
        return taken


def _make_sample(sample: zenoh.Sample) -> Sample:
    raw = sample.attachment.to_bytes() if sample.attachment is not None else b""
    whole = len(raw) == _ATTACHMENT.size
    seq, sent_ns, _, sender = _ATTACHMENT.unpack(raw) if whole else (0, 0, 0, b"")
    return Sample(str(sample.key_expr), sample.payload.to_bytes(), seq, sent_ns, sender)


def _open(profile: Profile) -> zenoh.Session:
    config = zenoh.Config()
    try:
        for key, value in make_settings(profile).items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise BusError(_explain(profile, str(error))) from error


def _explain(profile: Profile, text: str) -> str:
    if "already in use" in text:
        return f"{profile.endpoint} is already in use: is another steerd running?"
    if not profile.hub and "connect" in text.lower():
        return f"nobody listens at {profile.endpoint}: is steerd running?"
    return f"zenoh does not start: {text}"


def _check_private(profile: Profile) -> None:
    protocol, _, address = profile.endpoint.partition("/")
    if protocol == "unixsock-stream" or (protocol in ("tls", "quic") and profile.lab):
        return
    if not is_private(address.rpartition(":")[0].strip("[]")):
        raise BusError(
            f"{profile.endpoint} lets anybody on the network drive the car: "
            "use --lab with a folder of steerd keys, or --insecure-lan if you mean it"
        )
