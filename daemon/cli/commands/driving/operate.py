"""Operate a running daemon: arm, start, stop, disarm, clear, estop.

`steerd start` keeps the car driving as its deadman: Ctrl-C, closing the
terminal or losing the connection stops the car. `steerd arm` waits until the
car is armed and holds it armed until Ctrl-C or until somebody starts it.

A car that nobody holds stops after 0.3 s, so two short commands cannot hand
it over: `--no-hold` is refused unless it is simulated or has no deadman.
"""

# Why: docs/decisions/safety.md#d27

import argparse
import getpass
import secrets
import sys
from collections.abc import Callable

from steerd.daemon.cli.bus_options import add_bus_arguments
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.diagnostics import read_diagnostics
from steerd.daemon.ipc.operator import (
    KEEPALIVE_NS,
    Operator,
    Pulse,
    connect,
    read_status,
)
from steerd.daemon.ipc.signals import raise_on_stop_signals
from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import topics
from steerd.steer_bus.bus import Bus
from steerd.steer_bus.clock import Clock, MonotonicClock
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import RequestKind, Transition
from steerd.steer_bus.standard import DiagnosticArray
from steerd.steer_bus.topics import make_key

ANSWER_NS = 1_500_000_000
"""A request that has no effect after this was refused [ns]."""
REST_NS = 5_000_000_000
"""A car comes to rest within this [ns]."""
_HOLDING = ("arm", "start")
"""Commands that stay as the deadman."""
_KINDS = {
    "arm": RequestKind.ARM,
    "start": RequestKind.START,
    "stop": RequestKind.STOP,
    "disarm": RequestKind.DISARM,
    "clear": RequestKind.CLEAR,
    "estop": RequestKind.ESTOP,
}
_WANTED = {
    "arm": (SupervisorState.ARMED,),
    "start": (SupervisorState.RUNNING,),
    "stop": (
        SupervisorState.STOPPING,
        SupervisorState.ARMED,
        SupervisorState.DISARMED,
        SupervisorState.READY,
    ),
    "disarm": (SupervisorState.STOPPING, SupervisorState.DISARMED, SupervisorState.READY),
    "clear": (SupervisorState.DISARMED, SupervisorState.READY),
    "estop": (SupervisorState.ESTOP,),
}
_OVER = (
    SupervisorState.DISARMED,
    SupervisorState.READY,
    SupervisorState.INIT,
    SupervisorState.FAULT_STOP,
    SupervisorState.FAULT_LATCHED,
    SupervisorState.ESTOP,
)


