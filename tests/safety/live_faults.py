"""What is done to real processes, sockets and a pty, what the car must do, and how it is judged.

Only the outside world is changed: signals, faults of the simulated hardware, silence, requests.
"""

import contextlib
import os
import signal
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any

from steerd.daemon.common.errors import ExitCode
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process.bus_operator import Operator
from steerd.steer_bus.messages import RequestKind
from steerd.steer_bus.session_read import open_session
from tests.safety.judge import Effort, count_drive_frames, find_stop
from tests.safety.live import BOOT_ID, CLOCK, Live, start_live
from tests.safety.live_hands import at_terminal, driven_by_another, held_by_gamepad, held_by_page

MS = 1_000_000
PHASES = ("P1", "P3", "P5", "P7")
MOVING = ("P5", "P7")
STRANGER = Operator(BOOT_ID, 99, "stranger")
Start = Callable[[Path], contextlib.AbstractContextManager[Live]]


@dataclass(frozen=True)
class LiveFault:
    """What is done, how soon stop bytes must come, and what else is looked at."""

    act: Callable[[Live], int]  # does it; returns when it was done
    bound_s: float | None  # until the first stop byte, loosely; None where nothing may stop the car
    phases: str = "P1 P3 P5 P7"  # where it is tried
    wire: bool = True  # whether bytes still reach the VESC
    reported: str = "P3 P5"  # phases in which a process is left that reports the reason
    named: str = ""  # how the reason begins in P5
    start: Start = start_live  # what it is tried on
    watch_s: float = 0.0  # how long it is watched, beyond the usual
    code: ExitCode | None = None  # of the run that it ended in P5; None: nothing is said of it


@dataclass(frozen=True)
class LiveOutcome:
    """One cell: time to the first stop byte [ms], -1 where there is none; what is wrong."""

    name: str
    phase: str
    stop_ms: float = -1.0
    reason: str = ""
    wrong: tuple[str, ...] = ()


def send(process: str, number: signal.Signals, times: int = 1) -> Callable[[Live], int]:
    def act(live: Live) -> int:
        pid = live.pids()[process]
        now_ns = CLOCK.now_ns()
        for _ in range(times):
            os.kill(pid, number)
            live.pump(0.005)
        return now_ns

    return act


def freeze_core(live: Live) -> int:
    begun_ns = send("core", signal.SIGSTOP)(live)
    live.live(0.4)
    send("core", signal.SIGCONT)(live)
    return begun_ns


def fall_silent(live: Live) -> int:
    live.alive = False
    return CLOCK.now_ns()


def leave(live: Live) -> int:
    """Whoever drives closes the page, or unplugs the gamepad."""
    now_ns = CLOCK.now_ns()
    live.leave()
    return now_ns


hardware = partial(methodcaller, "break_it")
learning = partial(start_live, learn=True)
STOP, KILL = signal.SIGSTOP, signal.SIGKILL
OK, STOPPED = ExitCode.OK, ExitCode.STOPPED
FAULTS = {
    "SIGINT": LiveFault(send("core", signal.SIGINT), 0.3),
    "SIGTERM": LiveFault(send("core", signal.SIGTERM), 0.3),
    "SIGHUP": LiveFault(send("core", signal.SIGHUP), 0.3),
    "SIGTERM twice": LiveFault(send("core", signal.SIGTERM, 2), 0.3, "P5 P7"),
    "SIGABRT core": LiveFault(send("core", signal.SIGABRT), 0.3, "P3 P5", reported=""),
    "SIGSEGV core": LiveFault(send("core", signal.SIGSEGV), 0.3, "P5 P7", reported=""),
    "SIGKILL core": LiveFault(send("core", KILL), 0.3, reported="", code=STOPPED),
    "SIGSTOP core": LiveFault(freeze_core, 0.5, reported=""),
    "SIGKILL guardian": LiveFault(send("guardian", KILL), 0.6, named="W16", code=STOPPED),
    "SIGSTOP guardian": LiveFault(send("guardian", STOP), 0.6, named="W16"),
    "SIGKILL recorder": LiveFault(send("recorder", KILL), 0.6, named="W26", code=STOPPED),
    "SIGSTOP recorder": LiveFault(send("recorder", STOP), 18.0, named="W26", watch_s=18.0),
    "SIGKILL gateway": LiveFault(send("gateway", KILL), 0.6, named="W27"),
    "SIGSTOP gateway": LiveFault(
        send("gateway", STOP), 1.6, named="W27", watch_s=1.0, code=STOPPED),
    "SIGKILL learner": LiveFault(send("learner", KILL), None, start=learning),
    "SIGSTOP learner": LiveFault(send("learner", STOP), None, start=learning),
    "SIGKILL page": LiveFault(send("page", KILL), 1.0, named="W25", start=held_by_page),
    "SIGSTOP page": LiveFault(send("page", STOP), 1.0, named="W25", start=held_by_page),
    "page silent": LiveFault(fall_silent, 0.65, "P5", named="W25", start=held_by_page),
    "page closed": LiveFault(leave, 0.65, "P5", named="W25", start=held_by_page),
    "gamepad released": LiveFault(
        methodcaller("ask", RequestKind.STOP), 0.65, "P5", start=held_by_gamepad),
    "gamepad unplugged": LiveFault(leave, 0.65, "P5", start=held_by_gamepad, code=OK),
    "gamepad silent": LiveFault(fall_silent, 1.15, "P5", start=held_by_gamepad, code=OK),
    "SIGKILL gamepad": LiveFault(
        send("gamepad", KILL), 0.65, "P5", named="W25", start=held_by_gamepad, code=STOPPED),
    "SIGSTOP gamepad": LiveFault(
        send("gamepad", STOP), 0.65, "P5", named="W25", start=held_by_gamepad, code=STOPPED),
    "SIGKILL controller": LiveFault(
        send("controller", KILL), 0.8, named="W25", reported="P5", start=driven_by_another),
    "SIGSTOP controller": LiveFault(
        send("controller", STOP), 0.8, named="W25", reported="P5", start=driven_by_another),
    "SIGKILL terminal": LiveFault(send("terminal", KILL), 1.0, named="disarm", start=at_terminal),
    "SIGSTOP terminal": LiveFault(send("terminal", STOP), 1.0, named="W25", start=at_terminal),
    "mocap silent": LiveFault(hardware("M1"), 1.0, "P3 P5 P7"),
    "mocap frozen": LiveFault(hardware("M2"), 0.8, "P5"),
    "mocap jumps": LiveFault(hardware("M4"), 0.6, "P3 P5"),
    "mocap NaN": LiveFault(hardware("M8"), 1.0, "P3 P5"),
    "unplugged": LiveFault(hardware("V1"), 0.3, wire=False),
    "VESC mute": LiveFault(hardware("V4"), 1.0, "P3 P5"),
    "VESC fault": LiveFault(hardware("V13"), 0.4, "P3 P5"),
    "VESC reboots": LiveFault(hardware("V15"), 0.4, "P5", wire=False),
    "kill switch": LiveFault(hardware("V19"), 0.4, "P3 P5"),
    "operator gone": LiveFault(fall_silent, 1.5, "P3 P5"),
    "stranger's stop": LiveFault(methodcaller("ask", RequestKind.STOP, STRANGER), 0.3, "P5 P7"),
    "stranger's e-stop": LiveFault(
        methodcaller("ask", RequestKind.ESTOP, STRANGER), 0.3, "P1 P3 P5"),
}  # fmt: skip
CELLS = [(name, phase) for name, fault in FAULTS.items() for phase in fault.phases.split()]


