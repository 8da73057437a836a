"""Notify systemd that the service is up and alive: datagrams on its socket, nothing else.

Protocol: sd_notify(3). Without `NOTIFY_SOCKET` nothing is sent; a full or missing socket is
ignored: a control loop must not wait.
"""

import contextlib
import socket
from collections.abc import Callable, Mapping

Notify = Callable[[str], None]
READY, ALIVE, STOPPING = "READY=1", "WATCHDOG=1", "STOPPING=1"


def notify_nobody(_text: str) -> None:
    """For runs that no service manager started."""


def make_notify(environment: Mapping[str, str]) -> Notify:
    """A function that sends one state line; does nothing where no service manager listens."""
    address = environment.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return notify_nobody
    path = "\0" + address[1:] if address.startswith("@") else address

    def notify(text: str) -> None:
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, kind) as sock:
            sock.sendto(text.encode(), path)

    return notify
