"""Whole drives: in virtual time within this process, in real time as processes of their own."""

import codecs
import contextlib
import os
import re
import select
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from steerd.daemon.assembly.build import RunPlan, make_plan, make_world_config
from steerd.daemon.cli.commands import run as run_command
from steerd.daemon.cli.main import run_cli
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.fast import record_virtual
from steerd.daemon.offline.virtual import VirtualRun, drive
from steerd.sim_hw.world import World
from steerd.steer_bus.messages import Transition
from steerd.steer_bus.session_read import open_session
from tests.contract.command_page import make_parser
from tests.safety.live import free_endpoint

SETTLE_NS = 3_000_000_000


@dataclass
class Driven:
    plan: RunPlan  # what was asked for
    session: Path  # the recording
    wire: str = ""  # SHA-256 of every byte on the serial wire, with its time
    # Time since the start [ns] and true position [m] at each tick of the drive
    track: list[tuple[int, float, float]] = field(default_factory=list)
    faulted: bool = False  # whether a fault stopped it
    reason: str = ""  # why the last state was entered

    def offsets(self, curve: np.ndarray | None = None) -> np.ndarray:
        """True distance from the path, or from a closed curve of points, after 3 s [m]."""
        points = [(x, y) for t, x, y in self.track if t - self.track[0][0] >= SETTLE_NS]
        assert len(points) > 100, self.reason
        path = self.plan.path
        if curve is None:
            return distances(np.array(points), np.column_stack([path.x, path.y]), path.closed)
        return distances(np.array(points), curve, True)


def distances(points: np.ndarray, curve: np.ndarray, closed: bool) -> np.ndarray:
    """Distances from points to a polygon [m], by looking at every side of it (no `project`)."""
    a, b = curve, np.roll(curve, -1, axis=0)
    if not closed:
        a, b = a[:-1], b[:-1]
    along = b - a
    rel = points[:, None, :] - a[None]
    share = np.clip((rel * along).sum(2) / (along * along).sum(1), 0.0, 1.0)
    return np.linalg.norm(rel - share[..., None] * along, axis=2).min(1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


Drive = Callable[..., Driven]


def make_drive_plan(line: str) -> RunPlan:
    """The plan of a command line after `steerd run --sim --fast`."""
    args = make_parser("run").parse_args(["--sim", "--fast", *shlex.split(line)])
    return make_plan(run_command.make_options(args))


@pytest.fixture
def drive_fast(tmp_path: Path) -> Drive:
    count = 0

    def go(line: str) -> Driven:
        nonlocal count
        count += 1
        driven = Driven(make_drive_plan(line), tmp_path / f"drive{count}.mcap")

        def note(run: VirtualRun) -> None:
            if run.core.loop.supervisor.state is SupervisorState.RUNNING:
                car = run.world.car
                driven.track.append((car.t_ns, car.state.x, car.state.y))

        world = World(make_world_config(driven.plan))
        run = record_virtual(driven.plan, driven.session, lambda run: drive(run, note), world=world)
        driven.wire = run.wire.hexdigest()
        driven.faulted = run.core.loop.faulted
        driven.reason = run.core.loop.supervisor.reason
        return driven

    return go


# --- real time: processes
DEADLINE_S = 60.0
"""A hung process fails its test after this; nothing takes a tenth of it on a quiet machine."""


def children(pid: int) -> list[int]:
    """Processes that a process started, and those that they started."""
    found = []
    for file in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += [int(text) for text in file.read_text().split()]
    return [each for child in found for each in (child, *children(child))]


STEERD = ("-m", "steerd")


class Program:
    """`steerd …` as a process; its output is read while it is waited for."""

    def __init__(self, *argv, module=STEERD, stdin=subprocess.DEVNULL, **options):
        self.process = subprocess.Popen(
            [sys.executable, *module, *argv], stdin=stdin, stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT, env={**os.environ, "PYTHONUNBUFFERED": "1", "COLUMNS": "200"},
            process_group=0, **options,
        )  # fmt: skip
        with contextlib.suppress(PermissionError):  # before its neighbours, where that is allowed
            os.setpriority(os.PRIO_PROCESS, self.process.pid, -15)
        self.fd = self.process.stdout.fileno()
        self._end = os.pidfd_open(self.process.pid)
        self.argv = argv
        self.text = ""  # what it has written so far, both streams
        self._decoder = codecs.getincrementaldecoder("utf-8")()

    def pump(self, seconds: float) -> bool:
        """Wait for output or the end, take in what there is; False once it has ended."""
        ready = select.select([self.fd, self._end], [], [], seconds)[0]
        if self.fd in ready:
            data = os.read(self.fd, 65536)
            self.text += self._decoder.decode(data)
            if data:
                return True
        return self._end not in ready

    def expect(self, pattern: str) -> re.Match[str]:
        """Wait until it writes something."""
        end = time.monotonic() + DEADLINE_S
        while (found := re.search(pattern, self.text)) is None:
            assert time.monotonic() < end, f"no {pattern!r} in time from {self.argv}:\n{self.text}"
            alive = self.pump(0.5)
            assert alive or re.search(pattern, self.text), f"{self.argv} ended:\n{self.text}"
        return found

    def wait(self) -> int:
        """Wait for its end; its exit code."""
        end = time.monotonic() + DEADLINE_S
        while self.pump(0.5):
            assert time.monotonic() < end, f"{self.argv} does not end:\n{self.text}"
        while select.select([self.fd], [], [], 0.0)[0] and (data := os.read(self.fd, 65536)):
            self.text += self._decoder.decode(data)
        return self.process.wait()

    def send(self, number: int) -> None:
        self.process.send_signal(number)

    def interrupt(self) -> int:
        """Ctrl-C; its exit code."""
        self.send(signal.SIGINT)
        return self.wait()

    def child(self, module: str) -> int:
        """The process of one of its parts, by its module's name."""
        for pid in children(self.process.pid):
            with contextlib.suppress(OSError):
                if module in Path(f"/proc/{pid}/cmdline").read_text():
                    return pid
        raise AssertionError(f"no {module} among the children of {self.argv}")

    def close(self) -> None:
        """End it and all that it started."""
        if self.process.poll() is None:
            family = children(self.process.pid)
            self.process.send_signal(signal.SIGTERM)
            try:
                self.process.wait(5.0)
            except subprocess.TimeoutExpired:
                for pid in (self.process.pid, *family):
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pid, signal.SIGKILL)
                self.process.wait()
        os.close(self._end)
        if self.process.stdout is not None:
            self.process.stdout.close()


