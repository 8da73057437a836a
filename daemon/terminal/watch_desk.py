"""The keys of `steerd watch`: an operator on the bus like any other."""

import getpass
from collections.abc import Callable, Mapping

from steerd.daemon.process.bus_operator import BusOperator, Pulse
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.daemon.terminal.key_desk import KEY_HELP, KEYS, NUDGE_HELP, KeyDesk
from steerd.steer_bus.bus import Bus
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.messages import RequestKind


def make_desk(
    board: Dashboard, bus: Bus, car: str, clock: Clock, *, operate: bool
) -> tuple[KeyDesk, Callable[[], bool]]:
    """The keys of a car on the bus; without `operate` they change live parameters alone.

    Returns:
        The keys, and what goes on with a stop that was called for there.
    """
    operator = BusOperator(bus, car, clock, getpass.getuser(), Pulse(bus, car))

    def run_of_the_car() -> int:
        return int(board.status.get("boot_id", "0") or 0)

    def ask(kind: RequestKind) -> bool:
        return operator.ask(run_of_the_car(), kind)

    def tune(wanted: Mapping[str, float]) -> bool:
        return operator.tune(run_of_the_car(), wanted)

    def repeat() -> bool:
        return operator.repeat(board.state.mode if board.state else None)

    return KeyDesk(board, clock, ask, tune, KEYS if operate else {}), repeat


def desk_help(operate: bool) -> str:
    """What the keys do."""
    return f"{KEY_HELP}\n{NUDGE_HELP}" if operate else NUDGE_HELP
