"""Late ticks of a machine whose host took the processor are told from those of this program."""

import subprocess

import pytest

from steerd.daemon.loop.findings import STALLED, blame, make_finding
from steerd.daemon.process import rtcheck
from steerd.daemon.process.rtcheck import keep_busy
from steerd.daemon.process.stall import is_stalled, parse_steal, read_steal_ns

MS = 1_000_000
STAT = "cpu  10 0 5 900 1 0 0 42 0 0\ncpu0 10 0 5 900 1 0 0 42 0 0\n"


@pytest.mark.parametrize(
    ("text", "stolen_ns"),
    [
        (STAT, 420 * MS),
        ("cpu 1 2 3 4\n", 0),
        ("", 0),
        ("intr 1 2 3 4 5 6 7 8 9\n", 0),
        ("cpu 1 2 3 4 5 6 7 x 9\n", 0),
    ],
)
def test_stolen_time_of_all_processors(text, stolen_ns):
    assert parse_steal(text, 100) == stolen_ns


def test_this_machine_says_what_was_stolen():
    first = read_steal_ns()
    assert 0 <= first <= read_steal_ns()


@pytest.mark.parametrize(
    ("late_ms", "stolen_ms", "stalled"),
    [(40, 40, True), (40, 20, True), (40, 19, False), (40, 0, False), (0, 0, False)],
)
def test_the_machine_stalled_if_half_of_the_lateness_was_stolen(late_ms, stolen_ms, stalled):
    assert is_stalled(late_ms * MS, stolen_ms * MS) is stalled


def test_the_reason_names_the_machine_and_stops_as_before():
    late = make_finding("W15", "a tick 41 ms late")
    said = blame(late, STALLED)
    assert said.text.startswith(
        "W15 loop late: a tick 41 ms late; the host of this virtual machine"
    )
    assert "close other programs" not in said.text
    assert said.severity is late.severity


def test_a_machine_is_kept_busy_and_let_go(monkeypatch):
    started = []

    class Kept(subprocess.Popen):
        def __init__(self, *args, **options):
            super().__init__(*args, **options)
            started.append(self)

    monkeypatch.setattr(rtcheck.subprocess, "Popen", Kept)
    with keep_busy(2):
        assert [process.poll() for process in started] == [None, None]
    assert [process.poll() for process in started] == [-9, -9]
