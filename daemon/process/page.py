"""The live page: one file over HTTP and a WebSocket, on this machine's loopback only."""

# Why: docs/decisions/safety.md#d69

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.operator import connect
from steerd.daemon.process.child import Job, run_child
from steerd.daemon.process.page_link import CarView, PageOperator
from steerd.daemon.process.secret_server import ConnectionClosed, SecretServer, ServerConnection
from steerd.steer_bus.clock import MonotonicClock
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


def make_page(job: Mapping[str, Any]) -> str:
    """The page: its style, its script and what it draws the car on."""
    shown = {name: job[name] for name in ("car", "lane", "closed", "half_width", "body")}
    return render_page(_TEMPLATE, job=shown)


class PageTalk:
    """Those who look at one car's page.

    Attributes:
        operators: of the pages that are open.
    """

    def __init__(self, view: CarView) -> None:
        self._view = view
        self.operators: set[PageOperator] = set()

    async def talk(self, connection: ServerConnection) -> None:
        """Show the car to one page, and pass on what it asks for."""
        operator = PageOperator(self._view)
        self.operators.add(operator)
        shown = asyncio.create_task(self._show(connection, operator))
        try:
            async for word in connection:
                if isinstance(word, str):
                    operator.ask(word)
        except ConnectionClosed:
            pass
        finally:
            shown.cancel()
            while operator.repeat():  # the last word of a page that is left may be a stop
                await asyncio.sleep(_POLL_S)
            self.operators.discard(operator)

    async def _show(self, connection: ServerConnection, operator: PageOperator) -> None:
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
                operator.repeat()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(ended.wait(), _POLL_S)
    finally:
        server.close()
        await server.wait_closed()


async def _serve_child(given: Job) -> None:
    ended, job = asyncio.Event(), given.about
    asyncio.get_running_loop().add_reader(given.fds["lifeline"], ended.set)
    with connect(job["endpoint"], None) as bus:
        view = CarView(bus, job["car"], MonotonicClock())
        await run_page(view, make_page(job), job["port"], given.say_ready, ended)


def serve_job(given: Job) -> int:
    """Show the page until its lifeline closes; the exit code."""
    try:
        asyncio.run(_serve_child(given))
    except (SteerdError, OSError) as error:
        with contextlib.suppress(OSError):
            given.say_ready(f"--page {given.about['port']}: {error}")
        return 3
    sys.stderr.flush()
    os._exit(0)  # zenoh's threads may keep the interpreter alive


if __name__ == "__main__":
    sys.exit(run_child(serve_job, _NICE))
