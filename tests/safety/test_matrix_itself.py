"""The matrix can say no, every watchdog trips in a cell of it, and its pages show that."""

import inspect
import re
import struct
from dataclasses import replace
from pathlib import Path

import pytest

from steerd.daemon.assembly.build import NS
from steerd.daemon.loop.findings import WATCHDOGS
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.settings.thresholds import BOUNDS
from steerd.sim_hw.plant.faults import Fault
from steerd.sim_hw.vesc.vesc_wire import Logged
from steerd.steer_bus.messages import RequestKind
from steerd.vesc_link.frames import encode_frame
from tests.safety import judge
from tests.safety.catalogue import BY_CODE, nothing
from tests.safety.live_faults import CELLS, FAULTS
from tests.safety.matrix import run_cell
from tests.safety.outside import DRIVES, ELSEWHERE, list_outside
from tests.safety.rig import at_phase, twin
from tests.safety.trace import TRACES, find_code, run_trace, trips
from tests.unit.daemon.process import test_runner


def drive(t_ns: int, value: float = 5.0) -> judge.MotorFrame:
    return judge.MotorFrame(t_ns, judge.Effort.DRIVE, value)


def brake(t_ns: int) -> judge.MotorFrame:
    return judge.MotorFrame(t_ns, judge.Effort.BRAKE, 20.0)


def test_every_motor_command_is_read_for_what_it_does() -> None:
    sent = (  # id and count, from the protocol's table
        (8, 4000, judge.Effort.DRIVE, 4000.0), (8, -4000, judge.Effort.DRIVE, 4000.0),
        (6, 3000, judge.Effort.DRIVE, 3.0), (6, 0, judge.Effort.RELEASE, 0.0),
        (7, 20_000, judge.Effort.BRAKE, 20.0), (7, 0, judge.Effort.RELEASE, 0.0),
        (5, 50_000, judge.Effort.DRIVE, 0.5), (5, 0, judge.Effort.BRAKE, 0.0),
        (9, 90_000_000, judge.Effort.DRIVE, 90.0), (84, 50_000, judge.Effort.DRIVE, 0.5),
        (10, 5000, judge.Effort.BRAKE, 5.0),
    )  # fmt: skip
    data = b"".join(encode_frame(struct.pack(">Bi", number, count)) for number, count, _, _ in sent)
    data += encode_frame(b"\x0c\x01\xf4") + encode_frame(b"\x04")
    log = [Logged(7, "vesc", data[:9]), Logged(8, "host", b"\x02\x01"), Logged(9, "vesc", data[9:])]
    assert [(f.effort, f.value) for f in judge.read_motor_frames(log)] == [
        each[2:] for each in sent
    ]


def test_a_stop_that_is_taken_back_is_none() -> None:
    assert judge.find_stop([drive(1), brake(2), brake(3)], 0) == brake(2)
    slower = [drive(1), drive(2), drive(3, 4.0), drive(4, 3.0), brake(5)]
    assert judge.find_stop(slower, 0) == drive(3, 4.0)
    assert judge.find_stop([drive(1), brake(2), drive(3), brake(4)], 0) == brake(4)
    assert judge.find_stop([drive(1), drive(2, 4.0), drive(3, 4.5), brake(4)], 0) == brake(4)
    assert judge.find_stop([drive(1), drive(2)], 0) is None
    assert judge.find_stop([drive(1), brake(2), brake(3)], 3) == brake(3)
    assert judge.find_stop([drive(1), drive(2, 4.0), brake(3)], 0, ramps=False) == brake(3)
    assert judge.find_stop([drive(1), brake(2), drive(3, 4.0)], 0, ramps=False) is None


def test_frames_and_distances_are_counted_measured_and_computed() -> None:
    assert judge.count_drive_frames([drive(1), brake(2), drive(3), drive(4)], 2) == 2
    assert judge.count_drive_frames([drive(2), brake(3)], 2) == 0
    track = [judge.Motion(k, 0.3 * k, 0.4 * k, 1.0) for k in range(5)]
    assert judge.distance_driven(track, 1) == pytest.approx(1.5)
    assert judge.stopping_distance(2.0, 0.1, 4.0) == pytest.approx(0.7)


