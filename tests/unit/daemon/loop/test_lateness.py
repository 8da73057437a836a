"""W15 over due and wake times: each rule at its edge, and what a car file may tighten."""

from dataclasses import replace

import pytest

from steerd.controller.limits import LimitError
from steerd.daemon.loop.findings import Severity
from steerd.daemon.loop.lateness import (
    IN_SIMULATION,
    ON_HARDWARE,
    WINDOW_NS,
    Lateness,
    LatenessRules,
    make_lateness_rules,
    step_lateness,
)
from steerd.daemon.settings.thresholds import Thresholds

MS, PERIOD = 1_000_000, 10_000_000


def run(late_ms, rules=ON_HARDWARE):
    """Findings of ticks so late, one period apart."""
    state, said = Lateness(), []
    for k, ms in enumerate(late_ms):
        state, found = step_lateness(state, k * PERIOD, k * PERIOD + round(ms * MS), PERIOD, rules)
        said.append(found and found.severity)
    return said, state


def test_in_time_nothing_is_said_and_a_missed_tick_is_a_warning():
    assert run([0, 10])[0] == [None, None]
    assert run([10.1])[0] == [Severity.WARN]


def test_the_rules_are_the_thresholds():
    assert make_lateness_rules(Thresholds()) == ON_HARDWARE == LatenessRules(25_000_000, 3, 0.02)
    assert make_lateness_rules(replace(Thresholds(), late=0.0125)).late_ns == 12_500_000


@pytest.mark.parametrize(
    ("late_ms", "expected"),
    [
        ([12.3], "12.3 ms"),
        ([31.4], "a tick 31 ms late"),
        ([1499.6], "a tick 1500 ms late"),
        ([12, 12, 12], "3 ticks in a row missed"),
        ([12, 0, 12, 0, 12], "3 of 100 ticks missed"),
    ],
)
def test_text_of_a_late_tick(late_ms, expected):
    state, found = Lateness(), None
    for k, ms in enumerate(late_ms):
        state, found = step_lateness(state, k * PERIOD, k * PERIOD + round(ms * MS), PERIOD)
    assert f": {expected}; " in found.text


def test_a_second_ends_after_a_second_and_the_next_begins_where_it_ended():
    begun = Lateness(missed=2, window_ns=WINDOW_NS)
    late = WINDOW_NS + 12 * MS
    same, found = step_lateness(begun, 2 * WINDOW_NS, WINDOW_NS + late, PERIOD)
    assert (same.missed, same.window_ns) == (3, WINDOW_NS)
    assert found.severity is Severity.HARD
    new, found = step_lateness(begun, 2 * WINDOW_NS + 1, WINDOW_NS + late + 1, PERIOD)
    assert (new.missed, new.window_ns) == (1, 2 * WINDOW_NS + 1)
    assert found.severity is Severity.WARN


def test_one_very_late_tick_trips_at_its_edge():
    assert run([25])[0] == [Severity.WARN]
    assert run([25.001])[0] == [Severity.HARD]


def test_three_missed_in_a_row_trip_and_two_do_not():
    assert run([12, 12, 0, 12])[0] == [Severity.WARN, Severity.WARN, None, Severity.HARD]
    assert run([12, 12, 12])[0][-1] is Severity.HARD
    assert run([12, 12, 0])[1].run == 0


def test_more_than_two_of_a_hundred_trip_and_the_next_second_begins_anew():
    assert run([12, 0, 12, 0])[0][2] is Severity.WARN
    assert run([12, 0, 12, 0, 12])[0][4] is Severity.HARD
    quiet = [12, 0, 12, *[0] * 98, 12]
    said, state = run(quiet)
    assert said[-1] is Severity.WARN
    assert (state.missed, state.total) == (1, 3)


@pytest.mark.parametrize(
    ("changes", "late_ms"),
    [({"late": 0.015}, [15.1]), ({"late_run": 2}, [12, 12]), ({"late_share": 0.0}, [12, 0, 12])],
)
def test_a_car_file_may_be_stricter(changes, late_ms):
    strict = make_lateness_rules(replace(Thresholds(), **changes))
    assert run(late_ms)[0][-1] is Severity.WARN
    assert run(late_ms, strict)[0][-1] is Severity.HARD


@pytest.mark.parametrize("changes", [{"late": 0.026}, {"late_run": 4}, {"late_share": 0.03}])
def test_and_never_laxer(changes):
    with pytest.raises(LimitError):
        Thresholds(**changes)


def test_a_simulated_car_lives_with_a_machine_that_hiccups():
    assert run([200, 0, 12, 12, 12], IN_SIMULATION)[0].count(Severity.HARD) == 0
    assert run([251], IN_SIMULATION)[0] == [Severity.HARD]
