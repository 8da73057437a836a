"""The fence (W19), whether a stop slows the car (W24), and what the VESC says (W9 to W12)."""

from dataclasses import replace
from math import nan, pi

import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import (
    COMMANDED_S,
    WatchdogState,
    is_inside,
    is_slowing,
    step_watchdogs,
)
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.watching import (
    CALM,
    HARD,
    KILL,
    TH,
    WARN,
    S,
    brief,
    down,
    hold,
    look,
    up,
)

SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
ELL = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0))


def test_inside_a_polygon():
    assert is_inside(SQUARE, 0.0, 0.0)
    assert is_inside(SQUARE, down(2.0), 0.0)
    assert not is_inside(SQUARE, 2.0, 0.0)
    assert not is_inside(SQUARE, up(2.0), 0.0)
    assert is_inside(ELL, 1.0, 3.0)
    assert is_inside(ELL, 3.0, 1.0)
    assert not is_inside(ELL, 3.0, 3.0)
    assert not is_inside(SQUARE, nan, 0.0)
    assert not is_inside(SQUARE, 0.0, nan)
    for turned in (SQUARE[::-1], SQUARE[2:] + SQUARE[:2]):
        assert is_inside(turned, 1.9, -1.9)
        assert not is_inside(turned, 1.9, -2.1)


def test_fence_counts_the_stopping_distance():
    th = replace(TH, fence=SQUARE)
    reach = 0.25 + 0.5 + 0.125  # v 2: 2*0.125 + 4/8 + margin
    for course, sign in ((0.0, 1.0), (pi, -1.0)):
        for speed in (2.0, -2.0):
            edge = 2.0 - reach
            changes = {"course": course, "speed": speed}
            assert brief(look(th, x=sign * (edge - 0.51), **changes)) == []
            assert brief(look(th, x=sign * (edge - 0.49), **changes)) == [("W19", WARN)]
            assert brief(look(th, x=sign * (edge - 0.001), **changes)) == [("W19", WARN)]
            assert brief(look(th, x=sign * (edge + 0.001), **changes)) == [("W19", HARD)]
    assert brief(look(th, y=2.0 - reach + 0.001, course=pi / 2, speed=2.0)) == [("W19", HARD)]
    assert brief(look(th, x=nan)) == [("W19", HARD)]
    (unknown,) = look(th, x=nan)
    assert unknown.text == "W19 fence: where the car is is not known"
    assert brief(look(th, x=1.0, speed=0.0, state=SupervisorState.DISARMED)) == []
    parked = look(th, x=2.0 - 0.125, speed=0.0, state=SupervisorState.DISARMED)
    assert brief(parked) == [("W19", HARD)]


def test_slanted_fences_and_diagonal_travel():
    kite = ((0.0, -2.0), (3.0, 1.0), (0.0, 2.0), (-1.0, 1.0))
    assert is_inside(kite, 1.0, 0.0)
    assert not is_inside(kite, 2.0, -0.5)
    assert is_inside(kite, 1.9, 0.0)
    assert not is_inside(kite, 2.1, 0.0)
    assert is_inside(kite, -0.3, 0.0)
    assert not is_inside(kite, -0.7, 0.0)
    th = replace(TH, fence=SQUARE)
    for course, x, y in ((0.6, 1.0, 0.0), (0.6 + pi, -1.0, 0.0), (0.9, 0.0, 1.0)):
        out = look(th, x=x, y=y, course=course, speed=2.0)  # needs 0.875 m: stays just inside
        assert brief(out) == [("W19", WARN)]
        out = look(th, x=1.5 * x, y=1.5 * y, course=course, speed=2.0)
        assert brief(out) == [("W19", HARD)]
    assert look(th, x=-1.0, course=0.6, speed=2.0) == ()


# Whether a stop slows the car: judged over lag and window, by each kind of stop (W24).


