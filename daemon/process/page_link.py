"""What the live page shows of a car, and what its buttons ask for.

The bus on one side, JSON values on the other; no socket of a browser here.
"""

from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.requests import LIVE, parse_setting, read_diagnostics
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import BusOperator, Pulse
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.codec import decode
from steerd.steer_bus.standard import DiagnosticArray
from steerd.steer_bus.topics import make_key
from steerd.steer_bus.zenoh_bus import ZenohBus
from steerd.vesc_link.ids import fault_name

EVENTS = 8
"""State changes that are kept for a page that opens later."""
NAME = "page"
"""Of the page's operators, in recordings."""
_KINDS = {
    "alive": m.RequestKind.KEEPALIVE, "arm": m.RequestKind.ARM, "start": m.RequestKind.START,
    "stop": m.RequestKind.STOP, "disarm": m.RequestKind.DISARM, "clear": m.RequestKind.CLEAR,
    "estop": m.RequestKind.ESTOP,
}  # fmt: skip
_SHOWN = (topics.STATE, topics.VESC, topics.TRANSITION, topics.DIAGNOSTICS, topics.PARAMETERS)
_NUMBERS = ("x", "y", "yaw", "speed", "e1", "e2", "steer", "steer_ref", "speed_ref", "path_s")
_TEXTS = ("state", "reason", "waiting", "warnings", "holder", "leased", "mocap", "mocap_rate_hz")


@dataclass
class CarView:
    """The newest of a car, from the bus."""

    bus: ZenohBus
    car: str
    clock: Clock
    values: dict[str, str] = field(default_factory=dict)  # of the supervisor's diagnostics
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

    @property
    def boot_id(self) -> int:
        """Of the car's run; 0 before it is known."""
        return int(self.values.get("boot_id", "0") or 0)

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
                int(values.get("boot_id", "0") or 0)
                self.values = values

    def snapshot(self) -> dict[str, Any]:
        """What the page shows, as JSON values; unknown numbers are None."""
        now = self.clock.now_ns()
        shown: dict[str, Any] = {name: self.values.get(name, "") for name in _TEXTS}
        if self.state is not None:
            shown["state"] = SupervisorState(self.state.mode).name
            shown |= {name: _finite(getattr(self.state, name)) for name in _NUMBERS}
        if self.vesc is not None:
            code = self.vesc.fault_code
            shown["battery"], shown["amps"] = (
                _finite(self.vesc.v_in), _finite(self.vesc.current_motor),
            )  # fmt: skip
            shown["fault"] = fault_name(code) if code > 0 else ""
        shown["live"] = {} if self.parameters is None else _show_live(self.parameters)
        silent = 0.0 if self.heard_ns is None else (now - self.heard_ns) * 1e-9
        return shown | {"silent": round(silent, 2), "events": self.events}


def _show_live(p: m.Parameters) -> dict[str, Any]:
    """Live parameters as value, least and most, and the answer to the last request."""
    shown: dict[str, Any] = {
        name: [_finite(getattr(p, name + end)) for end in ("", "_min", "_max")] for name in LIVE
    }
    return {**shown, "text": p.text, "refused": bool(p.seq) and not p.accepted}


def _finite(value: float) -> float | None:
    return round(value, 5) if isfinite(value) else None


def make_page_operator(view: CarView) -> BusOperator:
    """The operator of an open page, as any other.

    Nothing is sent by itself, but a stop again until it is seen: every keepalive on the bus is one
    that the browser sent. A tab that is closed, hidden, frozen or cut off is silent, and the lease
    ends 0.3 s later.
    """
    return BusOperator(view.bus, view.car, view.clock, NAME, view.pulse)


def pass_on(view: CarView, operator: BusOperator, word: str) -> bool:
    """Send a request of a page: one of its words, or `set NAME VALUE`.

    Returns:
        Whether it was sent; not for words that are no request, and only a stop before the car was
        heard.
    """
    wanted = parse_setting(word)
    if wanted is not None:
        return operator.tune(view.boot_id, wanted)
    kind = _KINDS.get(word)
    return kind is not None and operator.ask(view.boot_id, kind)
