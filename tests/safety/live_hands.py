"""Who holds the car of a live run in place of its parent: a page, a gamepad, another controller."""

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from websockets.exceptions import ConnectionClosed  # noqa: TID251

from steerd.daemon.common.errors import ExitCode
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.gamepad import ABS, AXES, BUTTONS, EVENT, KEY
from steerd.daemon.settings.run_options import ControllerKind
from steerd.steer_bus.messages import RequestKind
from tests.e2e.conftest import Program
from tests.e2e.test_live_page import live as open_page
from tests.safety.live import Live, start_live

QUIET_S = 0.5  # a gamepad that says nothing for so long counts as released


@contextlib.contextmanager
def held_by_page(folder: Path) -> Iterator[Live]:
    """A run whose operator sits at the page."""
    with (
        start_live(folder, page=0) as live,
        open_page(live.processes.reports["page"]["url"]) as socket,
    ):

        def say(kind: RequestKind) -> None:
            with contextlib.suppress(ConnectionClosed):
                socket.send(kind.name.lower())

        live.hand, live.leave = say, socket.close
        yield live
        with contextlib.suppress(ProcessLookupError):
            os.kill(live.pids()["page"], signal.SIGCONT)


class Pad:
    """A gamepad whose events go through a pipe, and the hand on it: its sticks rest nowhere."""

    def __init__(self, path: Path, live: Live) -> None:
        os.mkfifo(path)
        self.path, self.live, self.fd = path, live, -1
        self.from_state: SupervisorState | None = None

    def send(self, kind: int, code: int, value: int) -> None:
        with contextlib.suppress(BrokenPipeError):
            os.write(self.fd, EVENT.pack(0, 0, kind, code, value))

    def take(self) -> None:
        """Hold the deadman and ask for full speed; waits until the events are read."""
        self.fd = os.open(self.path, os.O_WRONLY)
        self.send(KEY, BUTTONS["tl"], 1)
        self.send(ABS, AXES["rz"], 1023)

    def ask(self, kind: RequestKind) -> None:
        """What a person does about it; who wants to drive presses until the car obeys."""
        if kind is RequestKind.STOP:
            self.send(KEY, BUTTONS["tl"], 0)
        elif kind is RequestKind.KEEPALIVE:
            self.send(ABS, AXES["ry"], 1)
            if self.live.state is self.from_state:
                self.send(KEY, BUTTONS["start"], 1)
                self.send(KEY, BUTTONS["start"], 0)
        else:
            arming = kind is RequestKind.ARM
            self.from_state = SupervisorState.READY if arming else SupervisorState.ARMED

    def unplug(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
        self.fd, self.live.alive = -1, False


@contextlib.contextmanager
def held_by_gamepad(folder: Path) -> Iterator[Live]:
    """A run that a gamepad drives; one that was unplugged must have ended its command."""
    with start_live(folder, controller=ControllerKind.ZENOH) as live:
        pad = Pad(folder / "pad", live)
        at = ("--connect", live.listen, "--device", str(pad.path), "--quiet", str(QUIET_S))
        teleop = Program("teleop", *at)
        live.others["gamepad"] = teleop.process.pid
        try:
            pad.take()
            teleop.expect("hold tl")
            live.hand, live.leave = pad.ask, pad.unplug
            yield live
            if pad.fd < 0:
                assert teleop.wait() == ExitCode.UNREADABLE
                assert "is gone; the car stops" in teleop.text
        finally:
            live.others.clear()
            pad.unplug()
            teleop.send(signal.SIGKILL)
            teleop.close()


@contextlib.contextmanager
def driven_by_another(folder: Path) -> Iterator[Live]:
    """A run that `steerd control` drives."""
    with start_live(folder, controller=ControllerKind.ZENOH) as live:
        listen = live.listen
        command = [sys.executable, "-m", "steerd", "control", "--connect", listen]
        control = subprocess.Popen([*command, "--path", "line", "--speed", "1"])
        live.others["controller"] = control.pid
        try:
            yield live
        finally:
            live.others.clear()
            control.kill()
            control.wait()
