"""Who holds the car of a live run in place of its parent: page, gamepad, controller, terminal."""

import contextlib
import os
import pty
import select
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
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import RequestKind, StateMessage, Transition
from steerd.steer_bus.topics import make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from tests.e2e.conftest import Program, children
from tests.e2e.test_live_page import live as open_page
from tests.safety.live import CLOCK, Live, free_endpoint, start_hardware, start_live

QUIET_S = 0.5  # a gamepad that says nothing for so long counts as released


@contextlib.contextmanager
def held_by_page(folder: Path) -> Iterator[Live]:
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
    with start_live(folder, controller=ControllerKind.ZENOH) as live:
        command = [sys.executable, "-m", "steerd", "control", "--connect", live.listen]
        control = subprocess.Popen([*command, "--path", "line", "--speed", "1"])
        live.others["controller"] = control.pid
        try:
            yield live
        finally:
            live.others.clear()
            control.kill()
            control.wait()


END_S = 15.0  # after so long without its parent every child has ended
_KEYS = {RequestKind.ARM: "a", RequestKind.START: "s", RequestKind.STOP: " "}
_PARTS = ("core_process", "recorder", "gateway", "guardian")


class AtTerminal(Live):
    """Keys are pressed in place of requests; what the car does comes over the bus.

    The terminal itself keeps the lease, which is why there is nothing to send for a keepalive.
    """

    run: Program
    keys: int
    bus: ZenohBus

    def listen_to(self, endpoint: str) -> None:
        self.bus = ZenohBus(Profile(hub=False, endpoint=endpoint))
        self._changes = self.bus.subscribe(make_key("car1", topics.TRANSITION), 64)
        self._states = self.bus.subscribe(make_key("car1", topics.STATE), 64)

    def ask(self, kind: RequestKind, operator: object = None) -> int:
        """Press a key; the time at which it was pressed."""
        if kind in _KEYS:
            os.write(self.keys, _KEYS[kind].encode())
        return CLOCK.now_ns()

    def pump(self, wait_s: float = 0.02) -> None:
        self.run.pump(0.0)
        CLOCK.sleep_until_ns(CLOCK.now_ns() + round(wait_s * 1e9))
        for sample in self._changes.poll():
            change = decode(Transition, sample.data)
            self.transitions.append(
                (SupervisorState(change.from_state), SupervisorState(change.to_state), change.text)
            )
        for sample in self._states.poll():
            state = decode(StateMessage, sample.data)
            self.state, self.speed = SupervisorState(state.mode), state.speed

    def pids(self) -> dict[str, int]:
        found = {"terminal": self.run.process.pid}
        for pid in children(self.run.process.pid):
            with contextlib.suppress(OSError):
                line = Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8")
                found |= {part.split("_")[0]: pid for part in _PARTS if f"process.{part}" in line}
        return found


@contextlib.contextmanager
def at_terminal(folder: Path) -> Iterator[AtTerminal]:
    """A run at its terminal, which is killed in the end: its children must end by themselves."""
    ours, theirs = pty.openpty()
    endpoint = free_endpoint()
    with start_hardware() as (hardware, device, port, url):
        live = AtTerminal(None, hardware, device)  # type: ignore[arg-type]
        live.keys, where = ours, ("--port", port, "--mocap", url, "--listen", endpoint)
        drive = ("--path", "line", "--speed", "1", "--record", str(folder / "drive.mcap"))
        live.run = Program("run", *where, *drive, stdin=theirs)
        try:
            live.run.expect("DISARMED")
            live.listen_to(endpoint)
            live.until(lambda: len(live.pids()) == 5)
            family = live.pids()
            yield live
            wait_for_children(live, family)
        finally:
            live.run.close()
            for fd in (ours, theirs):
                os.close(fd)


def wait_for_children(live: AtTerminal, family: dict[str, int]) -> None:
    left = {}
    for name, pid in family.items():
        with contextlib.suppress(ProcessLookupError):
            left[os.pidfd_open(pid)] = name
    live.run.send(signal.SIGKILL)
    live.bus.close()
    end_ns = CLOCK.now_ns() + round(END_S * 1e9)
    while left and CLOCK.now_ns() < end_ns:
        for fd in select.select([*left], [], [], 0.5)[0]:
            del left[fd]
            os.close(fd)
    for fd, name in left.items():
        os.kill(family[name], signal.SIGKILL)
        os.close(fd)
    assert not left, f"live on without their parent: {[*left.values()]}"
