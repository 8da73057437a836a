"""What the VESC says of itself: status bits, fault codes, its tachometer (W9 to W12)."""

import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import COMMANDED_S, WatchdogState, step_watchdogs
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.calm import CALM
from tests.unit.daemon.loop.watching import HARD, KILL, TH, brief, hold, look


@pytest.mark.parametrize(
    ("status", "fault", "expected"),
    [
        (2, 0, [("W10", KILL)]),
        (0, 1, [("W11", HARD)]),
        (0, 10, [("W12", HARD)]),
        (3, 9, [("W10", KILL), ("W11", HARD)]),
    ],
)
def test_vesc_status_and_fault_codes(status, fault, expected):
    assert brief(look(status=status, fault_code=fault)) == expected


def test_starved_at_once_after_commands_were_seen_to_arrive():
    state, _ = step_watchdogs(TH, WatchdogState(), changed(CALM, state=SupervisorState.ARMED))
    assert state.commanded
    still, found = step_watchdogs(TH, state, changed(CALM, state=SupervisorState.ARMED, status=1))
    assert (still.commanded, found) == (True, ())
    assert brief(look(memory=still, status=1)) == [("W9", HARD)]
    assert "while driving" in look(memory=still, status=1)[0].text


def test_timeout_bit_left_from_the_self_test_is_no_starvation():
    assert look(status=1) == ()
    quiet, _ = step_watchdogs(
        TH, WatchdogState(commanded=True), changed(CALM, state=SupervisorState.READY)
    )
    assert not quiet.commanded
    state, found = step_watchdogs(TH, quiet, changed(CALM, state=SupervisorState.ARMED, status=1))
    assert (state.commanded, found) == (False, ())
    stopping = changed(CALM, state=SupervisorState.STOPPING)
    assert step_watchdogs(TH, WatchdogState(), stopping)[0].commanded is False


def test_reboot_shows_in_the_tachometer():
    state, found = step_watchdogs(TH, WatchdogState(), changed(CALM, tachometer=100))
    assert (state.tachometer, found) == (100, ())
    state, found = step_watchdogs(TH, state, changed(CALM, tachometer=100))
    assert found == ()
    state, found = step_watchdogs(TH, state, CALM)  # unknown in this tick
    assert (state.tachometer, found) == (100, ())
    after, found = step_watchdogs(TH, state, changed(CALM, tachometer=99))
    assert brief(found) == [("W12", HARD)]
    assert after.tachometer == 99
    assert brief(look(memory=state, tachometer=0)) == [("W12", HARD)]


def test_only_their_own_status_bits_count():
    armed, _ = step_watchdogs(TH, WatchdogState(), CALM)
    assert brief(look(memory=armed, status=2)) == [("W10", KILL)]
    assert hold(1.0, status=2) == ([("W10", KILL)], [("W10", KILL)])
    assert COMMANDED_S == 0.2


def test_a_tachometer_of_zero_is_known():
    assert step_watchdogs(TH, WatchdogState(), changed(CALM, tachometer=0))[0].tachometer == 0
