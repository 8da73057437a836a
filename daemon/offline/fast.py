"""`steerd run --sim --fast`: virtual time, one process, the same session file for the same seed."""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from steerd.daemon.assembly.build import RunPlan, make_world_config
from steerd.daemon.assembly.session_meta import (
    default_session_path,
    make_attachments,
    make_metadata,
)
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.common.screen import raw
from steerd.daemon.common.translate import make_session_error, reading
from steerd.daemon.ipc.pipe_records import PipeRecord, is_learnt_from, read_message
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import EPOCH_NS, VirtualRun, drive, make_virtual_run
from steerd.daemon.process.recorder import Recording
from steerd.daemon.terminal.dashboard import Dashboard, closing_lines
from steerd.sim_hw.world import World
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.session_read import SessionError

if TYPE_CHECKING:
    from steerd.daemon.learning.feed import Feed


class LearnerBeside:
    """The learner of `--learn`, in virtual time: records in, reports out; without it none.

    Attributes:
        propose_to: takes the proposals of `--adapt`, and when they were made [ns].
    """

    def __init__(self, plan: RunPlan) -> None:
        """Load the car.

        Raises:
            ValueError: the car file holds what identify does not write.
        """
        settings = plan.settings
        self._feed: Feed | None = None
        if plan.options.learn:  # a drive without it loads no compiler
            from steerd.daemon.learning.feed import make_feed, wiring_of

            self._feed = make_feed(settings.file, wiring_of(EPOCH_NS, settings.scaling))
        self._reports = 0
        if self._feed is not None and plan.learnt is not None:
            from steerd.controller.build import compute_table
            from steerd.daemon.learning.proposing import Proposals, make_proposer

            proposer = make_proposer(plan.learnt, compute_table)
            self._feed.proposals = Proposals(
                proposer, lambda data, t_ns: self.propose_to(data, t_ns)
            )
        self.propose_to: Callable[[bytes, int], None] = lambda data, t_ns: None

    def take(self, record: PipeRecord) -> Iterator[PipeRecord]:
        """The record, and the report that it completes."""
        yield record
        if self._feed is None or not is_learnt_from(record):
            return
        from steerd.daemon.learning.feed import make_record

        report = self._feed.take(record.topic, read_message(record))
        if report is not None:
            yield make_record(report, self._reports, record.log_time_ns)
            self._reports += 1


def make_recording(plan: RunPlan, path: Path) -> Recording:
    """A session file for a run in virtual time.

    Raises:
        SteerdError: it cannot be created.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        hint = "choose another place with --record"
        raise SteerdError(f"{path.parent}: {error.strerror}", hint, ExitCode.UNREADABLE) from None
    meta = {
        "metadata": make_metadata(
            plan, plan.options.seed + 1, EPOCH_NS, leased=False, reproducible=True
        ),
        "attachments": make_attachments(plan),
        "start_ns": EPOCH_NS,
    }
    try:
        return Recording(path, plan.options.car, meta)
    except SessionError as error:
        raise make_session_error(error, "choose another file with --record") from None


def record_virtual(
    plan: RunPlan,
    path: Path,
    go: Callable[[VirtualRun], None],
    see: Callable[[list[PipeRecord], int], None] = lambda records, t_ns: None,
    world: World | None = None,
) -> VirtualRun:
    """Drive in virtual time into a session file; an interrupted drive is kept as far as it came.

    Args:
        plan: what to drive.
        path: the session file.
        go: drives the run to its end.
        see: is handed what was recorded, and when [ns].
        world: the simulated hardware; None for that of the plan.

    Raises:
        SteerdError: the disk does not take the file; what was written of it stays.
    """
    world = world or World(make_world_config(plan))
    recording = make_recording(plan, path)
    learner = LearnerBeside(plan)

    def sink(records: list[PipeRecord], t_ns: int) -> None:
        try:
            for record in records:
                for each in learner.take(record):
                    recording.add(each)
            recording.writer.tick(t_ns)
        except SessionError as error:  # not for the core: it would stop the car for a bug (W29)
            run.failed = run.failed or make_session_error(error)
        see(records, t_ns)

    run = make_virtual_run(plan, (sink,), world)
    learner.propose_to = run.core.on_proposal
    reason = "interrupted"
    try:
        go(run)
        reason = "end of the run"
    finally:
        with reading(path):
            recording.writer.finish({"reason": reason, "written": str(recording.written)})
    return run


def run_fast(plan: RunPlan) -> int:
    """Drive in virtual time and print the outcome."""
    if plan.options.duration_s is None:
        raise SteerdError("--fast needs an end", "add --duration 30", ExitCode.USAGE)
    clock = MonotonicClock()
    began = clock.now_ns()
    record = plan.options.record
    path = (
        Path(record)
        if record
        else default_session_path(plan.options.car, clock.realtime_ns(), began)
    )
    board, duration = Dashboard(""), plan.options.duration_s

    def see(records: list[PipeRecord], t_ns: int) -> None:
        for each in records:
            line = board.take(each)
            if line is not None:
                print(f"{t_ns * 1e-9:8.2f} s  {line}")

    def go(run: VirtualRun) -> None:
        with_progress(run, duration, lambda tick: drive(run, tick))

    try:
        run = record_virtual(plan, path, go, see)
    except KeyboardInterrupt:
        print(f"interrupted; what was driven so far: {path}", file=sys.stderr)
        raise
    factor = run.t_ns / max(clock.now_ns() - began, 1)
    summary, *hints = closing_lines(plan, board.tally, path)
    print(summary)
    print(f"bytes on the wire: sha256 {run.wire.hexdigest()[:16]}; {factor:.1f} x real time")
    print("\n".join(hints))
    loop = run.core.loop
    if loop.faulted:
        print(f"stopped: {loop.fault}")
        return ExitCode.STOPPED
    check_driven(run)
    return ExitCode.OK


def check_driven(run: VirtualRun) -> None:
    """Refuse a run in which the car was never driven.

    Raises:
        SteerdError: what it was waiting for.
    """
    if not run.core.loop.ran:
        waiting = run.core.last.waiting if run.core.last else ""
        raise SteerdError(f"the car was never driven: waiting for {waiting}", "", ExitCode.STOPPED)


def with_progress(
    run: VirtualRun, duration_s: float, go: Callable[[Callable[[VirtualRun], None]], None]
) -> None:
    """Drive, with a progress bar on a terminal."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(file=raw(sys.stderr))
    with Progress(console=console, disable=not sys.stderr.isatty(), transient=True) as progress:
        task = progress.add_task("driving", total=duration_s)

        def tick(now: VirtualRun) -> None:
            if now.core.loop.supervisor.state is SupervisorState.RUNNING:
                progress.advance(task, now.period_ns * 1e-9)

        go(tick)