class Launcher:
    """Starts `steerd …`, and ends whatever still runs."""

    def __init__(self) -> None:
        self._started: list[Program] = []
        self.endpoint = free_endpoint()

    def __call__(self, *argv: object, **options: object) -> Program:
        self._started.append(Program(*map(str, argv), **options))
        return self._started[-1]

    def sim(self, folder: Path, *more: str) -> tuple[str, str]:
        """Simulated hardware on the test's terms: its port and mocap address.

        On a port a tick that comes 25 ms late stops the car (W15), and so do mocap and telemetry
        that a stalled simulator keeps back (W1, W7): what drives so is marked `realtime`.
        """
        sim = self("sim", "--link-dir", folder, "--seed", "3", *more)
        url = sim.expect(r"mocap: (\S+)\n")[1]
        # Hardware does not wait for this machine's other programs; below the core's own priority.
        with contextlib.suppress(PermissionError):
            how = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(sim.process.pid, how, os.sched_param(40))
        return sim.expect(r"VESC:\s+(\S+)\n")[1], url

    def close(self) -> None:
        for program in reversed(self._started):
            program.close()


@pytest.fixture
def steerd() -> Iterator[Launcher]:
    """Start `steerd …`; whatever still runs at the end is ended."""
    launcher = Launcher()
    yield launcher
    launcher.close()


def changes(session: Path) -> list[Transition]:
    """The supervisor's changes in a session, finished or not."""
    path = session if session.exists() else session.with_name(session.name + ".partial")
    if not path.exists():
        return []
    records = open_session(path).messages("/steerd/car1/transition")
    return [record.decode() for record in records]


def replays(session: Path, capsys: pytest.CaptureFixture[str]) -> bool:
    """`steerd replay` gives every order of a session again."""
    capsys.readouterr()
    code = run_cli(["replay", str(session)])
    said = capsys.readouterr().out
    assert re.fullmatch(r"\d{3,} commands replayed: all equal the recorded ones\n", said), said
    return code == 0
