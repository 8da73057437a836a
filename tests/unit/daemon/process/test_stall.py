"""Who made a tick late is told from the guardian's pause: machine, host, or this program alone."""

import pytest

from steerd.daemon.loop.findings import make_finding
from steerd.daemon.loop.flags import CAUSES, Flag, blame_late
from steerd.daemon.process.guardian import PERIOD_NS
from steerd.daemon.process.stall import LEAST_NS, find_cause

MS = 1_000_000
START = 10**12


def cause_of(late_ms, pause_ms, stolen_ms=0):
    """The flag of a tick late from 0 to `late_ms`, with the guardian's pause from and to."""
    pause = pause_ms and tuple(START + round(t * MS) for t in pause_ms)
    return find_cause((START, START + late_ms * MS), stolen_ms * MS, pause)


@pytest.mark.parametrize("slept_ms", [0, 3, 9.9])
@pytest.mark.parametrize("due_ms", [0, 5, 9.9])
@pytest.mark.parametrize("stall_ms", [31, 40, 60, 200])
def test_a_stall_of_everything_is_the_machines(stall_ms, due_ms, slept_ms):
    """The stall begins `due_ms` before the core's tick, `slept_ms` after the guardian's beat."""
    late = round(stall_ms - due_ms)
    begin = -due_ms - slept_ms
    assert cause_of(late, (begin, stall_ms - due_ms + 1)) == Flag.ALL_LATE


@pytest.mark.parametrize("pause", [(-900, -850), (-40, 0), (60, 90)])
def test_a_pause_at_another_time_leaves_this_program_alone(pause):
    assert cause_of(41, pause) == Flag.ALONE_LATE


def test_a_guardian_that_never_paused_leaves_this_program_alone():
    assert find_cause((START, START + 41 * MS), 0, (0, 0)) == Flag.ALONE_LATE


def test_what_nobody_saw_or_saw_by_half_is_not_told():
    assert cause_of(41, None) == 0
    assert cause_of(100, (-10, 30)) == 0, "the guardian ran for most of it"
    assert cause_of(100, (90, 120)) == 0
    assert cause_of(0, (-5, 5)) == 0


def test_of_a_short_delay_the_guardian_is_no_witness():
    just = LEAST_NS // MS
    assert cause_of(just - 1, (0, 0)) == 0
    assert cause_of(just - 1, (-9, just)) == 0
    assert find_cause((START, START + LEAST_NS), 0, (0, 0)) == Flag.ALONE_LATE
    own_sleep = (START, START + PERIOD_NS + 9 * MS)
    assert find_cause((START, START + LEAST_NS), 0, own_sleep) == 0, "mostly its own sleep"


def test_stolen_time_says_more_than_the_guardian():
    assert cause_of(40, (-5, 45), stolen_ms=40) == Flag.STALLED
    assert cause_of(40, (0, 0), stolen_ms=20) == Flag.STALLED
    assert cause_of(40, (-5, 45), stolen_ms=19) == Flag.ALL_LATE


def test_each_cause_has_its_own_sentence_and_stops_as_before():
    late = make_finding("W15", "a tick 41 ms late")
    said = [blame_late(late, flag) for flag in (Flag.STALLED, Flag.ALL_LATE, Flag.ALONE_LATE, 0)]
    assert len({finding.text for finding in said}) == 4
    assert all(finding.text.startswith("W15 loop late: a tick 41 ms late; ") for finding in said)
    assert all(finding.severity is late.severity for finding in said)
    assert said[3] == late
    assert "close other programs" in said[2].text
    assert "close other programs" not in said[0].text + said[1].text
    assert blame_late(late, ~CAUSES) == late
