"""The live page: one file over HTTP and a WebSocket, on this machine's loopback only.

`websockets` lives here. A page of another origin cannot talk to it: the address holds a random
word, and the WebSocket asks where it comes from.
"""

# Why: docs/decisions/safety.md#d69

import asyncio
import contextlib
import json
import os
import secrets
import sys
from collections.abc import Callable, Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve  # noqa: TID251
from websockets.datastructures import Headers  # noqa: TID251
from websockets.exceptions import ConnectionClosed  # noqa: TID251
from websockets.http11 import Request, Response  # noqa: TID251

from steerd.daemon.ipc.operator import read_lab
from steerd.daemon.ipc.signals import ignore_terminal_signals
from steerd.daemon.process.page_link import CarView, PageOperator
from steerd.steer_bus.bus import BusError
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.zenoh_bus import ZenohBus, make_spoke_profile
from steerd.sysid.report.page import render_page

HOST = "127.0.0.1"
SHOW_S = 0.05
"""Time between two pictures of the car [s]."""
_POLL_S = 0.01
"""Time between two looks at the bus [s]."""
_WORD_MAX = 64
"""A page's message is a word."""
_NICE = 5
_FILES = Path(__file__).parent / "live_page"
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self' ws://{host}; frame-ancestors 'none'"
)


def make_page(job: Mapping[str, Any]) -> str:
    """The page: its style, its script and what it draws the car on."""
    return render_page(
        _FILES / "live.html",
        job={name: job[name] for name in ("car", "lane", "closed", "half_width", "body")},
        style=(_FILES / "live.css").read_text(encoding="utf-8"),
        script=(_FILES / "live.js").read_text(encoding="utf-8"),
    )


class PageServer:
    """One car's page and those who look at it.

    Attributes:
        word: the secret part of the address.
    """

    def __init__(self, view: CarView, page: str) -> None:
        self.word = secrets.token_urlsafe(12)
        self._view, self._page = view, page.encode()
        self.port = 0

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self.port}/{self.word}/"

    async def open(self, port: int) -> Server:
        """Listen.

        Raises:
            OSError: the port is taken.
        """
        server = await serve(
            self._talk,
            HOST,
            port,
            process_request=self._answer,
            max_size=_WORD_MAX,
            compression=None,
            server_header=None,
        )
        self.port = next(iter(server.sockets)).getsockname()[1]
        return server

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page itself, or nothing where a WebSocket may open."""
        host = f"{HOST}:{self.port}"
        if request.headers.get_all("Host") != [host]:  # another name of this machine: DNS rebinding
            return connection.respond(HTTPStatus.FORBIDDEN, "not here\n")
        if request.path == f"/{self.word}/":
            headers = Headers(
                {
                    "Content-Type": "text/html; charset=utf-8",
                    "Content-Length": str(len(self._page)),
                    "Content-Security-Policy": _POLICY.format(host=host),
                    "Cache-Control": "no-store",
                    "Referrer-Policy": "no-referrer",
                    "Connection": "close",
                }
            )
            return Response(HTTPStatus.OK, "OK", headers, self._page)
        if request.path != f"/{self.word}/live":
            return connection.respond(HTTPStatus.NOT_FOUND, "nothing here\n")
        if request.headers.get_all("Origin") != [f"http://{host}"]:
            return connection.respond(HTTPStatus.FORBIDDEN, "another page\n")
        return None

    async def _talk(self, connection: ServerConnection) -> None:
        """Show the car to one page, and pass on what it asks for."""
        operator = PageOperator(self._view)
        shown = asyncio.create_task(self._show(connection, operator))
        try:
            async for word in connection:
                if isinstance(word, str):
                    operator.ask(word)
        except ConnectionClosed:
            pass
        finally:
            shown.cancel()

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
    pages = PageServer(view, page)
    server = await pages.open(port)
    on_open(pages.url)
    try:
        while not ended.is_set():
            view.poll()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(ended.wait(), _POLL_S)
    finally:
        server.close()
        await server.wait_closed()


def join(job: Mapping[str, Any]) -> ZenohBus:
    """Join the car's bus.

    Raises:
        BusError: nobody answers.
    """
    lab = read_lab(Path(job["lab"])) if job["lab"] else None
    return ZenohBus(make_spoke_profile(job["endpoint"], lab))


async def _serve_child(job: Mapping[str, Any], lifeline_fd: int, ready_fd: int) -> None:
    ended = asyncio.Event()
    asyncio.get_running_loop().add_reader(lifeline_fd, ended.set)

    def on_open(url: str) -> None:
        os.write(ready_fd, f"{url}\n".encode())
        os.close(ready_fd)

    with join(job) as bus:
        view = CarView(bus, job["car"], MonotonicClock())
        await run_page(view, make_page(job), job["port"], on_open, ended)


def main() -> int:
    """Process entry: the job as JSON on standard input, lifeline and ready descriptors after it."""
    ignore_terminal_signals()
    os.nice(_NICE)
    lifeline_fd, ready_fd = int(sys.argv[1]), int(sys.argv[2])
    job = json.loads(sys.stdin.read())
    try:
        asyncio.run(_serve_child(job, lifeline_fd, ready_fd))
    except (BusError, OSError) as error:
        with contextlib.suppress(OSError):
            os.write(ready_fd, f"--page {job['port']}: {error}\n".encode())
        return 3
    sys.stderr.flush()
    os._exit(0)  # zenoh's threads may keep the interpreter alive


if __name__ == "__main__":
    sys.exit(main())
