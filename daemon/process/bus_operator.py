"""An operator on the bus: a lease of their own with each run of the car, and stops that arrive."""

# Why: docs/decisions/safety.md#d112

import contextlib
import secrets
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import platformdirs

from steerd.daemon.ipc.operator import Operator
from steerd.daemon.ipc.requests import make_badge
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import topics
from steerd.steer_bus.atomic_file import write_atomically
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.messages import Heartbeat, RequestKind
from steerd.steer_bus.topics import Topic, check_car_name, make_key
from steerd.steer_bus.zenoh_bus import ZenohBus

STOPS = {
    RequestKind.STOP: (
        SupervisorState.STOPPING,
        SupervisorState.ARMED,
        SupervisorState.DISARMED,
        SupervisorState.READY,
    ),
    RequestKind.ESTOP: (SupervisorState.ESTOP,),
}
"""Requests that are repeated until the car shows one of these states."""
REPEAT_NS = 20_000_000
"""Time between two requests of one call for a stop."""
SURE_NS = 100_000_000
"""A stop is repeated for so long whatever is seen: what is seen may be older than the call."""
CALL_NS = 5_000_000_000
"""A call for a stop ends after this time, seen or not."""


class Pulse:
    """A car's heartbeats, which whoever keeps a lease alive sends back."""

    def __init__(self, bus: ZenohBus, car: str) -> None:
        self._bus, self._key = bus, make_key(car, topics.HEARTBEAT_BACK, bus.who)
        self._beats = bus.subscribe(make_key(car, topics.HEARTBEAT))
        self._newest: Heartbeat | None = None

    def send_back(self, lease_id: int) -> None:
        """Send the newest back; nothing from a car that has none."""
        for sample in self._beats.poll():
            with contextlib.suppress(CodecError):
                self._newest = decode(Heartbeat, sample.data)
        if self._newest is not None:
            self._bus.publish(self._key, encode(replace(self._newest, lease_id=lease_id)))


class BusOperator:
    """Requests of one person at one place; a lease begins with the first of each run.

    `pulse` is the car's, at this place; `lease_id` that of a lease that is shared, 0 draws one.
    """

    def __init__(
        self, bus: ZenohBus, car: str, clock: Clock, name: str, pulse: Pulse, lease_id: int = 0
    ) -> None:
        self._bus, self._car, self._clock, self._name = bus, car, clock, name
        self._pulse, self._lease_id = pulse, lease_id
        self._operator: Operator | None = None
        self._stop: RequestKind | None = None
        self._called_ns = self._sent_ns = 0

    @property
    def lease(self) -> str:
        """The lease, as the car's `holder` names it; empty before the first request."""
        known = self._operator
        return str(make_badge(self._bus.who, known.lease_id)) if known else ""

    @property
    def secret(self) -> int:
        """The lease id, which only its holder knows; 0 before the first request."""
        return self._operator.lease_id if self._operator else 0

    def ask(self, boot_id: int, kind: RequestKind) -> bool:
        """Send a request; False before the car's run is known (`boot_id` 0).

        A stop needs to know nothing of the car, and begins a call that `repeat` goes on with.
        """
        if kind in STOPS:
            self._stop, self._called_ns = kind, self._clock.now_ns()
            self._send_stop(kind, self._called_ns)
            return True
        if kind is not RequestKind.KEEPALIVE:
            self._stop = None
        sent = self._send(
            boot_id, topics.OPERATOR, lambda op: op.make_request(kind, self._clock.realtime_ns())
        )
        if sent and kind is RequestKind.KEEPALIVE:
            self._pulse.send_back(self.secret)
        return sent

    def repeat(self, state: int | None) -> bool:
        """Go on with the call for a stop, if there is one: whether it goes on.

        `state` is the car's, as last seen.
        """
        kind, now = self._stop, self._clock.now_ns()
        if kind is None:
            return False
        called = now - self._called_ns
        if called >= CALL_NS or (called >= SURE_NS and state in STOPS[kind]):
            self._stop = None
        elif now - self._sent_ns >= REPEAT_NS:
            self._send_stop(kind, now)
        return self._stop is not None

    def tune(self, boot_id: int, wanted: Mapping[str, float]) -> bool:
        """Send a request for other live parameters; False before the car's run is known."""
        return self._send(
            boot_id,
            topics.SET_PARAMETERS,
            lambda op: op.make_parameters(wanted, self._clock.realtime_ns()),
        )

    def _send_stop(self, kind: RequestKind, now_ns: int) -> None:
        self._sent_ns = now_ns
        operator = self._operator or Operator(0, 0, self._name)
        self._publish(topics.STOP, operator.make_request(kind, self._clock.realtime_ns()))

    def _send(self, boot_id: int, topic: Topic, make: Callable[[Operator], bytes]) -> bool:
        if not boot_id:
            return False
        if self._operator is None or self._operator.boot_id != boot_id:
            lease_id, self._lease_id = self._lease_id or secrets.randbits(62) + 1, 0
            self._operator = Operator(boot_id, lease_id, self._name)
            self._operator.seq = self._clock.realtime_ns() // 1_000_000 % 2_000_000_000
        self._publish(topic, make(self._operator))
        return True

    def _publish(self, topic: Topic, request: bytes) -> None:
        self._bus.publish(make_key(self._car, topic, self._bus.who), request)


def keep_lease(car: str, lease_id: int) -> None:
    """Keep a lease id for this user's other terminals; without a folder there is no sharing."""
    path = _lease_path(car)
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, str(lease_id), 0o600)


def recall_lease(car: str) -> int:
    """The lease id that this user's terminal kept last; 0 without one."""
    with contextlib.suppress(OSError, ValueError):
        return int(_lease_path(car).read_text(encoding="ascii"))
    return 0


def _lease_path(car: str) -> Path:
    return platformdirs.user_state_path("steerd") / f"lease-{check_car_name(car)}"
