"""The live page: one file over HTTP and a WebSocket, on this machine's loopback only.

What it shows of a car are JSON values; every keepalive on the bus is one that the browser sent. A
tab that is closed, hidden, frozen or cut off is silent, and the lease ends 0.3 s later.
"""

# Why: docs/decisions/safety.md#d69

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from functools import partial
from math import isfinite
from pathlib import Path
from typing import Any

from steerd.daemon.assembly.build import RunPlan, read_job
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.requests import LIVE, parse_setting
from steerd.daemon.process.bus_operator import BusOperator, CarView
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.secret_server import HOST, SecretServer, ServerConnection, converse
from steerd.daemon.process.view_job import draw_plan
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.messages import Parameters, RequestKind
from steerd.steer_bus.topics import BusError
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from steerd.sysid.report.page import render_page
from steerd.vesc_link.ids import fault_name

NAME = "page"  # of the page's operators, in recordings
SHOW_S = 0.05  # time between two pictures of the car [s]
_POLL_S = 0.01  # time between two looks at the bus [s]
_WORD_MAX = 64  # a page's message is a word
_NICE = 5
_TEMPLATE = Path(__file__).parent / "live_page" / "live.html"
_NUMBERS = ("x", "y", "yaw", "speed", "e1", "e2", "steer", "steer_ref", "speed_ref", "path_s")
_TEXTS = ("state", "reason", "waiting", "warnings", "holder", "leased", "mocap", "mocap_rate_hz")


def make_page(car: str, drawn: Mapping[str, Any]) -> str:
    """The page: its style, its script and what it draws the car on (`view_job.draw_lane`)."""
    return render_page(_TEMPLATE, job={"car": car, **drawn})


def show_car(view: CarView) -> dict[str, Any]:
    """What the page shows, as JSON values; unknown numbers are None."""
    shown: dict[str, Any] = {name: view.values.get(name, "") for name in _TEXTS}
    if view.state is not None:
        shown["state"] = view.mode_name
        shown |= {name: _finite(getattr(view.state, name)) for name in _NUMBERS}
    if (vesc := view.vesc) is not None:
        shown |= {"battery": _finite(vesc.v_in), "amps": _finite(vesc.current_motor)}
        shown["fault"] = fault_name(vesc.fault_code) if vesc.fault_code > 0 else ""
    shown["live"] = {} if view.parameters is None else _show_live(view.parameters)
    silent = 0.0 if view.heard_ns is None else (view.clock.now_ns() - view.heard_ns) * 1e-9
    return shown | {"silent": round(silent, 2), "events": view.events}


def _show_live(p: Parameters) -> dict[str, Any]:
    """Live parameters as value, least and most, and the answer to the last request."""
    shown: dict[str, Any] = {
        name: [_finite(getattr(p, name + end)) for end in ("", "_min", "_max")] for name in LIVE
    }
    return {**shown, "text": p.text, "refused": bool(p.seq) and not p.accepted}


def _finite(value: float) -> float | None:
    return round(value, 5) if isfinite(value) else None


def pass_on(view: CarView, operator: BusOperator, word: str) -> bool:
    """Send a request of a page, the name of its kind or `set NAME VALUE`; whether it was sent.

    Before the car was heard, only a stop is.
    """
    wanted = parse_setting(word)
    if wanted is not None:
        return operator.tune(view.boot_id, wanted)
    kind = RequestKind.__members__.get(word.upper())
    return kind is not None and operator.ask(view.boot_id, kind)


async def _show(connection: ServerConnection, view: CarView, operator: BusOperator) -> None:
    while True:
        seen = show_car(view)
        holder = seen.pop("holder", "")
        seen["mine"] = bool(operator.lease) and holder == operator.lease
        seen["held"] = holder not in ("", "0")
        await connection.send(json.dumps(seen, allow_nan=False))
        await asyncio.sleep(SHOW_S)


async def run_page(
    view: CarView, page: str, port: int, on_open: Callable[[str], None], ended: asyncio.Event
) -> None:
    """Serve until the end is asked for; each page that is open is an operator of its own.

    Raises:
        OSError: the port is taken.
    """
    operators: set[BusOperator] = set()

    async def talk(connection: ServerConnection) -> None:
        """Show the car to one page, and pass on what it asks for."""
        operator = BusOperator(view.bus, view.car, view.clock, NAME, view.pulse)
        operators.add(operator)
        try:
            shown = _show(connection, view, operator)
            await converse(connection, shown, partial(pass_on, view, operator))
        finally:  # the last word of a page that is left may be a stop
            while operator.repeat(view.mode):
                await asyncio.sleep(_POLL_S)
            operators.discard(operator)

    secret = SecretServer(HOST, talk, page)
    server = await secret.open(port, _WORD_MAX)
    on_open(secret.url)
    try:
        while not ended.is_set():
            view.poll()
            for operator in operators:
                operator.repeat(view.mode)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(ended.wait(), _POLL_S)
    finally:
        server.close()
        await server.wait_closed()


async def _serve(given: Job, plan: RunPlan) -> None:
    ended, options = asyncio.Event(), plan.options
    asyncio.get_running_loop().add_reader(given.fds["lifeline"], ended.set)
    page = make_page(options.car, draw_plan(plan))
    with ZenohBus(Profile(False, options.listen)) as bus:
        view = CarView(bus, options.car, MonotonicClock())
        await run_page(view, page, options.page or 0, lambda url: given.say_ready(url=url), ended)


def serve(given: Job) -> int:
    """The process; it ends when its lifeline closes."""
    plan = read_job(given.about)
    try:
        asyncio.run(_serve(given, plan))
    except (BusError, OSError) as error:
        what = f"--page {plan.options.page}: {error}"
        raise SteerdError(what, "--page with another port", ExitCode.UNREACHABLE) from None
    return 0


if __name__ == "__main__":
    run_process(serve, _NICE)
