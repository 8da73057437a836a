"""Signals as bytes on a pipe, taken by a thread in sigwait; and notices to systemd.

A Python handler runs only when the main thread is back in the interpreter (1.9 s were measured
during a long C call); a thread in sigwait needs 0.2 ms. Protocol of the service manager:
sd_notify(3); without `NOTIFY_SOCKET` nothing is sent, and a full or missing socket is ignored: a
control loop must not wait.
"""

import contextlib
import ctypes
import os
import select
import signal
import socket
import threading
from collections.abc import Callable, Mapping

_PR_SET_PDEATHSIG = 1
STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def block_stop_signals() -> None:
    """Block stop signals in this thread and all that it starts; call before any thread runs."""
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP_SIGNALS)


def wake_at_parents_end() -> None:
    """Go on when the parent ends, even if stopped: only who runs can see that its pipes closed."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGCONT, 0, 0, 0)


def make_stop_signal_pipe() -> int:
    """Block the stop signals; the descriptor gives a byte, the number, for each that comes."""
    block_stop_signals()
    read_fd, write_fd = os.pipe()
    os.set_blocking(read_fd, False)

    def wait() -> None:
        while True:
            os.write(write_fd, bytes([signal.sigwait(STOP_SIGNALS)]))

    threading.Thread(target=wait, name="sigwait", daemon=True).start()
    return read_fd


def ignore_terminal_signals() -> None:
    """For a process that ends when its pipe closes: Ctrl-C reaches the whole group."""
    wake_at_parents_end()
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


def raise_on_stop_signals() -> None:
    """SIGINT and SIGTERM raise KeyboardInterrupt here, whatever this process inherited.

    A shell without job control starts what is in the background with SIGINT ignored; a holder of
    the lease that could not be interrupted would go on holding the car.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


def is_left() -> bool:
    """Whether the terminal, or the ssh, that shows what this process says has gone.

    An ssh without a terminal ends without a signal to what it started.
    """
    shown = select.poll()
    shown.register(1, 0)  # a hang-up is reported unasked
    shown.register(2, 0)
    return bool(shown.poll(0))


Notify = Callable[[str], None]
READY, ALIVE, STOPPING = "READY=1", "WATCHDOG=1", "STOPPING=1"


def make_notify(environment: Mapping[str, str]) -> Notify:
    """A function that sends one state line; does nothing where no service manager listens."""
    address = environment.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return lambda _text: None
    path = "\0" + address[1:] if address.startswith("@") else address

    def notify(text: str) -> None:
        kind = socket.SOCK_DGRAM | socket.SOCK_CLOEXEC | socket.SOCK_NONBLOCK
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX, kind) as sock:
            sock.sendto(text.encode(), path)

    return notify
