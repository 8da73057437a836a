"""The terminal of a run: shows the core's records, passes keys and signals on to it."""

import contextlib
import os
import select
import signal
import socket
import sys
from collections.abc import Mapping
from math import inf

from rich.console import Console
from rich.live import Live

from steerd.daemon.common.screen import raw
from steerd.daemon.ipc.pipe_records import PipeReader
from steerd.daemon.ipc.requests import SETTING_MAX, pack_request, parse_setting
from steerd.daemon.ipc.signals import make_stop_signal_pipe
from steerd.daemon.process.bus_operator import Operator
from steerd.daemon.process.children import RunProcesses
from steerd.daemon.terminal.dashboard import Dashboard
from steerd.daemon.terminal.key_desk import KEY_HELP, NUDGE_HELP, KeyDesk, keys_one_by_one
from steerd.steer_bus import topics
from steerd.steer_bus.clock import Clock
from steerd.steer_bus.messages import RequestKind

_POLL_MS = 50
KILL_NS = 4_000_000_000  # from a second signal to the kill of the core, whose guardian brakes


class Terminal:
    """One operator's terminal of one run."""

    def __init__(
        self, processes: RunProcesses, board: Dashboard, operator: Operator, clock: Clock
    ) -> None:
        self._processes, self._board = processes, board
        self._operator, self._clock = operator, clock
        self._waiting = ""
        self._signals, self._kill_ns = 0, inf
        self._records = PipeReader(processes.fds.get("status"))
        self._reports = PipeReader(processes.fds.get("reports"))
        self._desk = KeyDesk(board, clock, self._ask, self._tune)

    def run(self) -> None:
        """Show records and pass on keys and signals until the core has ended."""
        console = Console(file=raw(sys.stderr))
        signals = make_stop_signal_pipe()
        with keys_one_by_one() as keys:
            self._board.keys = f"{KEY_HELP}  [q]uit\n{NUDGE_HELP}" if keys is not None else ""
            if not console.is_terminal:
                self._loop(signals, keys, None, console)
                return
            with Live(self._board.render(), console=console, auto_refresh=False) as live:
                self._loop(signals, keys, live, console)
                live.update(self._board.render(), refresh=True)

    def _loop(self, signals: int, keys: int | None, live: Live | None, console: Console) -> None:
        core = os.pidfd_open(self._processes.core.process.pid)
        poll = select.poll()
        viewer = self._processes.viewer_requests
        fds = [core, signals, self._processes.fds["status"], *([] if keys is None else [keys])]
        fds += [] if viewer is None else [viewer.fileno()]
        for fd in fds:
            poll.register(fd, select.POLLIN | select.POLLHUP)
        while True:
            ready = [fd for fd, _ in poll.poll(_POLL_MS)]
            if self._processes.fds["status"] in ready and not self._show(live, console):
                poll.unregister(self._processes.fds["status"])
            if signals in ready:
                for number in os.read(signals, 16):
                    self._pass_signal(number)
            if viewer is not None and viewer.fileno() in ready and not self._pass_setting(viewer):
                poll.unregister(viewer)
                viewer = None
            if keys is not None and keys in ready:
                self._on_key(os.read(keys, 1).decode("latin-1"))
            if core in ready:
                self._show(live, console)
                os.close(core)
                return
            self._desk.keep_alive()
            if self._clock.now_ns() > self._kill_ns:
                self._processes.core.process.kill()

    def _show(self, live: Live | None, console: Console) -> bool:
        for record in (*self._records.take(), *self._reports.take()):
            line = self._board.take(record)
            if live is None and line is not None:
                console.print(line, highlight=False, soft_wrap=True)
        waiting = self._board.status.get("waiting", "")
        if live is None and waiting != self._waiting:
            self._waiting = waiting
            console.print(f"{'':14}waiting for {waiting}", highlight=False, soft_wrap=True)
        if live is not None:
            live.update(self._board.render(), refresh=True)
        return self._records.fd is not None

    def _pass_signal(self, number: int) -> None:
        self._signals += 1
        if self._signals > 1:
            self._kill_ns = min(self._kill_ns, self._clock.now_ns() + KILL_NS)
        with contextlib.suppress(ProcessLookupError):
            self._processes.core.process.send_signal(
                signal.SIGTERM if number == signal.SIGHUP else number
            )

    def _pass_setting(self, viewer: socket.socket) -> bool:
        """A setting of the viewer goes to the car under this terminal's lease; False at its end."""
        packet = viewer.recv(SETTING_MAX)
        wanted = parse_setting(packet.decode("ascii", "replace"))
        if wanted is not None:
            self._tune(wanted, "viewer")
        return bool(packet)

    def _on_key(self, key: str) -> None:
        if key == "q":
            self._pass_signal(signal.SIGTERM)
        else:
            self._desk.on_key(key)

    def _ask(self, kind: RequestKind) -> None:
        self._send(topics.OPERATOR, self._operator.make_request(kind, self._clock.realtime_ns()))

    def _tune(self, wanted: Mapping[str, float], name: str = "") -> None:
        request = self._operator.make_parameters(wanted, self._clock.realtime_ns(), name)
        self._send(topics.SET_PARAMETERS, request)

    def _send(self, topic: topics.Topic, request: bytes) -> None:
        with contextlib.suppress(OSError):
            self._processes.requests.send(pack_request(topic.name, request))
