"""Keys of a terminal as an operator's requests: the hold on a car, and its live parameters."""

import contextlib
import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import KEEPALIVE_NS
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.messages import Parameters, RequestKind

if TYPE_CHECKING:
    from steerd.daemon.terminal.dashboard import Dashboard

KEYS = {
    "a": RequestKind.ARM,
    "s": RequestKind.START,
    " ": RequestKind.STOP,
    "d": RequestKind.DISARM,
    "c": RequestKind.CLEAR,
    "e": RequestKind.ESTOP,
}
KEY_HELP = "[a]rm  [s]tart  [space] stop  [d]isarm  [c]lear  [e]stop"
NUDGES = {
    "+": ("speed", 0.1), "=": ("speed", 0.1), "-": ("speed", -0.1),
    "<": ("offset", 0.01), ",": ("offset", 0.01), ">": ("offset", -0.01), ".": ("offset", -0.01),
    "]": ("gain", 0.1), "[": ("gain", -0.1),
}  # fmt: skip
"""Live parameters, and by how much a key changes them [m/s, m, -]."""
BACK = "0"  # this key asks for the path and the designed feedback again
NUDGE_HELP = "speed [-][+]  lane left [<] right [>]  gain [[][]]  path and gain back [0]"
_HELD = tuple(SupervisorState[name] for name in ("SELF_TEST", "ARMED", "RUNNING", "STOPPING"))
_ANSWER_NS = 1_500_000_000  # a car that is in no held state after this time refused to arm


def nudge(parameters: Parameters, wanted: Mapping[str, float], key: str) -> dict[str, float]:
    """The values that a key of `NUDGES`, or `BACK`, asks for: a step on, or to the bound before it.

    At the bound itself the step goes beyond it, so that the car says why it is refused.
    `parameters` are as the car answered last, `wanted` is what was asked for since.
    """
    if key == BACK:
        return {"offset": 0.0, "gain": 1.0}
    name, step = NUDGES[key]
    now = wanted.get(name, getattr(parameters, name))
    low, high = getattr(parameters, f"{name}_min"), getattr(parameters, f"{name}_max")
    aim = round((now + step) / abs(step)) * abs(step)
    bound = high if step > 0.0 else low
    beyond = aim > high if step > 0.0 else aim < low
    return {name: round(bound if beyond and now != bound else aim, 6)}


class KeyDesk:
    """One operator at the keys: whoever arms or starts a car there holds it.

    `ask` sends a request, `tune` one for other live parameters; `kinds` are keys that are requests.
    """

    def __init__(
        self,
        board: "Dashboard",
        clock: Clock,
        ask: Callable[[RequestKind], object],
        tune: Callable[[Mapping[str, float]], object],
        kinds: Mapping[str, RequestKind] = KEYS,
    ) -> None:
        self._board, self._clock = board, clock
        self._ask, self._tune, self._kinds = ask, tune, kinds
        self.holding = False  # whether a car was armed or started here and still needs somebody
        self._requested_ns = self._alive_ns = 0
        self._answered: Parameters | None = None
        self._wanted: dict[str, float] = {}

    def on_key(self, key: str) -> None:
        """A key was pressed; those without a meaning are ignored."""
        if key in NUDGES or key == BACK:
            self._nudge(key)
        if key not in self._kinds:
            return
        kind = self._kinds[key]
        if kind in (RequestKind.ARM, RequestKind.START):
            self.holding, self._requested_ns = True, self._clock.now_ns()
        elif kind is RequestKind.DISARM:
            self.holding = False
        self._send(kind)

    def _nudge(self, key: str) -> None:
        """Ask for a step; keys that come faster than the car's answer build upon each other."""
        known = self._board.parameters
        if known is None:
            return
        if known is not self._answered:
            self._answered, self._wanted = known, {}
        values = nudge(known, self._wanted, key)
        self._wanted |= values
        self._tune(values)

    def keep_alive(self) -> None:
        """Keep the lease of a car that was armed or started here, until it is parked again."""
        now, state = self._clock.now_ns(), self._board.state
        held = state is not None and state.mode in _HELD
        if not held and now - self._requested_ns > _ANSWER_NS:
            self.holding = False
        if self.holding and now - self._alive_ns >= KEEPALIVE_NS:
            self._send(RequestKind.KEEPALIVE)

    def _send(self, kind: RequestKind) -> None:
        self._alive_ns = self._clock.now_ns()
        self._ask(kind)


@contextlib.contextmanager
def keys_one_by_one() -> Iterator[int | None]:
    """Standard input as single keys, if it is a terminal."""
    if not sys.stdin.isatty():
        yield None
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    tty.setcbreak(fd)
    try:
        yield fd
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def wait_for_key(keys: int | None, most_ns: int, clock: Clock) -> str:
    """The keys pressed within this time, up to the first; none where there is no keyboard."""
    if keys is None:
        clock.sleep_until_ns(clock.now_ns() + most_ns)
        return ""
    ready, _, _ = select.select([keys], [], [], most_ns * 1e-9)
    return os.read(keys, 1).decode("latin-1") if ready else ""
