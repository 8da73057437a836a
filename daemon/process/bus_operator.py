"""Operators: requests under a lease; on the bus also what a car shows, and stops that arrive."""

# Why: docs/decisions/safety.md#d112

import contextlib
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import nan
from pathlib import Path
from typing import Any

import platformdirs

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.requests import LIVE, make_badge, read_diagnostics
from steerd.daemon.loop.transitions import ARMED, DISARMED, ESTOP, READY, STOPPING, SupervisorState
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.atomic_file import write_atomically
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.lab import DEFAULT_PORT, Lab, load_lab
from steerd.steer_bus.messages import RequestKind
from steerd.steer_bus.standard import DiagnosticArray
from steerd.steer_bus.topics import BusError, Topic, check_car_name, make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus

DEFAULT_ENDPOINT = f"tcp/127.0.0.1:{DEFAULT_PORT}"
MODEL_WAIT_S = 0.5  # longest wait for the learner's newest report [s]
KEEPALIVE_NS = 50_000_000  # time between keepalives; the lease lasts 300 ms
STOPS = {RequestKind.STOP: (STOPPING, ARMED, DISARMED, READY), RequestKind.ESTOP: (ESTOP,)}
"""Requests that are repeated until the car shows one of these states."""
REPEAT_NS = 20_000_000  # time between two requests of one call for a stop
SURE_NS = 100_000_000
"""A stop is repeated for so long whatever is seen: what is seen may be older than the call."""
CALL_NS = 5_000_000_000  # a call for a stop ends after this time, seen or not
STATUS_NS = 2_000_000_000  # a car on the bus says how it is within this
EVENTS = 8  # state changes that are kept for a page that opens later
_SHOWN = (topics.STATE, topics.VESC, topics.TRANSITION, topics.DIAGNOSTICS, topics.PARAMETERS)


@dataclass
class Operator:
    """One person at one terminal."""

    boot_id: int  # of the addressed run
    lease_id: int  # random, not zero
    name: str = "operator"  # for the recording
    seq: int = 0  # sequence number of the last request

    def make_request(self, kind: RequestKind, realtime_ns: int) -> bytes:
        """The next request, encoded."""
        return encode(m.OperatorRequest(*self._begin(realtime_ns), int(kind), self.name))

    def make_parameters(
        self, wanted: Mapping[str, float], realtime_ns: int, name: str = ""
    ) -> bytes:
        """The next request as one for other live parameters, encoded; what is not named stays.

        `wanted` has `speed` [m/s], `offset` [m], `gain`; `name` is who asks, where not the holder.
        """
        speed, offset, gain = (wanted.get(each, nan) for each in LIVE)
        start, who = self._begin(realtime_ns), name or self.name
        return encode(m.ParameterRequest(*start, speed, offset, gain, who))

    def _begin(self, realtime_ns: int) -> tuple[m.Header, int, int, int]:
        self.seq += 1
        return m.make_header(realtime_ns, m.BODY), self.boot_id, self.lease_id, self.seq


def connect(given_endpoint: str | None, folder: Path | None, first: str = "steerd run") -> ZenohBus:
    """Join the bus of a running daemon, which the command `first` starts.

    Its endpoint is that of `folder` (of `steerd keys`) where none is given, else this machine's.

    Raises:
        SteerdError: none answers, or it refuses our certificate.
    """
    lab = read_lab(folder) if folder else None
    endpoint = given_endpoint or (lab.endpoint if lab else DEFAULT_ENDPOINT)
    try:
        return ZenohBus(Profile(False, endpoint, lab))
    except BusError as error:
        hint = f"start `{first}` first, or name its endpoint with --connect"
        if lab is not None:
            hint = f"is it up with --lab, and is {lab.folder} of the same lab and in date?"
        raise SteerdError(f"no steerd answers: {error}", hint, ExitCode.UNREACHABLE) from None


def read_lab(folder: Path) -> Lab:
    """A participant's folder; SteerdError if it is none."""
    try:
        return load_lab(folder)
    except BusError as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None


def read_model(bus: ZenohBus, car: str) -> m.Model | None:
    """The newest report of a car's learner; None without one, or one of another version."""
    for data in bus.query(make_key(car, topics.LAST_MODEL), MODEL_WAIT_S).values():
        with contextlib.suppress(CodecError):
            return decode(m.Model, data)
    return None


