"""The terminal of a run: shows the core's records, passes keys and signals on to it."""

import contextlib
import os
import select
import signal
import sys
import termios
import tty
from collections.abc import Iterator

from rich.console import Console
from rich.live import Live

from steerd.daemon.ipc.gateway_wire import pack_request
from steerd.daemon.ipc.operator import KEEPALIVE_NS, Operator
from steerd.daemon.ipc.pipe_records import unpack_records
from steerd.daemon.ipc.signals import block_stop_signals, make_stop_signal_pipe
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.children import RunProcesses
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.steer_bus import topics
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.messages import RequestKind

KEYS = {
    "a": RequestKind.ARM,
    "s": RequestKind.START,
    " ": RequestKind.STOP,
    "d": RequestKind.DISARM,
    "c": RequestKind.CLEAR,
    "e": RequestKind.ESTOP,
}
KEY_HELP = "[a]rm  [s]tart  [space] stop  [d]isarm  [c]lear  [e]stop  [q]uit"
_POLL_MS = 50
_HELD = (
    SupervisorState.SELF_TEST,
    SupervisorState.ARMED,
    SupervisorState.RUNNING,
    SupervisorState.STOPPING,
)
_ANSWER_NS = 1_500_000_000
"""A car that is not yet in a held state after this time refused to arm [ns]."""


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


class Terminal:
    """One operator's terminal of one run."""

    def __init__(
        self, processes: RunProcesses, board: Dashboard, operator: Operator, clock: Clock
    ) -> None:
        self._processes = processes
        self._board = board
        self._operator = operator
        self._clock = clock
        self._buffer = bytearray()
        self._holding = False
        self._requested_ns = 0
        self._waiting = ""
        self._alive_ns = 0

    def run(self) -> None:
        """Show records and pass on keys and signals until the core has ended."""
        console = Console(stderr=True)
        block_stop_signals()
        signals = make_stop_signal_pipe()
        with keys_one_by_one() as keys:
            self._board.keys = KEY_HELP if keys is not None else ""
            if not console.is_terminal:
                self._loop(signals, keys, None, console)
                return
            with Live(self._board.render(), console=console, auto_refresh=False) as live:
                self._loop(signals, keys, live, console)
                live.update(self._board.render(), refresh=True)

    def _loop(self, signals: int, keys: int | None, live: Live | None, console: Console) -> None:
        core = os.pidfd_open(self._processes.core.process.pid)
        poll = select.poll()
        fds = [core, signals, self._processes.status_fd, *([] if keys is None else [keys])]
        for fd in fds:
            poll.register(fd, select.POLLIN | select.POLLHUP)
        while True:
            ready = [fd for fd, _ in poll.poll(_POLL_MS)]
            if self._processes.status_fd in ready and not self._show(live, console):
                poll.unregister(self._processes.status_fd)
            if signals in ready:
                for number in os.read(signals, 16):
                    self._pass_signal(number)
            if keys is not None and keys in ready:
                self._on_key(os.read(keys, 1).decode("latin-1"))
            if core in ready:
                self._show(live, console)
                os.close(core)
                return
            self._keep_alive()

    def _show(self, live: Live | None, console: Console) -> bool:
        data = os.read(self._processes.status_fd, 1 << 16)
        self._buffer += data
        for record in unpack_records(self._buffer):
            line = self._board.take(record)
            if live is None and line is not None:
                console.print(line, highlight=False, soft_wrap=True)
        waiting = self._board.status.get("waiting", "")
        if live is None and waiting != self._waiting:
            self._waiting = waiting
            console.print(f"{'':14}waiting for {waiting}", highlight=False, soft_wrap=True)
        if live is not None:
            live.update(self._board.render(), refresh=True)
        return bool(data)

    def _pass_signal(self, number: int) -> None:
        with contextlib.suppress(ProcessLookupError):
            self._processes.core.process.send_signal(
                signal.SIGTERM if number == signal.SIGHUP else number
            )

    def _on_key(self, key: str) -> None:
        if key == "q":
            self._pass_signal(signal.SIGTERM)
        elif key in KEYS:
            kind = KEYS[key]
            if kind in (RequestKind.ARM, RequestKind.START):
                self._holding, self._requested_ns = True, self._clock.now_ns()
            elif kind is RequestKind.DISARM:
                self._holding = False
            self._send(kind)

    def _keep_alive(self) -> None:
        """Keep the lease of a car that was armed or started here, until it is parked again."""
        now, state = self._clock.now_ns(), self._board.state
        held = state is not None and state.mode in _HELD
        if not held and now - self._requested_ns > _ANSWER_NS:
            self._holding = False
        if self._holding and now - self._alive_ns >= KEEPALIVE_NS:
            self._send(RequestKind.KEEPALIVE)

    def _send(self, kind: RequestKind) -> None:
        self._alive_ns = self._clock.now_ns()
        packet = pack_request(
            topics.OPERATOR.name, self._operator.make_request(kind, self._clock.realtime_ns())
        )
        with contextlib.suppress(OSError):
            self._processes.requests.send(packet)
