"""Every watchdog trips in a cell in which nothing but the outside world is changed."""

import inspect
from pathlib import Path

import pytest

from tests.safety.catalogue import BY_CODE
from tests.safety.live_faults import FAULTS
from tests.safety.outside import DRIVES, ELSEWHERE, write_outside
from tests.safety.trace import TRACES
from tests.unit.daemon.process import test_runner

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "safety.md"


def test_each_watchdog_has_one() -> None:
    traced = {id for id, trace in TRACES.items() if not BY_CODE[trace.cell[0]].inside}
    assert traced | set(DRIVES) | set(ELSEWHERE) == set(TRACES)
    tests = {name for name, _ in inspect.getmembers(test_runner, inspect.isfunction)}
    for id, (_, shown) in ELSEWHERE.items():
        assert shown in FAULTS or (shown in tests and id.lower() in shown)
    for drive in DRIVES.values():
        assert not BY_CODE[getattr(drive, "code", "C2")].inside


def test_the_page_lists_them() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert "\n".join(write_outside()) in text


@pytest.mark.parametrize("id", DRIVES)
def test_it_trips(id: str) -> None:
    assert DRIVES[id].drive().startswith(f"{id} ")
