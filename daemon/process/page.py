"""The live page: one file over HTTP and a WebSocket, on this machine's loopback only."""

# Why: docs/decisions/safety.md#d69

import asyncio
import contextlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from steerd.daemon.assembly.build import RunPlan, read_job
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.process.bus_operator import BusOperator
from steerd.daemon.process.child import Job, run_process
from steerd.daemon.process.page_link import CarView, make_page_operator, pass_on
from steerd.daemon.process.secret_server import ConnectionClosed, SecretServer, ServerConnection
from steerd.daemon.process.view_job import draw_plan
from steerd.steer_bus.bus import BusError
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from steerd.sysid.report.page import render_page

HOST = "127.0.0.1"
SHOW_S = 0.05
"""Time between two pictures of the car [s]."""
_POLL_S = 0.01
"""Time between two looks at the bus [s]."""
_WORD_MAX = 64
"""A page's message is a word."""
_NICE = 5
_TEMPLATE = Path(__file__).parent / "live_page" / "live.html"


def make_page(car: str, drawn: Mapping[str, Any]) -> str:
    """The page: its style, its script and what it draws the car on (`view_job.draw_lane`)."""
    return render_page(_TEMPLATE, job={"car": car, **drawn})


class PageTalk:
    """Those who look at one car's page: an operator for each page that is open."""

    def __init__(self, view: CarView) -> None:
        self._view = view
        self.operators: set[BusOperator] = set()

    async def talk(self, connection: ServerConnection) -> None:
        """Show the car to one page, and pass on what it asks for."""
        operator = make_page_operator(self._view)
        self.operators.add(operator)
        shown = asyncio.create_task(self._show(connection, operator))
        try:
            async for word in connection:
                if isinstance(word, str):
                    pass_on(self._view, operator, word)
        except ConnectionClosed:
            pass
        finally:
            shown.cancel()
            while operator.repeat(
                self._view.mode
            ):  # the last word of a page that is left may be a stop
                await asyncio.sleep(_POLL_S)
            self.operators.discard(operator)

    async def _show(self, connection: ServerConnection, operator: BusOperator) -> None:
        with contextlib.suppress(ConnectionClosed):
            while True:
                seen = self._view.snapshot()
                holder = seen.pop("holder", "")
                seen["mine"] = bool(operator.lease) and holder == operator.lease
                seen["held"] = holder not in ("", "0")
                await connection.send(json.dumps(seen, allow_nan=False))
                await asyncio.sleep(SHOW_S)


async def run_page(
    view: CarView, page: str, port: int, on_open: Callable[[str], None], ended: asyncio.Event
) -> None:
    """Serve until the end is asked for.

    Raises:
        OSError: the port is taken.
    """
    pages = PageTalk(view)
    secret = SecretServer(HOST, pages.talk, page)
    server = await secret.open(port, _WORD_MAX)
    on_open(secret.url)
    try:
        while not ended.is_set():
            view.poll()
            for operator in pages.operators:
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
    """The process; it ends when its lifeline closes.

    Raises:
        SteerdError: its port is taken, or it cannot reach the car.
    """
    plan = read_job(given.about)
    try:
        asyncio.run(_serve(given, plan))
    except (BusError, OSError) as error:
        what = f"--page {plan.options.page}: {error}"
        raise SteerdError(what, "--page with another port", ExitCode.UNREACHABLE) from None
    return 0


if __name__ == "__main__":
    run_process(serve, _NICE)
