"""Whole drives: in virtual time within this process, in real time as processes of their own."""

import argparse
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest

from daemon.build import Plan, make_plan, make_world_config
from daemon.commands import run as run_command
from daemon.fast import make_recording
from daemon.transitions import State
from daemon.virtual import VirtualRun, drive, make_virtual_run
from sim_hw.faults import Fault
from sim_hw.world import World
from steer_bus.codec import encode
from steer_bus.messages import MocapPose, Transition
from steer_bus.session import AttachedFile, SessionWriter
from steer_bus.session_read import MESSAGE_TYPES, Record, open_session

SETTLE_NS = 3_000_000_000


@dataclass
class Driven:
    """One drive in virtual time.

    Attributes:
        plan: what was asked for.
        session: the recording.
        wire: SHA-256 of every byte on the serial wire, with its time.
        track: time since the start [ns] and true position [m] at each tick of the drive.
        faulted: whether a fault stopped it.
        reason: why the last state was entered.
    """

    plan: Plan
    session: Path
    wire: str = ""
    track: list[tuple[int, float, float]] = field(default_factory=list)
    faulted: bool = False
    reason: str = ""

    def offsets(self, curve: np.ndarray | None = None) -> np.ndarray:
        """True distance from the path, or from a closed curve of points, after 3 s [m]."""
        points = [(x, y) for t, x, y in self.track if t - self.track[0][0] >= SETTLE_NS]
        assert len(points) > 100, self.reason
        path = self.plan.path
        if curve is None:
            return distances(np.array(points), np.column_stack([path.x, path.y]), path.closed)
        return distances(np.array(points), curve, True)

    def transitions(self) -> list[Transition]:
        """The supervisor's changes, as recorded."""
        records = open_session(self.session).messages(f"/steerd/{self.plan.options.car}/transition")
        return [record.decode() for record in records]


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


def make_drive_plan(line: str) -> Plan:
    """The plan of a command line after `steerd run --sim --fast`."""
    parser = argparse.ArgumentParser()
    run_command.add_arguments(parser)
    args = parser.parse_args(["--sim", "--fast", *shlex.split(line)])
    return make_plan(run_command.make_options(args))


@pytest.fixture
def drive_fast(tmp_path: Path) -> Drive:
    """Drive as `steerd run --sim --fast` does, with the truth beside it."""
    count = 0

    def go(line: str, faults: Sequence[Fault] = ()) -> Driven:
        nonlocal count
        count += 1
        driven = Driven(make_drive_plan(line), tmp_path / f"drive{count}.mcap")
        recording = make_recording(driven.plan, driven.session)

        def sink(records: list, t_ns: int) -> None:
            for record in records:
                recording.add(record)

        def note(run: VirtualRun) -> None:
            if run.core.loop.supervisor.state is State.RUNNING:
                truth = run.world.truth()
                driven.track.append((truth.t_ns, truth.state.x, truth.state.y))

        world = World(make_world_config(driven.plan), faults)
        run = make_virtual_run(driven.plan, (sink,), world)
        drive(run, note)
        recording.writer.finish({"reason": "end of the run"})
        driven.wire = run.wire.hexdigest()
        driven.faulted = run.core.loop.faulted
        driven.reason = run.core.loop.supervisor.reason
        return driven

    return go


Change = Callable[[Record], bytes | None]


def copy_session(source: Path, target: Path, change: Change) -> None:
    """Copy a session, message by message: `change` gives new bytes, the old ones, or None."""
    session = open_session(source)
    info = session.info()
    kept = [AttachedFile(n, "text/plain", session.attachment(n)) for n in info.attachments]
    classes = {t.name: MESSAGE_TYPES[t.type_name] for t in info.topics}
    meta = {k: v for k, v in info.metadata.items() if k != "steerd.end"}
    writer = SessionWriter(target, classes, meta, kept, info.start_ns)
    for record in session.messages():
        data = change(record)
        if data is not None:
            writer.write(record.topic, data, record.log_ns, record.publish_ns)
    writer.finish({"reason": "copied"})


@pytest.fixture
def tamper_pose(tmp_path: Path) -> Callable[[Path], Path]:
    """Copy a session with one pose moved by 5 mm, in the middle of the drive."""

    def go(source: Path) -> Path:
        poses = sum(r.topic.endswith("/mocap") for r in open_session(source).messages())
        seen = 0

        def change(record: Record) -> bytes:
            nonlocal seen
            if not record.topic.endswith("/mocap"):
                return record.data
            seen += 1
            pose: MocapPose = record.decode()
            return encode(replace(pose, y=pose.y + 0.005)) if seen == poses // 2 else record.data

        target = tmp_path / f"tampered_{source.name}"
        copy_session(source, target, change)
        return target

    return go