def add_car_arguments(parser: argparse.ArgumentParser) -> None:
    """Which car, and where."""
    add_bus_arguments(parser)
    parser.add_argument("--name", default="car1", help="the car's name")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of these commands."""
    add_car_arguments(parser)
    parser.add_argument(
        "--no-hold",
        action="store_true",
        help="arm, start: do not stay (cars without a deadman only)",
    )


class _Link:
    """One operator on the bus: sends requests, receives states, keeps the lease alive."""

    def __init__(self, bus: Bus, car: str, operator: Operator, clock: Clock) -> None:
        self._bus = bus
        self._operator = operator
        self._key = make_key(car, topics.OPERATOR)
        self._changes = bus.subscribe(make_key(car, topics.TRANSITION), 32)
        self._status = bus.subscribe(make_key(car, topics.DIAGNOSTICS))
        self._pulse = Pulse(bus, car)
        self._clock = clock
        self.state = SupervisorState.INIT
        self.values: dict[str, str] = {}
        self._show: Callable[[str], None] = lambda line: print(line, file=sys.stderr)

    def send(self, kind: RequestKind) -> None:
        self._bus.publish(self._key, self._operator.make_request(kind, self._clock.realtime_ns()))

    def receive(self) -> None:
        for sample in self._changes.poll():
            change = decode(Transition, sample.data)
            self.state = SupervisorState(change.to_state)
            self._show(f"{self.state.name:<14}{change.text}")
        for sample in self._status.poll():
            self.values = read_diagnostics(decode(DiagnosticArray, sample.data))
            self.state = SupervisorState[self.values["state"]]

    def wait(self, done: Callable[[], bool], limit_ns: int | None) -> bool:
        """Keep the lease alive and receive until `done` or the time is over."""
        end = None if limit_ns is None else self._clock.now_ns() + limit_ns
        while not done():
            now = self._clock.now_ns()
            if end is not None and now > end:
                return False
            self.send(RequestKind.KEEPALIVE)
            self._pulse.send_back(self._operator.lease_id)
            self._clock.sleep_until_ns(now + KEEPALIVE_NS)
            self.receive()
        return True


def run(args: argparse.Namespace) -> int:
    """Run the command."""
    # A closed terminal means that the operator has left: end at once, the deadman stops the car.
    raise_on_stop_signals()
    clock, name = MonotonicClock(), str(args.command)
    with connect(args.connect, args.lab) as bus:
        status = read_status(bus, args.name, clock)
        holder = int(status.get("holder", "0"))
        shared = name == "start" and status["state"] == SupervisorState.ARMED.name and holder
        lease = holder if shared else secrets.randbits(62) + 1
        operator = Operator(int(status["boot_id"]), lease, getpass.getuser())
        operator.seq = clock.realtime_ns() // 1_000_000 % 2_000_000_000
        link = _Link(bus, args.name, operator, clock)
        link.state, link.values = SupervisorState[status["state"]], status
        if name in _HOLDING and args.no_hold and status.get("leased") == "1":
            _refuse_unheld(name)
        if name == "start" and link.state is not SupervisorState.ARMED:
            _refuse_unarmed(link)
        return _request(link, name, hold=not args.no_hold)


def _refuse_unheld(name: str) -> None:
    raise SteerdError(
        f"{name} --no-hold: this car has a deadman and would stop after 0.3 s without one",
        "`steerd arm` in one terminal and `steerd start` in another, both left open; "
        "a car without a deadman says `deadman = false` under [safety]",
        ExitCode.USAGE,
    )


def _refuse_unarmed(link: _Link) -> None:
    raise SteerdError(
        f"the car is {link.state.name}, not ARMED; it is waiting for {link.values.get('waiting')}",
        "steerd arm",
        ExitCode.STOPPED,
    )


def _request(link: _Link, name: str, *, hold: bool) -> int:
    kind, wanted = _KINDS[name], _WANTED[name]
    link.send(kind)
    if not link.wait(lambda: link.state in wanted, ANSWER_NS):
        raise SteerdError(
            f"{name}: the car stays {link.state.name}: {link.values.get('reason', '')}; "
            f"it is waiting for {link.values.get('waiting', '')}",
            "steerd status",
            ExitCode.STOPPED,
        )
    if name in _HOLDING and hold:
        return _hold(link, name)
    print(link.state.name)
    return ExitCode.OK


def _hold(link: _Link, name: str) -> int:
    """Stay as the deadman until the requested state is left."""
    stay = SupervisorState.ARMED if name == "arm" else SupervisorState.RUNNING
    doing = "armed: `steerd start` from another terminal" if name == "arm" else "driving"
    print(f"{doing}; Ctrl-C {'disarms' if name == 'arm' else 'stops'}", file=sys.stderr)
    try:
        link.wait(lambda: link.state in _OVER or _has_left(link, stay), None)
    except KeyboardInterrupt:
        link.send(RequestKind.DISARM if name == "arm" else RequestKind.STOP)
        link.wait(lambda: link.state is not stay, ANSWER_NS)
        link.wait(lambda: link.state is not SupervisorState.STOPPING, REST_NS)
    print(link.state.name)
    return (
        ExitCode.STOPPED
        if link.state in (SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP)
        else ExitCode.OK
    )


def _has_left(link: _Link, stay: SupervisorState) -> bool:
    """Whether the state to hold has been left."""
    if stay is SupervisorState.ARMED:
        return link.state not in (
            SupervisorState.ARMED,
            SupervisorState.RUNNING,
            SupervisorState.STOPPING,
        )
    return link.state not in (SupervisorState.RUNNING, SupervisorState.STOPPING)
