"""The simulated hardware in real time: a pty for the VESC, sockets for mocap, one poll loop.

The only file here that knows a clock or processes. The world runs in a process of its own
(`spawn_sim`), so that a latency measured against it is not its own.
"""

import contextlib
import multiprocessing as mp
import os
import select
import signal
import sys
import tempfile
import tty
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NamedTuple, Self

from steerd.sim_hw.mocap.servers import NatNetServer
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.mocap_sockets import MocapSockets, NatNetSockets, VrpnSockets
from steerd.sim_hw.world import World, WorldConfig
from steerd.steer_bus.clock import MonotonicClock

_READ = 4096
_GRACE_NS = 100_000_000
"""How long a program that closed the port has to open it again before it is made anew."""


class PtyPort:
    """The VESC's end of a pty, linked as ``vesc`` (or the name the world gives) in a directory.

    A program that was killed leaves its exclusive lock and unread bytes behind in a pty, which a
    USB port would not; so once nobody has the port open any more it is replaced by a fresh one.
    """

    def __init__(self, directory: Path) -> None:
        self._dir = directory
        self._name: str | None = None
        self._near = -1
        self._pending = b""
        self._used = self._hung = False
        self._hung_ns = 0

    def read_fds(self) -> tuple[int, ...]:
        """What to poll; a port that nobody has open would report so all the time."""
        return (self._near,) if self._near >= 0 and not self._hung else ()

    def follow(self, world: World, t_ns: int) -> None:
        """Appear, vanish or change names as the world's device does."""
        world.advance(t_ns)
        if world.serial_name == self._name:
            return
        self.close()
        if world.serial_name is not None:
            self._open(world.serial_name)

    def _open(self, name: str) -> None:
        self._near, far = os.openpty()
        tty.setraw(far)
        os.set_blocking(self._near, False)
        temporary = self._dir / f".{name}.new"
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(os.ttyname(far))
        temporary.replace(self._dir / name)
        os.close(far)
        self._name = name
        self._used, self._hung = False, True

    def close(self) -> None:
        """Unplug: programs that have it open get EIO, the name is gone."""
        if self._name is None:
            return
        (self._dir / self._name).unlink(missing_ok=True)
        os.close(self._near)
        self._near, self._name, self._pending = -1, None, b""

    def pump(self, world: World, t_ns: int) -> None:
        """Move bytes both ways."""
        if self._near < 0:
            return
        if not world.vesc.fault_state.stalled:
            data = self._read()
            if data:
                world.serial_write(t_ns, data)
        if self._watch_users(t_ns) and world.serial_name == self._name:
            self._write(world, t_ns)

    def _read(self) -> bytes:
        try:
            return os.read(self._near, _READ)
        except OSError:  # nothing there, or nobody has it open
            return b""

    def _watch_users(self, t_ns: int) -> bool:
        """Whether somebody has the port open; makes it anew after the last has left."""
        poll = select.poll()
        poll.register(self._near, 0)
        hung = bool(poll.poll(0))
        if hung and not self._hung:
            self._hung_ns = t_ns
        self._hung = hung
        self._used |= not hung
        if hung and self._used and t_ns - self._hung_ns > _GRACE_NS and self._name is not None:
            os.close(self._near)
            self._pending = b""
            self._open(self._name)
        return not hung

    def _write(self, world: World, t_ns: int) -> None:
        """Hand over what the host's buffer takes; the world hears of a host that does not read."""
        if not self._pending:
            self._pending = world.serial_read(t_ns)
        if self._pending:
            with contextlib.suppress(BlockingIOError):
                count = os.write(self._near, self._pending)
                self._pending = self._pending[count:]


_SHORTEST_NS = 100_000  # shortest sleep, for when a host leaves bytes lying
_READY_SECONDS = 20.0
_STOP_SECONDS = 5.0
_PRIORITY = 40


