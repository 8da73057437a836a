"""Every watchdog trips in a cell in which nothing but the outside world is changed."""

import inspect
import re
from pathlib import Path

import pytest

from steerd.daemon.assembly.build import NS
from steerd.daemon.loop.transitions import SupervisorState
from steerd.sim_hw.plant.faults import Fault
from steerd.steer_bus.messages import RequestKind
from tests.safety.catalogue import BY_CODE
from tests.safety.live_faults import CELLS, FAULTS
from tests.safety.outside import DRIVES, ELSEWHERE, list_outside
from tests.safety.rig import at_phase, twin
from tests.safety.trace import TRACES
from tests.unit.daemon.process import test_runner

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "safety-matrix.md"


def test_each_watchdog_has_one() -> None:
    traced = {id for id, trace in TRACES.items() if not BY_CODE[trace.cell[0]].inside}
    assert traced | set(DRIVES) | set(ELSEWHERE) == set(TRACES)
    assert len(CELLS) >= 40
    tests = {name for name, _ in inspect.getmembers(test_runner, inspect.isfunction)}
    for id, (_, shown) in ELSEWHERE.items():
        assert shown in FAULTS or (shown in tests and id.lower() in shown)
    for drive in DRIVES.values():
        assert not BY_CODE[getattr(drive, "code", "C2")].inside


def test_the_page_lists_them() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (W\d+) .*?\| (.*?) \|", text, re.M))
    assert all(changed in rows[id] for id, changed in list_outside().items())


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
