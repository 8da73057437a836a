"""A run that a person drives at the keys of its own terminal, seen over the bus."""

import contextlib
import os
import pty
import select
import signal
from collections.abc import Iterator
from pathlib import Path

from steerd.daemon.loop.transitions import SupervisorState
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import RequestKind, StateMessage, Transition
from steerd.steer_bus.topics import make_key
from steerd.steer_bus.zenoh_bus import Profile, ZenohBus
from tests.e2e.conftest import Program, children
from tests.safety.live import CLOCK, Live, free_endpoint, start_hardware

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
        """Join the run's bus."""
        self.bus = ZenohBus(Profile(hub=False, endpoint=endpoint))
        self._changes = self.bus.subscribe(make_key("car1", topics.TRANSITION), 64)
        self._states = self.bus.subscribe(make_key("car1", topics.STATE), 64)

    def ask(self, kind: RequestKind, operator: object = None) -> int:
        """Press a key; the time at which it was pressed."""
        if kind in _KEYS:
            os.write(self.keys, _KEYS[kind].encode())
        return CLOCK.now_ns()

    def pump(self, wait_s: float = 0.02) -> None:
        """Take in what came over the bus."""
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
        """All processes of the run by name."""
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
    """Kill the terminal and wait until nothing is left of its run."""
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
