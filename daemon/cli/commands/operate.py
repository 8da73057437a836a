"""Operators' commands to a running daemon, and its state."""

# Why: docs/decisions/safety.md#d27

import contextlib
import getpass
import json
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping
from math import inf

from steerd.daemon.cli.arguments import add_car_arguments, option
from steerd.daemon.common.errors import ExitCode, SteerdError, UsageError
from steerd.daemon.common.screen import wrap
from steerd.daemon.ipc.requests import make_badge
from steerd.daemon.ipc.signals import is_left, raise_on_stop_signals
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process import bus_operator
from steerd.daemon.process.bus_operator import KEEPALIVE_NS, CarView, connect, read_model
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import RequestKind, Transition
from steerd.steer_bus.topics import make_key

ANSWER_NS = 1_500_000_000  # a request that has no effect after this was refused [ns]
REST_NS = 5_000_000_000  # a car comes to rest within this [ns]
LABEL = 13  # columns of the labels of a status
_LATCHED = (SupervisorState.FAULT_LATCHED, SupervisorState.ESTOP)
_HOLDING = (RequestKind.ARM, RequestKind.START)  # commands that stay as the deadman
_WANTED = {
    RequestKind.ARM: (SupervisorState.ARMED,),
    RequestKind.START: (SupervisorState.RUNNING,),
    RequestKind.DISARM: (SupervisorState.STOPPING, SupervisorState.DISARMED, SupervisorState.READY),
    RequestKind.CLEAR: (SupervisorState.DISARMED, SupervisorState.READY),
}


def operate_arguments(parser: ArgumentParser) -> None:
    add_car_arguments(parser)
    option(parser, "--no-hold", "", "arm, start: do not stay (cars without a deadman only)")


def operate(args: Namespace) -> int:
    """Operate a running daemon: arm, start, stop, disarm, clear, estop.

    `steerd start` keeps the car driving as its deadman: Ctrl-C, closing the
    terminal or losing the connection stops the car. `steerd arm` waits until the
    car is armed and holds it armed until Ctrl-C or until somebody starts it.

    A car that nobody holds stops after 0.3 s, so two short commands cannot hand
    it over: `--no-hold` is refused unless it is simulated or has no deadman.

    `steerd stop` and `steerd estop` work for everybody, whoever holds the car:
    they ask at once and again until the car is seen to stop; exit code 0 says so.
    """
    # A closed terminal means that the operator has left: end at once, the deadman stops the car.
    raise_on_stop_signals()
    clock, kind = MonotonicClock(), RequestKind[args.command.upper()]
    with connect(args.connect, args.lab) as bus:
        if kind in bus_operator.STOPS:
            pulse = bus_operator.Pulse(bus, args.name)
            operator = bus_operator.BusOperator(bus, args.name, clock, getpass.getuser(), pulse)
            operator.ask(0, kind)  # before anything is known of the car, and whatever it says
            return _stop(_Link(CarView(bus, args.name, clock), operator), kind)
        view = CarView(bus, args.name, clock).wait_heard(state=True)
        if kind in _HOLDING and args.no_hold and view.values.get("leased") == "1":
            what = f"{args.command} --no-hold: this car has a deadman and would stop after 0.3 s "
            hint = "`steerd arm` in one terminal and `steerd start` in another, both left open; "
            hint += "a car without a deadman says `deadman = false` under [safety]"
            raise UsageError(f"{what}without one", hint)
        if kind is RequestKind.START and view.mode is not SupervisorState.ARMED:
            waiting = view.values.get("waiting")
            hint = "steerd clear" if view.mode in _LATCHED else "steerd arm"
            what = f"the car is {view.mode_name}, not ARMED; it is waiting for {waiting}"
            raise SteerdError(what, hint, ExitCode.STOPPED)
        holder, kept = view.values.get("holder", "0"), bus_operator.recall_lease(args.name)
        shared = kind is RequestKind.START and holder == str(make_badge(bus.who, kept))
        operator = bus_operator.BusOperator(
            bus, args.name, clock, getpass.getuser(), view.pulse, kept if shared else 0
        )
        link = _Link(view, operator)
        link.send(kind)
        if not link.wait(lambda: view.mode in _WANTED[kind], ANSWER_NS):
            raise _make_refusal(view, kind)
        if kind is RequestKind.ARM:
            bus_operator.keep_lease(args.name, operator.secret)
        if kind in _HOLDING and not args.no_hold:
            return _hold(link, arm=kind is RequestKind.ARM)
        print(view.mode_name)
        return ExitCode.OK