@pytest.mark.parametrize(("code", "phase"), [
    ("M1", "P5"), ("V4", "P6"), ("H1", "P5"), ("V19", "P4"), ("M24", "P1"), ("V13", "P2"),
    ("V1", "P3"), ("V24", "P0"), ("M10", "P0"), ("V5", "P5"),
])  # fmt: skip
def test_without_the_fault_the_cell_fails(code: str, phase: str) -> None:
    """Each kind of verdict is one that sound hardware and a silent daemon cannot earn."""
    sound = replace(BY_CODE[code], begin=nothing, each=nothing)
    assert run_cell(sound, phase).wrong


@pytest.mark.parametrize(("code", "like", "bound_s", "verdict"), [
    ("Z2", "M1", 0.1, "(a)"), ("M1", "M17", 0.0, "(f)"),
], ids=["goes on driving", "a false stop"])  # fmt: skip
def test_a_daemon_that_does_otherwise_is_found_out(code, like, bound_s, verdict) -> None:
    wanted = replace(BY_CODE[code], must=BY_CODE[like].must, bound_s=bound_s)
    assert any(word.startswith(verdict) for word in run_cell(wanted, "P5").wrong)


# Every watchdog of the safety page exists, trips in its cell, and its absence shows there.

PAGES = Path(__file__).parents[2] / "docs" / "reference"


def test_every_watchdog_is_traced_and_every_threshold_belongs_to_one() -> None:
    assert list(TRACES) == [f"W{k}" for k in range(1, len(TRACES) + 1)]
    assert set(TRACES) == {id for id in WATCHDOGS if id.startswith("W")}
    used = {name for trace in TRACES.values() for name in trace.thresholds}
    assert used == set(BOUNDS)
    for trace in TRACES.values():
        assert callable(find_code(trace.code))
        assert trace.cell[0] in BY_CODE


def test_the_pages_show_every_watchdog_under_its_name() -> None:
    required = (PAGES / "safety-requirements.md").read_text(encoding="utf-8")
    rows = re.findall(r'^\| <a id="(w\d+)"></a>(W\d+) ([^|]+?) \|', required, re.M)
    assert rows == [(id.lower(), id, WATCHDOGS[id].name) for id in TRACES]
    _, _, matrix = (PAGES / "safety-matrix.md").read_text("utf-8").partition("<!-- trace: begin")
    shown = re.findall(r"^\| (W\d+) .*?\| (.*?) \|", matrix.partition("<!-- trace: end")[0], re.M)
    assert [id for id, _ in shown] == list(TRACES)
    assert all(changed in dict(shown)[id] for id, changed in list_outside().items())


@pytest.mark.slow
@pytest.mark.parametrize("id", TRACES)
def test_it_trips_in_its_cell_and_its_absence_shows(id: str) -> None:
    shown, without = run_trace(id)
    assert trips(id, shown), shown
    assert not shown.wrong or TRACES[id].behind, shown
    assert not trips(id, without)
    assert without.wrong or without.reasons != shown.reasons


# Every watchdog trips in a cell in which nothing but the outside world is changed.


def test_each_watchdog_has_one() -> None:
    traced = {id for id, trace in TRACES.items() if not BY_CODE[trace.cell[0]].inside}
    assert traced | set(DRIVES) | set(ELSEWHERE) == set(TRACES)
    assert len(CELLS) >= 40
    tests = {name for name, _ in inspect.getmembers(test_runner, inspect.isfunction)}
    for id, (_, shown) in ELSEWHERE.items():
        assert shown in FAULTS or (shown in tests and id.lower() in shown)
    for drive in DRIVES.values():
        assert not BY_CODE[getattr(drive, "code", "C2")].inside


@pytest.mark.parametrize("id", DRIVES)
def test_it_trips(id: str) -> None:
    assert DRIVES[id].drive().startswith(f"{id} ")


@pytest.mark.parametrize("phase", ["P5", "P6"])
def test_a_car_that_nobody_saw_stop_is_cleared(phase: str) -> None:
    """Without mocap and wheels the filter goes astray; it begins again where the car stands."""
    rig = twin(at_phase(phase, False))
    for code in ("M1", "V4"):
        rig.run.world.add_fault(Fault(code, rig.t_ns, rig.t_ns + NS // 2))
    rig.reach(SupervisorState.FAULT_LATCHED, then_s=1.0)
    rig.ask(RequestKind.CLEAR)
    rig.reach(SupervisorState.READY)
