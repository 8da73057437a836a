"""The simulated hardware in real time: a pty for the VESC, sockets for mocap, one poll loop.

The only file here that knows a clock, sockets or processes. The world runs in a process of its own
(`spawn_sim`), so that a latency measured against it is not its own.
"""

import contextlib
import multiprocessing as mp
import os
import select
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import NamedTuple, Self

from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.mocap_sockets import MocapSockets, make_mocap_sockets
from steerd.sim_hw.real_time.pty_port import PtyPort
from steerd.sim_hw.world import World, WorldConfig
from steerd.steer_bus.clock import Clock, MonotonicClock

_SHORTEST_NS = 100_000
"""Shortest sleep, for when a host leaves bytes lying."""
_READY_SECONDS = 20.0
_STOP_SECONDS = 5.0
_PRIORITY = 40


@dataclass(frozen=True)
class SimOptions:
    """Where the simulated hardware is offered."""

    faults: tuple[Fault, ...] = ()  # what goes wrong; windows count from the start
    link_dir: Path | None = None  # directory for the serial port's name; a fresh one if None


class SimHardware:
    """A world with open ends. Use as a context manager, or call `close`.

    Attributes:
        world: the simulated hardware; its clock is CLOCK_MONOTONIC.
        port: path of the serial device (a link to a pty; it goes away with the device).
        mocap_url: address for `steerd.mocap_link.source.parse_mocap_url`.
    """

    def __init__(
        self, config: WorldConfig, options: SimOptions | None = None, clock: Clock | None = None
    ) -> None:
        options = options or SimOptions()
        self._clock = clock or MonotonicClock()
        self._own_dir = options.link_dir is None
        self._dir = options.link_dir or Path(tempfile.mkdtemp(prefix="steerd-sim-"))
        self.world = World(config, options.faults, self._clock.now_ns())
        self._pty = PtyPort(self._dir)
        self._mocap: MocapSockets = make_mocap_sockets(self.world)
        self._pty.follow(self.world, self._clock.now_ns())
        self.port = str(self._dir / "vesc")
        self.mocap_url = self._mocap.url

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


@contextlib.contextmanager
def stop_on_signals() -> Iterator[int]:
    """A descriptor that becomes readable at SIGTERM or SIGINT (main thread only)."""
    read_fd, write_fd = os.pipe()
    os.set_blocking(write_fd, False)
    old_fd = signal.set_wakeup_fd(write_fd)
    numbers = (signal.SIGTERM, signal.SIGINT)
    old = [signal.signal(number, lambda *_: None) for number in numbers]
    try:
        yield read_fd
    finally:
        for number, handler in zip(numbers, old, strict=True):
            signal.signal(number, handler)
        signal.set_wakeup_fd(old_fd)
        os.close(read_fd)
        os.close(write_fd)


def raise_priority() -> None:
    """Ask for a fixed priority, below a control core's: a real VESC minds no busy machine either.

    For processes that do nothing else. Where it is not allowed, other programs may delay the
    simulated hardware, and the core then stops the car for it.
    """
    with contextlib.suppress(OSError):
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(_PRIORITY))


class SpawnedSim(NamedTuple):
    """Simulated hardware in another process. Use as a context manager, or call `stop`.

    Attributes:
        port: path of the serial device.
        mocap_url: address of the mocap server.
        process: its process.
        lifeline: pipe whose closing ends it, so that it never outlives us.
    """

    port: str
    mocap_url: str
    process: BaseProcess
    lifeline: Connection

    def stop(self) -> None:
        """End it and wait until it is gone."""
        self.lifeline.close()
        self.process.join(_STOP_SECONDS)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def spawn_sim(config: WorldConfig, options: SimOptions | None = None) -> SpawnedSim:
    """Start simulated hardware in a process of its own.

    Effects in ``config`` must be importable (hooks defined at module level).

    Raises:
        RuntimeError: it did not come up; its own message is on standard error.
    """
    context = mp.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(
        target=_child, args=(config, options, theirs), name="steerd-sim", daemon=True
    )
    process.start()
    theirs.close()
    try:
        if not ours.poll(_READY_SECONDS):
            raise EOFError
        port, url = ours.recv()
    except (EOFError, OSError):
        process.kill()
        process.join()
        ours.close()
        raise RuntimeError("the simulated hardware did not start") from None
    return SpawnedSim(port, url, process, ours)


def _child(config: WorldConfig, options: SimOptions | None, pipe: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for our parent, who then closes us
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))  # through SimHardware.close
    raise_priority()
    with SimHardware(config, options) as hardware:
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
