"""An operator's side of the lease: requests with rising numbers under one id."""

import contextlib
import secrets
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import nan
from pathlib import Path

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.diagnostics import read_diagnostics
from steerd.steer_bus import topics
from steerd.steer_bus.bus import Bus, BusError
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.codec import CodecError, decode, encode
from steerd.steer_bus.lab import DEFAULT_PORT, Lab, load_lab
from steerd.steer_bus.messages import (
    BODY,
    Heartbeat,
    Model,
    OperatorRequest,
    ParameterRequest,
    RequestKind,
    make_header,
)
from steerd.steer_bus.standard import DiagnosticArray
from steerd.steer_bus.topics import LAST_MODEL, Topic, make_key
from steerd.steer_bus.zenoh_bus import ZenohBus, make_spoke_profile

DEFAULT_ENDPOINT = f"tcp/127.0.0.1:{DEFAULT_PORT}"

MODEL_WAIT_S = 0.5
"""Longest wait for the learner's newest report [s]."""
KEEPALIVE_NS = 50_000_000
"""Time between keepalives; the lease lasts 300 ms."""


@dataclass
class Operator:
    """One person at one terminal.

    Attributes:
        boot_id: of the addressed run.
        lease_id: random, not zero.
        name: for the recording.
        seq: sequence number of the last request.
    """

    boot_id: int
    lease_id: int
    name: str = "operator"
    seq: int = 0

    def make_request(self, kind: RequestKind, realtime_ns: int) -> bytes:
        """The next request, encoded."""
        self.seq += 1
        header = make_header(realtime_ns, BODY)
        request = OperatorRequest(
            header, self.boot_id, self.lease_id, self.seq, int(kind), self.name
        )
        return encode(request)

    def make_parameters(self, wanted: Mapping[str, float], realtime_ns: int) -> bytes:
        """The next request as one for other live parameters, encoded.

        Args:
            wanted: `speed` [m/s], `offset` [m], `gain`; what is not named stays.
            realtime_ns: now.
        """
        self.seq += 1
        values = {"speed": nan, "offset": nan, "gain": nan, **wanted}
        header = make_header(realtime_ns, BODY)
        who = (self.boot_id, self.lease_id, self.seq)
        return encode(
            ParameterRequest(
                header, *who, values["speed"], values["offset"], values["gain"], self.name
            )
        )


class Pulse:
    """A car's heartbeats, which whoever keeps a lease alive sends back."""

    def __init__(self, bus: Bus, car: str) -> None:
        self._bus, self._key = bus, make_key(car, topics.HEARTBEAT_BACK)
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
    """An operator on the bus who begins a lease of their own with each run of the car."""

    def __init__(self, bus: Bus, car: str, clock: Clock, name: str, pulse: Pulse) -> None:
        self._bus, self._car, self._clock, self._name = bus, car, clock, name
        self._pulse = pulse
        self._operator: Operator | None = None

    @property
    def lease(self) -> str:
        """The lease, as the car's `holder` names it; empty before the first request."""
        return str(self._operator.lease_id) if self._operator else ""

    def ask(self, boot_id: int, kind: RequestKind) -> bool:
        """Send a request; False before the car's run is known (`boot_id` 0)."""
        sent = self._send(
            boot_id, topics.OPERATOR, lambda op: op.make_request(kind, self._clock.realtime_ns())
        )
        if self._operator is not None and kind is RequestKind.KEEPALIVE:
            self._pulse.send_back(self._operator.lease_id)
        return sent

    def tune(self, boot_id: int, wanted: Mapping[str, float]) -> bool:
        """Send a request for other live parameters; False before the car's run is known."""
        return self._send(
            boot_id,
            topics.SET_PARAMETERS,
            lambda op: op.make_parameters(wanted, self._clock.realtime_ns()),
        )

    def _send(self, boot_id: int, topic: Topic, make: Callable[[Operator], bytes]) -> bool:
        if not boot_id:
            return False
        if self._operator is None or self._operator.boot_id != boot_id:
            self._operator = Operator(boot_id, secrets.randbits(62) + 1, self._name)
            self._operator.seq = self._clock.realtime_ns() // 1_000_000 % 2_000_000_000
        self._bus.publish(make_key(self._car, topic), make(self._operator))
        return True


def connect(given_endpoint: str | None, folder: Path | None, first: str = "steerd run") -> ZenohBus:
    """Join the bus of a running daemon.

    Args:
        given_endpoint: of the daemon; None for the lab's, or the one on this machine.
        folder: this machine's folder of `steerd keys`; None for plain loopback.
        first: the command that is to be started before.

    Raises:
        SteerdError: none answers, or it refuses our certificate.
    """
    lab = read_lab(folder) if folder else None
    endpoint = given_endpoint or (lab.endpoint if lab else DEFAULT_ENDPOINT)
    try:
        return ZenohBus(make_spoke_profile(endpoint, lab))
    except BusError as error:
        hint = f"start `{first}` first, or name its endpoint with --connect"
        if lab is not None:
            hint = f"is it up with --lab, and is {lab.folder} of the same lab and in date?"
        raise SteerdError(f"no steerd answers: {error}", hint, ExitCode.UNREACHABLE) from None


def read_lab(folder: Path) -> Lab:
    """A participant's folder.

    Raises:
        SteerdError: it is not one.
    """
    try:
        return load_lab(folder)
    except BusError as error:
        raise SteerdError(str(error), "", ExitCode.INVALID) from None


def read_status(bus: Bus, car: str, clock: Clock, timeout_s: float = 2.0) -> dict[str, str]:
    """The supervisor's values from the first diagnostics message that arrives.

    Raises:
        SteerdError: nothing arrived in time.
    """
    subscription = bus.subscribe(make_key(car, topics.DIAGNOSTICS))
    end = clock.now_ns() + round(timeout_s * 1e9)
    while clock.now_ns() < end:
        for sample in subscription.poll():
            return read_diagnostics(decode(DiagnosticArray, sample.data))
        clock.sleep_until_ns(clock.now_ns() + 10_000_000)
    hint = f"is the car called {car!r}? name it with --name"
    raise SteerdError(f"no car {car!r} on the bus", hint, ExitCode.UNREACHABLE)


def read_model(bus: Bus, car: str) -> Model | None:
    """The newest report of a car's learner; None without one, or one of another version."""
    for data in bus.query(make_key(car, LAST_MODEL), MODEL_WAIT_S).values():
        with contextlib.suppress(CodecError):
            return decode(Model, data)
    return None