class Pulse:
    """A car's heartbeats, which whoever keeps a lease alive sends back."""

    def __init__(self, bus: ZenohBus, car: str) -> None:
        self._bus, self._key = bus, make_key(car, topics.HEARTBEAT_BACK, bus.who)
        self._beats = bus.subscribe(make_key(car, topics.HEARTBEAT))
        self._newest: m.Heartbeat | None = None

    def send_back(self, lease_id: int) -> None:
        """Send the newest back; nothing from a car that has none."""
        for sample in self._beats.poll():
            with contextlib.suppress(CodecError):
                self._newest = decode(m.Heartbeat, sample.data)
        if self._newest is not None:
            self._bus.publish(self._key, encode(replace(self._newest, lease_id=lease_id)))


@dataclass
class CarView:
    """The newest of a car, from the bus."""

    bus: ZenohBus
    car: str
    clock: Clock
    values: dict[str, str] = field(default_factory=dict)  # of the supervisor's diagnostics
    boot_id: int = 0  # of the car's run; 0 before it is known
    state: m.StateMessage | None = None  # the newest message, as the next two
    vesc: m.VescTelemetry | None = None
    parameters: m.Parameters | None = None
    heard_ns: int | None = None  # when the last message came; None before the first
    events: list[str] = field(default_factory=list)  # the last state changes, as sentences

    def __post_init__(self) -> None:
        self.pulse = Pulse(self.bus, self.car)
        self._wanted = [
            (self.bus.subscribe(make_key(self.car, topic)), topic.message) for topic in _SHOWN
        ]

    def poll(self) -> None:
        """Take in what has come; what cannot be read, of another version, is left out."""
        for subscription, message in self._wanted:
            for sample in subscription.poll():
                self.heard_ns = self.clock.now_ns()
                try:
                    self._take(decode(message, sample.data))
                except (ValueError, SteerdError):
                    continue

    def wait_heard(self, *, state: bool = False) -> "CarView":
        """Wait for the car's diagnostics, with `state` for that too; SteerdError if none come."""
        end_ns = self.clock.now_ns() + STATUS_NS
        while not self.values or (state and self.state is None):
            if self.clock.now_ns() > end_ns:
                hint = f"is the car called {self.car!r}? name it with --name"
                raise SteerdError(f"no car {self.car!r} on the bus", hint, ExitCode.UNREACHABLE)
            self.clock.sleep_until_ns(self.clock.now_ns() + REPEAT_NS // 2)
            self.poll()
        return self

    @property
    def mode(self) -> SupervisorState | None:
        """The supervisor's state; None before it is known."""
        return None if self.state is None else SupervisorState(self.state.mode)

    @property
    def mode_name(self) -> str:
        """The state's name; `?` before it is known."""
        return "?" if self.mode is None else self.mode.name

    def _take(self, message: Any) -> None:
        """Take in a message; one of another version raises ValueError or SteerdError."""
        match message:
            case m.StateMessage(mode=mode):
                SupervisorState(mode)
                self.state = message
            case m.VescTelemetry():
                self.vesc = message
            case m.Parameters():
                self.parameters = message
            case m.Transition(to_state=state, text=text):
                name = SupervisorState(state).name.lower().replace("_", " ")
                self.events = [*self.events, f"{name}: {text}"][-EVENTS:]
            case DiagnosticArray():
                values = read_diagnostics(message)
                self.boot_id, self.values = int(values.get("boot_id", "0") or 0), values


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
        operator = self._of_run(boot_id)
        if operator is None:
            return False
        self._publish(topics.OPERATOR, operator.make_request(kind, self._clock.realtime_ns()))
        if kind is RequestKind.KEEPALIVE:
            self._pulse.send_back(operator.lease_id)
        return True

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
        operator = self._of_run(boot_id)
        if operator is None:
            return False
        request = operator.make_parameters(wanted, self._clock.realtime_ns())
        self._publish(topics.SET_PARAMETERS, request)
        return True

    def _send_stop(self, kind: RequestKind, now_ns: int) -> None:
        self._sent_ns = now_ns
        operator = self._operator or Operator(0, 0, self._name)
        self._publish(topics.STOP, operator.make_request(kind, self._clock.realtime_ns()))

    def _of_run(self, boot_id: int) -> Operator | None:
        """The lease with a run, which begins here if it is another; None with none."""
        if not boot_id:
            return None
        if self._operator is None or self._operator.boot_id != boot_id:
            lease_id, self._lease_id = self._lease_id or secrets.randbits(62) + 1, 0
            seq = self._clock.realtime_ns() // 1_000_000 % 2_000_000_000
            self._operator = Operator(boot_id, lease_id, self._name, seq)
        return self._operator

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
