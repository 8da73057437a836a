"""Whether a stop slows the car: judged over lag and window, by each kind of stop (W24)."""

from math import nan

import pytest

from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.loop.watchdogs import WatchdogState, is_slowing, step_watchdogs
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.calm import CALM
from tests.unit.daemon.loop.watching import TH, S, up


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
    assert "W24" in found[6][0][0]
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
