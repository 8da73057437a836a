"""Faults in real time: real processes, signals, sockets and a pty, judged on the pty's byte log.

Other programs share the machine, so what is asserted is the order of the bytes, and bounds that are
ten times looser than those promised; ``benchmarks/stop_latency.py`` has the figures. A seeded
quarter runs by default, all of them with ``STEERD_LIVE=all`` (`make safety`).
"""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from steerd.daemon.ipc.operator import Operator
from steerd.daemon.loop.transitions import SupervisorState
from steerd.sim_hw.judge import Effort, count_drive_frames, find_stop
from steerd.steer_bus.messages import RequestKind
from steerd.steer_bus.session_read import open_session
from tests.safety.live import BOOT_ID, CLOCK, Live, start_live

pytestmark = [pytest.mark.realtime, pytest.mark.timeout(240)]
MS = 1_000_000
STRANGER = Operator(BOOT_ID, 99, "stranger")


@dataclass(frozen=True)
class LiveFault:
    """What is done, how soon stop bytes must come, and what else is looked at.

    Attributes:
        act: does it; returns when it was done.
        bound_s: until the first stop byte, loosely.
        phases: where it is tried.
        wire: whether bytes still reach the VESC.
        reported: whether a process is left that can report the reason.
    """

    act: Callable[[Live], int]
    bound_s: float
    phases: str = "P1 P3 P5 P7"
    wire: bool = True
    reported: bool = True


def send(process: str, number: signal.Signals, times: int = 1) -> Callable[[Live], int]:
    def act(live: Live) -> int:
        pid = getattr(live.processes, process).process.pid
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


def kill_guardian(live: Live) -> int:
    now_ns = CLOCK.now_ns()
    for pid in live.children_of_core():
        os.kill(pid, signal.SIGKILL)
    return now_ns


def fall_silent(live: Live) -> int:
    live.alive = False
    return CLOCK.now_ns()


def hardware(fault: str) -> Callable[[Live], int]:
    return lambda live: live.break_it(fault)


FAULTS = {
    "SIGINT": LiveFault(send("core", signal.SIGINT), 0.3),
    "SIGTERM": LiveFault(send("core", signal.SIGTERM), 0.3),
    "SIGHUP": LiveFault(send("core", signal.SIGHUP), 0.3),
    "SIGTERM twice": LiveFault(send("core", signal.SIGTERM, 2), 0.3, "P5 P7"),
    "SIGKILL core": LiveFault(send("core", signal.SIGKILL), 0.3, reported=False),
    "SIGABRT core": LiveFault(send("core", signal.SIGABRT), 0.3, "P3 P5", reported=False),
    "SIGSEGV core": LiveFault(send("core", signal.SIGSEGV), 0.3, "P5 P7", reported=False),
    "SIGSTOP core": LiveFault(freeze_core, 0.5, reported=False),
    "SIGKILL guardian": LiveFault(kill_guardian, 0.6, "P1 P3 P5 P7"),
    "SIGKILL recorder": LiveFault(send("recorder", signal.SIGKILL), 0.6),
    "SIGKILL gateway": LiveFault(send("gateway", signal.SIGKILL), 0.6),
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
    "stranger's stop": LiveFault(lambda live: live.ask(RequestKind.STOP, STRANGER), 0.3, "P5 P7"),
    "stranger's e-stop": LiveFault(
        lambda live: live.ask(RequestKind.ESTOP, STRANGER), 0.3, "P1 P3 P5"
    ),
}
CELLS = [(name, phase) for name, fault in FAULTS.items() for phase in fault.phases.split()]


def chosen() -> list[tuple[str, str]]:
    if os.environ.get("STEERD_LIVE") == "all":
        return CELLS
    rng = np.random.default_rng(int(os.environ.get("STEERD_LIVE", "0")))
    return [CELLS[k] for k in sorted(rng.choice(len(CELLS), len(CELLS) // 4, replace=False))]


def test_there_are_enough_cells() -> None:
    assert len(CELLS) >= 40


@pytest.mark.parametrize(("name", "phase"), chosen())
def test_live_cell(name, phase, tmp_path) -> None:
    fault = FAULTS[name]
    with start_live(tmp_path) as live:
        live.reach(phase)
        known = len(live.transitions)
        fault_ns = fault.act(live)
        live.live(2.5 if phase in ("P5", "P7") else 1.0)
        frames = [frame for frame in live.frames() if frame.t_ns >= fault_ns - 50 * MS]
        followed = live.transitions[known:]
    after = [frame for frame in frames if frame.t_ns >= fault_ns]
    if phase in ("P1", "P3"):
        assert not any(frame.effort is Effort.DRIVE for frame in after)
    elif fault.wire:
        stop = find_stop(frames, fault_ns)
        assert stop is not None, after[-5:]
        assert stop.t_ns - fault_ns <= fault.bound_s * 1e9
        brake_ns = next(f.t_ns for f in after if f.effort is not Effort.DRIVE)
        assert not count_drive_frames(after, brake_ns)
    else:
        assert not count_drive_frames(after, fault_ns + round(fault.bound_s * 1e9))
    assert SupervisorState.RUNNING not in [to for _, to, _ in followed]
    if fault.reported and phase in ("P3", "P5"):
        assert followed
        assert all(reason for _, _, reason in followed)


def test_a_killed_recorder_leaves_a_readable_session(tmp_path) -> None:
    with start_live(tmp_path) as live:
        live.reach("P5")
        send("recorder", signal.SIGKILL)(live)
        live.until(lambda: live.state is SupervisorState.DISARMED)
        assert any(
            to is SupervisorState.STOPPING and "recorder" in reason
            for _, to, reason in live.transitions
        )
    (partial,) = tmp_path.glob("drive.mcap*")
    session = open_session(partial)
    assert session is not None