def run_live(name: str, phase: str) -> LiveOutcome:
    """One cell, with hardware and processes of its own."""
    fault = FAULTS[name]
    with tempfile.TemporaryDirectory() as folder:
        with fault.start(Path(folder)) as live:
            live.reach(phase)
            known = len(live.transitions)
            fault_ns = fault.act(live)
            live.live((2.5 if phase in MOVING else 1.0) + fault.watch_s)
            frames = [frame for frame in live.frames() if frame.t_ns >= fault_ns - 50 * MS]
            followed = live.transitions[known:]
            code = live.end() if fault.code is not None and phase == "P5" else fault.code
        (session,) = Path(folder).glob("drive.mcap*")
        open_session(session)  # whatever happened, what was recorded can be read
    stop = find_stop(frames, fault_ns)
    stop_ms = (stop.t_ns - fault_ns) / MS if stop and phase in MOVING and fault.bound_s else -1.0
    reason = followed[0][2] if followed else ""
    wrong = tuple(judge(fault, phase, fault_ns, frames, followed))
    if code != fault.code:
        wrong += (f"ended with code {code} in place of {fault.code}",)
    return LiveOutcome(name, phase, round(stop_ms, 1), reason, wrong)


def judge(
    fault: LiveFault, phase: str, fault_ns: int, frames: list[Any], followed: list[Any]
) -> Iterator[str]:
    states = [to for _, to, _ in followed]
    yield from judge_frames(fault, phase, fault_ns, frames, states)
    if SupervisorState.RUNNING in states:
        yield f"went up by itself: {states}"
    if phase == "P5" and not (followed[:1] or [("", "", "")])[0][2].startswith(fault.named):
        yield f"not {fault.named}: {followed}"
    said = bool(followed) and all(reason for _, _, reason in followed)
    if fault.bound_s is not None and phase in fault.reported.split() and not said:
        yield f"no reason: {followed}"


def judge_frames(
    fault: LiveFault, phase: str, fault_ns: int, frames: list[Any], states: list[SupervisorState]
) -> Iterator[str]:
    after = [frame for frame in frames if frame.t_ns >= fault_ns]
    if phase not in MOVING:
        if any(frame.effort is Effort.DRIVE for frame in after):
            yield "a drive frame while not running"
    elif fault.bound_s is None:
        if phase == "P5" and states:
            yield f"false stop: {states}"
    elif not fault.wire:
        if count_drive_frames(after, fault_ns + round(fault.bound_s * 1e9)):
            yield "a drive frame after the bound"
    else:
        stop = find_stop(frames, fault_ns)
        if stop is None or stop.t_ns - fault_ns > fault.bound_s * 1e9:
            yield f"no stop byte within {fault.bound_s} s: {after[-3:]}"
        else:
            braked = [f.t_ns for f in after if f.effort is not Effort.DRIVE]
            if not braked or count_drive_frames(after, braked[0]):
                yield "a drive frame after the first brake, or no brake"