def stop(kind, speeds, dt=S // 16, wheels=0.0, telemetry_age=0.0):
    """Watch a stop; return per tick the W24 findings and whether it is slowing."""
    state, out = WatchdogState(), []
    for k, speed in enumerate(speeds):
        tick = changed(CALM, t_ns=S + k * dt, state=kind, speed=speed, speed_erpm=wheels)
        tick = changed(tick, telemetry_age=telemetry_age)
        state, found = step_watchdogs(TH, state, changed(tick, speed_mocap=0.0))
        words = [f.text for f in found if f.id == "W24"]
        out.append((words, is_slowing(state)))
    return out


KINDS = pytest.mark.parametrize(
    ("kind", "least"),
    [
        (SupervisorState.STOPPING, 0.75),
        (SupervisorState.FAULT_STOP, 2.0),
        (SupervisorState.ESTOP, 2.0),
    ],
)
"""The least deceleration [m/s^2] with which each stop works."""


def slowed(decel, ticks):
    return [2.0 - decel * max(0.0, k / 16 - 0.125) for k in range(ticks)]


@KINDS
def test_a_stop_that_works_has_no_findings(kind, least):
    assert all(words == [] and slowing for words, slowing in stop(kind, slowed(least, 12)))


@KINDS
def test_a_stop_that_is_too_weak_is_found_after_lag_and_window(kind, least):
    found = stop(kind, slowed(least - 0.01, 11))
    assert [slowing for _, slowing in found] == [True] * 6 + [False] * 5
    assert ": still " in found[6][0][0]
    assert " m/s, too little slower after 0.2 s; " in found[6][0][0]
    assert "CUT POWER:" not in found[9][0][0]
    assert "CUT POWER:" in found[10][0][0]


def test_a_stop_that_does_nothing_alarms_and_stays_found_even_if_it_starts_to_work():
    speeds = [2.0] * 11 + [2.0 - 0.25 * k for k in range(6)]
    found = stop(SupervisorState.FAULT_STOP, speeds)
    assert not any(slowing for _, slowing in found[6:])


def test_slow_or_unknown_speeds_are_not_judged():
    for speeds in ([0.125] * 12, [nan] * 12, [-0.125] * 12):
        assert all(words == [] for words, _ in stop(SupervisorState.FAULT_STOP, speeds))
    assert stop(SupervisorState.FAULT_STOP, [up(0.125)] * 12)[6][0]
    assert stop(SupervisorState.FAULT_STOP, [-1.0] * 12)[6][0]


def test_wheels_that_roll_on_count_while_their_telemetry_is_new():
    speeds, kind = slowed(2.0, 12), SupervisorState.FAULT_STOP
    for wheels in (2.0, -2.0):
        assert "still 2.00 m/s" in stop(kind, speeds, wheels=wheels)[6][0][0]
        assert stop(kind, speeds, wheels=wheels, telemetry_age=TH.telemetry)[6][0]
    for given in ({"wheels": 2.0, "telemetry_age": up(TH.telemetry)}, {"wheels": nan}):
        assert all(slowing for _, slowing in stop(kind, speeds, **given))
    assert all(words == [] for words, _ in stop(kind, [nan] * 12, wheels=2.0))


def test_each_kind_of_stop_is_judged_anew():
    def watch(memory, t_ns, state):
        return step_watchdogs(TH, memory, changed(CALM, t_ns=t_ns, state=state))

    memory = WatchdogState()
    for k in range(7):
        memory, _ = watch(memory, S + k * S // 16, SupervisorState.STOPPING)
    assert not is_slowing(memory)
    memory, found = watch(memory, 2 * S, SupervisorState.FAULT_STOP)
    assert (is_slowing(memory), found) == (True, ())
    assert watch(memory, 2 * S, SupervisorState.DISARMED)[0].stop is None


def test_nothing_is_weak_before_and_after_a_stop():
    assert is_slowing(WatchdogState())
    weak = WatchdogState(stop=SupervisorState.STOPPING, weak=3)
    assert is_slowing(step_watchdogs(TH, weak, CALM)[0])


# What the VESC says of itself: status bits, fault codes, its tachometer (W9 to W12).


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
    assert ": tachometer fell from 100 to 99; " in found[0].text
    assert after.tachometer == 99
    assert brief(look(memory=state, tachometer=0)) == [("W12", HARD)]


def test_only_their_own_status_bits_count():
    armed, _ = step_watchdogs(TH, WatchdogState(), CALM)
    assert brief(look(memory=armed, status=2)) == [("W10", KILL)]
    assert hold(1.0, status=2) == ([("W10", KILL)], [("W10", KILL)])
    assert COMMANDED_S == 0.2


def test_a_tachometer_of_zero_is_known():
    assert step_watchdogs(TH, WatchdogState(), changed(CALM, tachometer=0))[0].tachometer == 0