class SimHardware:
    """A world with open ends. Use as a context manager, or call `close`.

    The serial port's name lies in ``link_dir``; in a fresh folder if that is None.
    """

    def __init__(
        self, config: WorldConfig, faults: Sequence[Fault] = (), link_dir: Path | None = None
    ) -> None:
        self._clock = MonotonicClock()
        self._own_dir = link_dir is None
        self._dir = link_dir or Path(tempfile.mkdtemp(prefix="steerd-sim-"))
        # The simulated hardware; its clock is CLOCK_MONOTONIC
        self.world = World(config, faults, self._clock.now_ns())
        self._pty = PtyPort(self._dir)
        server = self.world.mocap
        self._mocap: MocapSockets = (
            NatNetSockets(server) if isinstance(server, NatNetServer) else VrpnSockets(server)
        )
        self._pty.follow(self.world, self._clock.now_ns())
        # Path of the serial device (a link to a pty; it goes away with the device)
        self.port = str(self._dir / "vesc")
        self.mocap_url = self._mocap.url  # address for `steerd.mocap_link.source.parse_mocap_url`

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close everything and remove the port's name."""
        self._pty.close()
        self._mocap.close()
        if self._own_dir:
            with contextlib.suppress(OSError):
                self._dir.rmdir()

    def run(self, stop_fd: int, push_fds: tuple[int, ...] = ()) -> None:
        """Live in real time until ``stop_fd`` has something to read or is closed at its far end.

        Wakes at the absolute times at which the world has bytes to give, and when bytes come in.
        A line from ``push_fds`` pushes the car.
        """
        while True:
            now = self._clock.now_ns()
            self.pump(now)
            left_ns = max(_SHORTEST_NS, self.world.next_wake_ns - self._clock.now_ns())
            fds = (stop_fd, *push_fds, *self._pty.read_fds(), *self._mocap.read_fds())
            ready = select.select(fds, (), (), left_ns * 1e-9)[0]
            if stop_fd in ready:
                return
            if ready and ready[0] in push_fds:
                if os.read(ready[0], 1024):
                    self.world.push()
                else:  # its end
                    push_fds = ()

    def pump(self, now_ns: int) -> None:
        """Bring the world to ``now_ns`` and move the bytes that are there or due."""
        self._pty.follow(self.world, now_ns)
        self._pty.pump(self.world, now_ns)
        self._mocap.pump(self.world, now_ns)


def raise_priority() -> None:
    """Ask for a fixed priority, below a control core's: a real VESC minds no busy machine either.

    For processes that do nothing else. Where it is not allowed, other programs may delay the
    simulated hardware, and the core then stops the car for it.
    """
    with contextlib.suppress(OSError):
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_PRIORITY))


class SpawnedSim(NamedTuple):
    """Simulated hardware in another process."""

    port: str  # path of the serial device
    mocap_url: str  # address of the mocap server
    process: BaseProcess


@contextlib.contextmanager
def spawn_sim(config: WorldConfig, faults: Sequence[Fault] = ()) -> Iterator[SpawnedSim]:
    """Simulated hardware in a process of its own, which is gone at the end.

    Effects in ``config`` must be importable (hooks defined at module level).

    Raises:
        RuntimeError: it did not come up; its own message is on standard error.
    """
    context = mp.get_context("spawn")
    ours, theirs = context.Pipe()  # whose closing ends it, so that it never outlives us
    process = context.Process(
        target=_child, args=(config, faults, theirs), name="steerd-sim", daemon=True
    )
    process.start()
    theirs.close()
    try:
        try:
            if not ours.poll(_READY_SECONDS):
                raise EOFError
            port, url = ours.recv()
        except (EOFError, OSError):
            process.kill()
            raise RuntimeError("the simulated hardware did not start") from None
        yield SpawnedSim(port, url, process)
    finally:
        ours.close()
        process.join(_STOP_SECONDS)
        if process.is_alive():
            process.kill()
            process.join()


def _child(config: WorldConfig, faults: Sequence[Fault], pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for our parent, who then closes us
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # through SimHardware.close
    raise_priority()
    with SimHardware(config, faults) as hardware:
        pipe.send((hardware.port, hardware.mocap_url))
        hardware.run(pipe.fileno())


def fault_windows(names: Sequence[str]) -> tuple[Fault, ...]:
    """Faults as people write them: ``NAME``, ``NAME@FROM`` or ``NAME@FROM-TO`` in seconds.

    Raises:
        ValueError: an unknown fault or a window that is none.
    """
    faults = []
    for text in names:
        name, _, window = text.partition("@")
        begin, _, end = window.partition("-")
        times = [round(float(part) * 1e9) for part in (begin or "0", end) if part]
        faults.append(Fault(name, *times))
    return tuple(faults)
