"""A drive with real processes, a pty, sockets and signals, on simulated hardware that keeps a log.

Every wait polls descriptors with a deadline. Times are CLOCK_MONOTONIC on both sides.
"""

import contextlib
import multiprocessing as mp
import os
import select
import signal
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from steerd.daemon.assembly.build import NS, RunId, make_plan, make_world_config
from steerd.daemon.ipc.pipe_records import unpack_records
from steerd.daemon.ipc.requests import pack_request
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import Operator
from steerd.daemon.process.children import RunProcesses, start_processes
from steerd.daemon.settings.run_options import RunOptions
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.real_time.links import SimHardware, raise_priority
from steerd.steer_bus import topics
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.codec import decode
from steerd.steer_bus.messages import RequestKind, StateMessage, Transition
from tests.safety.judge import MotorFrame, read_motor_frames

BOOT_ID, LEASE_ID = 815, 42
KEEPALIVE_NS = 60_000_000
CLOCK = MonotonicClock()


def serve_hardware(config: Any, pipe: Connection) -> None:
    """Simulated hardware in its own process, with faults and its byte log on request."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    raise_priority()
    with SimHardware(config) as hardware:
        start_ns = hardware.world.t_ns
        pipe.send((hardware.port, hardware.mocap_url))
        while True:
            hardware.run(pipe.fileno())
            try:
                kind, value = pipe.recv()
            except EOFError:
                return
            if kind == "fault":
                now_ns = CLOCK.now_ns()
                hardware.world.add_fault(Fault(value, max(0, now_ns - start_ns)))
                pipe.send(now_ns)
            elif kind == "log":
                pipe.send(hardware.world.log)


@dataclass
class Live:
    """The processes of one run and the hardware that they drive."""

    processes: RunProcesses  # this one is their parent
    hardware: Connection  # commands to the simulated hardware's process
    device: BaseProcess  # that process
    operator: Operator = field(default_factory=lambda: Operator(BOOT_ID, LEASE_ID, "test"))
    others: dict[str, int] = field(default_factory=dict)  # processes beside the run's own, by name
    listen: str = ""  # the run's endpoint on the bus
    # Takes the operator's requests in place of this parent, as page and gamepad do
    hand: Callable[[RequestKind], object] | None = None
    leave: Callable[[], object] | None = None  # closes the page, or unplugs the gamepad
    state: SupervisorState = SupervisorState.INIT  # as last reported, like the speed [m/s]
    # From, to, reason
    transitions: list[tuple[SupervisorState, SupervisorState, str]] = field(default_factory=list)
    speed: float = 0.0
    alive: bool = True  # whether the operator keeps the lease alive
    ended: bool = False
    _buffer: bytearray = field(default_factory=bytearray)
    _sent_ns: int = 0

    def ask(self, kind: RequestKind, operator: Operator | None = None) -> int:
        """An operator's request; the time at which it was sent."""
        if self.hand is not None:
            self.hand(kind)
            return CLOCK.now_ns()
        request = (operator or self.operator).make_request(kind, CLOCK.realtime_ns())
        packet = pack_request(topics.OPERATOR.name, request)
        now_ns = CLOCK.now_ns()
        with contextlib.suppress(OSError):
            self.processes.requests.send(packet)
        return now_ns

    def break_it(self, fault: str) -> int:
        """A fault of the hardware begins; the time at which it does."""
        self.hardware.send(("fault", fault))
        return self.hardware.recv()

    def frames(self) -> tuple[MotorFrame, ...]:
        self.hardware.send(("log", None))
        return read_motor_frames(self.hardware.recv())

    def pump(self, wait_s: float = 0.02) -> None:
        """Keep the lease and read the core's records."""
        now_ns = CLOCK.now_ns()
        if self.alive and now_ns - self._sent_ns >= KEEPALIVE_NS:
            self._sent_ns = now_ns
            self.ask(RequestKind.KEEPALIVE)
        fds = [] if self.ended else [self.processes.fds["status"]]
        if not select.select(fds, [], [], wait_s)[0]:
            return
        data = os.read(self.processes.fds["status"], 1 << 16)
        self.ended = not data
        self._buffer += data
        for record in unpack_records(self._buffer):
            if record.topic is topics.TRANSITION:
                change = decode(Transition, record.data)
                before, self.state = map(SupervisorState, (change.from_state, change.to_state))
                self.transitions.append((before, self.state, change.text))
            elif record.topic is topics.STATE:
                self.speed = decode(StateMessage, record.data).speed

    def until(self, holds: Callable[[], bool], limit_s: float = 30.0) -> None:
        """Pump until a condition holds, or TimeoutError."""
        end_ns = CLOCK.now_ns() + round(limit_s * NS)
        while not holds():
            if CLOCK.now_ns() > end_ns:
                raise TimeoutError(f"{self.state.name} {self.transitions}")
            self.pump()

    def live(self, seconds: float) -> None:
        end_ns = CLOCK.now_ns() + round(seconds * NS)
        self.until(lambda: CLOCK.now_ns() >= end_ns, seconds + 1.0)

    def reach(self, phase: str) -> None:
        """Bring the car into a phase of the matrix."""
        self.until(lambda: self.state is SupervisorState.READY)
        if phase == "P1":
            return
        self.ask(RequestKind.ARM)
        self.until(lambda: self.state is SupervisorState.ARMED)
        if phase == "P3":
            self.live(0.2)
            return
        self.ask(RequestKind.START)
        self.until(lambda: self.state is SupervisorState.RUNNING)
        self.until(lambda: self.speed > 0.8 or self.state is not SupervisorState.RUNNING)
        assert self.state is SupervisorState.RUNNING, f"stopped too soon: {self.transitions}"
        if phase == "P7":
            self.ask(RequestKind.STOP)
            self.until(lambda: self.state is not SupervisorState.RUNNING)

    def pids(self) -> dict[str, int]:
        """All processes of the run by name, and those beside it."""
        run = self.processes
        children = {name: each for name, each in run.children.items() if name != "viewer"}
        found = {name: child.process.pid for name, child in children.items()}
        core = found["core"]
        with contextlib.suppress(OSError):
            if pids := Path(f"/proc/{core}/task/{core}/children").read_text().split():
                found["guardian"] = int(pids[0])
        return found | self.others

    def end(self) -> int:
        """Let go whatever was frozen, end the run as a parent does; its exit code."""
        for pid in self.pids().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
        with contextlib.suppress(ProcessLookupError):
            self.processes.core.process.send_signal(signal.SIGTERM)
        self.alive = False
        return self.processes.end()


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return int(probe.getsockname()[1])