class _Link:
    """One operator on the bus and what they see of the car."""

    def __init__(self, view: CarView, operator: bus_operator.BusOperator) -> None:
        self.view, self.operator = view, operator
        self._changes = view.bus.subscribe(make_key(view.car, topics.TRANSITION), 32)
        self._alive_ns = 0

    def send(self, kind: RequestKind) -> None:
        self.operator.ask(self.view.boot_id, kind)

    def wait(self, done: Callable[[], bool], limit_ns: int | None, *, hold: bool = True) -> bool:
        """Keep the lease alive, repeat a stop and receive until `done` or the time is over."""
        clock = self.view.clock
        end = inf if limit_ns is None else clock.now_ns() + limit_ns
        while not done():
            if (now := clock.now_ns()) > end:
                return False
            if hold and is_left():  # nobody is there who could press Ctrl-C
                raise KeyboardInterrupt
            if hold and now - self._alive_ns >= KEEPALIVE_NS:
                self._alive_ns = now
                self.send(RequestKind.KEEPALIVE)
            self.operator.repeat(self.view.mode)
            clock.sleep_until_ns(now + bus_operator.REPEAT_NS // 2)
            for sample in self._changes.poll():
                with contextlib.suppress(ValueError):  # what cannot be read, of another version
                    change = decode(Transition, sample.data)
                    name = SupervisorState(change.to_state).name
                    print(f"{name:<14}{change.text}", file=sys.stderr)
            self.view.poll()
        return True


def _stop(link: _Link, kind: RequestKind) -> int:
    """Call for a stop until the car shows it; the request is out before anything was received."""
    link.wait(lambda: not link.operator.repeat(link.view.mode), None, hold=False)
    if link.view.mode in bus_operator.STOPS[kind]:
        print(link.view.mode_name)
        return ExitCode.OK
    if link.view.mode is None:
        sent = f"{kind.name.lower()} was sent for {bus_operator.CALL_NS * 1e-9:.0f} s"
        what = f"{sent}, and no car {link.view.car!r} shows it"
        hint = "look at the car; is it called so? name it with --name"
        raise SteerdError(what, hint, ExitCode.UNREACHABLE)
    raise _make_refusal(link.view, kind)


def _make_refusal(view: CarView, kind: RequestKind) -> SteerdError:
    what = f"{kind.name.lower()}: the car stays {view.mode_name}: {view.values.get('reason', '')}"
    what += f"; it is waiting for {view.values.get('waiting', '')}"
    hint = "only operators of the lab may" if view.bus.who else "steerd status"
    return SteerdError(what, "steerd clear" if view.mode in _LATCHED else hint, ExitCode.STOPPED)


def _hold(link: _Link, *, arm: bool) -> int:
    """Stay as the deadman until the requested state is left."""
    stay = SupervisorState.ARMED if arm else SupervisorState.RUNNING
    kept = (stay, SupervisorState.RUNNING, SupervisorState.STOPPING)
    doing = "armed: `steerd start` from another terminal" if arm else "driving"
    print(f"{doing}; Ctrl-C {'disarms' if arm else 'stops'}", file=sys.stderr)
    try:
        link.wait(lambda: link.view.mode not in kept, None)
    except KeyboardInterrupt:
        link.send(RequestKind.DISARM if arm else RequestKind.STOP)
        link.wait(lambda: link.view.mode is not stay, ANSWER_NS)
        link.wait(lambda: link.view.mode is not SupervisorState.STOPPING, REST_NS)
    print(link.view.mode_name)
    return ExitCode.STOPPED if link.view.mode in _LATCHED else ExitCode.OK


def status_arguments(parser: ArgumentParser) -> None:
    add_car_arguments(parser)
    option(parser, "--json", "", "for programs")


def status(args: Namespace) -> None:
    """State of a running daemon, and what it is waiting for."""
    from steerd.daemon.learning.reported import encode_model, format_model  # no stop waits for it

    with connect(args.connect, args.lab) as bus:
        said = CarView(bus, args.name, MonotonicClock()).wait_heard().values
        model = read_model(bus, args.name)
    if args.json:
        print(json.dumps({**said, **(encode_model(model) if model else {})}, indent=2))
        return
    print("\n".join(format_status(args.name, said)))
    if model is not None:
        print("\n".join(format_model(model)))


def format_status(name: str, status: Mapping[str, str]) -> list[str]:
    """A car's diagnostics, as the daemon publishes them, as lines of at most 80 columns."""
    from steerd.daemon.learning.reported import design_text

    firmware, uuid = status.get("firmware", "?"), status.get("uuid", "?")
    items = [
        ("waiting for", status["waiting"]),
        *(("warning", text) for text in status.get("warnings", "").splitlines() if text),
        ("VESC", f"firmware {firmware}, timeout {status.get('vesc_timeout_ms', '?')} ms"),
        ("UUID", uuid),
        ("mocap", f"{status.get('mocap', '?')}, {status.get('mocap_rate_hz', '?')} Hz"),
        ("controller", status.get("controller", "?")),
        *((("design", design_text(status)),) if "design" in status else ()),
    ]
    lines = wrap(status["reason"], f"{name}: {status['state']} — ", " " * LABEL)
    for label, text in items:
        lines += wrap(text, f"{label + ':':<{LABEL}}", " " * LABEL)
    return lines
