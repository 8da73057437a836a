"""A WebSocket, and a page, under an address that nobody can guess. `websockets` lives here.

A page of another origin cannot talk to it: the address holds a random word. A page of our own is
asked besides where it comes from; a viewer's page is another's and brings the word alone.
"""

# Why: docs/decisions/safety.md#d69

import asyncio
import contextlib
import secrets
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from http import HTTPStatus
from typing import Any

from websockets.asyncio.server import Server, ServerConnection, serve  # noqa: TID251
from websockets.datastructures import Headers  # noqa: TID251
from websockets.exceptions import ConnectionClosed  # noqa: TID251
from websockets.http11 import Request, Response  # noqa: TID251

__all__ = ["SecretServer", "ServerConnection", "converse"]

HOST = "127.0.0.1"  # pages are for this machine alone
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; "
    "connect-src 'self' ws://{host}; frame-ancestors 'none'"
)


class SecretServer:
    """One address with a secret `word`, and those who know it; its port is 0 before it listens.

    A browser is shown the page; without one there is only the WebSocket.
    """

    def __init__(
        self,
        host: str,
        talk: Callable[[ServerConnection], Awaitable[None]],
        page: str | None = None,
    ) -> None:
        self.word, self.port = secrets.token_urlsafe(12), 0
        self._host, self._talk = host, talk
        self._page = None if page is None else page.encode()

    @property
    def url(self) -> str:
        """The address: of the page, or of the WebSocket where there is none."""
        return f"{'ws' if self._page is None else 'http'}://{self._where}/{self.word}/"

    @property
    def _where(self) -> str:
        host = f"[{self._host}]" if ":" in self._host else self._host
        return f"{host}:{self.port}"

    async def open(self, port: int, max_size: int, protocols: Sequence[str] = ()) -> Server:
        """Listen; OSError if the port is taken."""
        named: Any = list(protocols) or None
        server = await serve(
            self._talk,
            self._host,
            port,
            process_request=self._answer,
            subprotocols=named,
            max_size=max_size,
            compression=None,
            server_header=None,
        )
        self.port = next(iter(server.sockets)).getsockname()[1]
        return server

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """The page itself, or nothing where a WebSocket may open."""
        home = f"/{self.word}/"
        if self._page is None:
            known = request.path.rstrip("/") == home.rstrip("/")
            return None if known else connection.respond(HTTPStatus.NOT_FOUND, "nothing here\n")
        # Another name for this machine is DNS rebinding.
        if request.headers.get_all("Host") != [self._where]:
            return connection.respond(HTTPStatus.FORBIDDEN, "not here\n")
        if request.path == home:
            headers = Headers(
                {
                    "Content-Type": "text/html; charset=utf-8",
                    "Content-Length": str(len(self._page)),
                    "Content-Security-Policy": _POLICY.format(host=self._where),
                    "Cache-Control": "no-store",
                    "Referrer-Policy": "no-referrer",
                    "Connection": "close",
                }
            )
            return Response(HTTPStatus.OK, "OK", headers, self._page)
        if request.path != f"{home}live":
            return connection.respond(HTTPStatus.NOT_FOUND, "nothing here\n")
        if request.headers.get_all("Origin") != [f"http://{self._where}"]:
            return connection.respond(HTTPStatus.FORBIDDEN, "another page\n")
        return None


async def converse(
    connection: ServerConnection, show: Coroutine[Any, Any, None], take: Callable[[str], object]
) -> None:
    """Go on with `show`, which sends, and hand each text that comes to `take`, until it closes."""

    async def send() -> None:
        with contextlib.suppress(ConnectionClosed):
            await show

    sending = asyncio.create_task(send())
    try:
        with contextlib.suppress(ConnectionClosed):
            async for word in connection:
                if isinstance(word, str):
                    take(word)
    finally:
        sending.cancel()