def free_endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@contextlib.contextmanager
def start_hardware() -> Iterator[tuple[Connection, BaseProcess, str, str]]:
    """Simulated hardware in a process: commands to it, it, its serial port and mocap address."""
    plan = make_plan(RunOptions(car_file="", path="line", speed=1.0))
    context = mp.get_context("spawn")
    ours, theirs = context.Pipe()
    config = replace(make_world_config(plan), keep_bytes=True)
    device = context.Process(target=serve_hardware, args=(config, theirs), daemon=True)
    device.start()
    theirs.close()
    port, url = ours.recv()
    try:
        yield ours, device, port, url
    finally:
        ours.close()
        device.join(5)
        if device.is_alive():
            device.kill()
            device.join()


@contextlib.contextmanager
def start_live(folder: Path, **more: Any) -> Iterator[Live]:
    """Hardware and processes; everything is ended and waited for on the way out."""
    with start_hardware() as (ours, device, port, url):
        options = RunOptions(
            car_file="", path="line", speed=1.0, port=port, mocap=url,
            listen=free_endpoint(), **more,
        )  # fmt: skip
        epoch_ns = CLOCK.realtime_ns() - CLOCK.now_ns()
        plan = make_plan(options, real=RunId(BOOT_ID, epoch_ns, leased=True))
        processes = start_processes(plan, folder / "drive.mcap")
        live = Live(processes, ours, device, listen=options.listen)
        try:
            yield live
        finally:
            live.end()
            os.close(processes.fds["status"])
