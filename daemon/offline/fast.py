"""`steerd run --sim --fast`: virtual time, one process, the same session file for the same seed."""

import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path

from steerd.daemon.assembly.build import RunPlan, make_world_config
from steerd.daemon.assembly.session_meta import session_path
from steerd.daemon.common.errors import ExitCode, SteerdError, make_session_error, reading
from steerd.daemon.common.screen import show_progress
from steerd.daemon.ipc.pipe_records import PipeRecord, is_learnt_from
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.offline.virtual import VirtualRun, drive, make_virtual_run
from steerd.daemon.process.children import make_recorder_job
from steerd.daemon.process.recorder import Recording
from steerd.daemon.terminal.dashboard import Dashboard, closing_lines
from steerd.sim_hw.world import World
from steerd.steer_bus.clock import MonotonicClock
from steerd.steer_bus.session_read import SessionError


def make_recording(plan: RunPlan, path: Path) -> Recording:
    """A session file for a run in virtual time.

    Raises:
        SteerdError: it cannot be created.
    """
    with reading(path, "choose another file with --record"):
        return Recording(make_recorder_job(plan, path, {}))


def record_virtual(
    plan: RunPlan,
    path: Path,
    go: Callable[[VirtualRun], None],
    see: Callable[[list[PipeRecord], int], None] = lambda records, t_ns: None,
    world: World | None = None,
) -> VirtualRun:
    """Drive in virtual time into a session file; an interrupted drive is kept as far as it came.

    `go` drives the run to its end; `see` is handed what was recorded, and when [ns]; `world` is the
    simulated hardware where it is not the plan's.

    Raises:
        SteerdError: the disk does not take the file; what was written of it stays.
    """
    world = world or World(make_world_config(plan))
    recording = make_recording(plan, path)
    learner = None
    if plan.options.learn:  # a drive without it loads no compiler
        from steerd.daemon.process.learner import LearnerLoop

        learner = LearnerLoop(plan, lambda data, t_ns: run.core.on_proposal(data, t_ns))

    def sink(records: list[PipeRecord], t_ns: int) -> None:
        try:
            for record in records:
                recording.add(record)
                report = learner.take(record) if learner and is_learnt_from(record) else None
                if report is not None:
                    recording.add(report)
            recording.writer.tick(t_ns)
        except SessionError as error:  # not for the core: it would stop the car for a bug (W29)
            run.failed = run.failed or make_session_error(error)
        see(records, t_ns)

    run = make_virtual_run(plan, (sink,), world)
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
    path = session_path(plan.options, clock.realtime_ns(), began)
    board, duration = Dashboard(""), plan.options.duration_s

    def see(records: list[PipeRecord], t_ns: int) -> None:
        for line in filter(None, map(board.take, records)):
            print(f"{t_ns * 1e-9:8.2f} s  {line}")

    def go(run: VirtualRun) -> None:
        driven = count(1)
        with show_progress("driving", duration, even=True) as progress:

            def tick(now: VirtualRun) -> None:
                if now.core.loop.supervisor.state is SupervisorState.RUNNING:
                    progress(next(driven) * now.period_ns * 1e-9)

            drive(run, tick)

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
