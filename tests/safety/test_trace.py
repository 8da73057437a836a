"""Every watchdog of the safety page exists, trips in its cell, and its absence shows there."""

import re
from pathlib import Path

import pytest

from steerd.daemon.loop.findings import WATCHDOGS
from steerd.daemon.settings.thresholds import BOUNDS
from tests.safety.catalogue import BY_CODE
from tests.safety.trace import TRACES, find_code, run_trace, trips

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "safety-matrix.md"
REQUIREMENTS = Path(__file__).parents[2] / "docs" / "reference" / "safety-requirements.md"


def test_every_watchdog_is_traced_and_every_threshold_belongs_to_one() -> None:
    assert list(TRACES) == [f"W{k}" for k in range(1, len(TRACES) + 1)]
    assert set(TRACES) == {id for id in WATCHDOGS if id.startswith("W")}
    used = {name for trace in TRACES.values() for name in trace.thresholds}
    assert used == set(BOUNDS)
    for trace in TRACES.values():
        assert callable(find_code(trace.code))
        assert trace.cell[0] in BY_CODE


def test_every_required_watchdog_is_traced_under_its_name() -> None:
    text = REQUIREMENTS.read_text(encoding="utf-8")
    rows = re.findall(r'^\| <a id="(w\d+)"></a>(W\d+) ([^|]+?) \|', text, re.M)
    assert [id for _, id, _ in rows] == list(TRACES)
    assert [(anchor, name) for anchor, _, name in rows] == [
        (id.lower(), WATCHDOGS[id].name) for id in TRACES
    ]


def test_the_page_shows_every_trace() -> None:
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("<!-- trace: begin -->") : text.index("<!-- trace: end -->")]
    assert re.findall(r"^\| (W\d+) ", table, re.M) == list(TRACES)


@pytest.mark.slow
@pytest.mark.parametrize("id", TRACES)
def test_it_trips_in_its_cell_and_its_absence_shows(id: str) -> None:
    shown, without = run_trace(id)
    assert trips(id, shown), shown
    assert not shown.wrong or TRACES[id].behind, shown
    assert not trips(id, without)
    assert without.wrong or without.reasons != shown.reasons
