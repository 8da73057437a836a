"""Findings: their summary, advice, numbers that nobody knows; and late ticks (W15)."""

from dataclasses import asdict, replace
from math import inf, nan

import pytest

from steerd.controller.limits import LimitError
from steerd.daemon.loop import findings as fs
from steerd.daemon.loop.findings import WATCHDOGS, Severity, make_finding, summarise
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.settings.thresholds import Thresholds
from tests.unit.daemon.loop.watching import CALM, after, look

SQUARE = ((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (-5.0, 5.0))


def test_summary_takes_the_worst_text_and_all_bits():
    warn = make_finding("W7", "60 ms", Severity.WARN)
    soft, kill = make_finding("W13", "3.2 V"), make_finding("W10", "pressed")
    assert summarise(()) == (0, "")
    assert summarise((warn,)) == (0, "")
    assert summarise((warn, soft)) == (Fact.SOFT, soft.text)
    assert summarise((soft, kill, soft)) == (Fact.SOFT | Fact.KILLED, kill.text)


def test_every_watchdog_trips_with_advice():
    assert all(row.advice and row.severity > Severity.WARN for row in WATCHDOGS.values())
    with pytest.raises(KeyError):
        make_finding("W99", "")


@pytest.mark.parametrize(("name", "id", "text"), [
    ("mocap_age", "W1", "no good frame yet"), ("telemetry_age", "W7", "no reply yet"),
    ("sigma_position", "W6", "no estimate yet"), ("sigma_yaw", "W6", "no estimate yet"),
    ("fet_temperature", "W14", "the transistors' temperature is not known yet"),
    ("lateral_error", "W17", "no lane error"), ("heading_error", "W18", "no heading error"),
    ("lease_age", "W25", "no operator yet"),
])  # fmt: skip
@pytest.mark.parametrize("value", [inf, nan])
def test_a_number_that_is_not_known_trips_and_is_not_shown(name, id, text, value):
    (found,) = look(Thresholds(), **{name: value})
    assert found.text == f"{id} {WATCHDOGS[id].name}: {text}", "no advice about what nobody knows"
    assert found.severity is WATCHDOGS[id].severity
    assert not found.known


def test_no_text_ever_shows_a_number_that_is_none():
    numbers = [name for name, value in asdict(CALM).items() if isinstance(value, float)]
    fence = Thresholds(fence=SQUARE)
    for state in SupervisorState:
        for value in (nan, inf, -inf):
            for names in (numbers, *([name] for name in numbers)):
                found = after(2.0, fence, state=state, **dict.fromkeys(names, value))
                texts = [finding.text for finding in found]
                assert not [text for text in texts if "nan" in text or "inf " in text], names


def test_advice_in_simulation_is_about_the_simulation():
    found = make_finding("W7", "no reply for 120 ms")
    simulated = fs.advise_simulation(found)
    assert "USB" not in simulated.text
    assert simulated.text.startswith("W7 telemetry stale: no reply for 120 ms; a simulated VESC")
    assert simulated.severity is found.severity
    for other in (make_finding("W13", "3.10 V per cell"), fs.make_unknown("W7", "no reply yet")):
        assert fs.advise_simulation(other) is other


# W15 over due and wake times: each rule at its edge, and what a car file may tighten.
MS, PERIOD = 1_000_000, 10_000_000


def run(late_ms, rules=fs.ON_HARDWARE):
    """Findings of ticks so late, one period apart."""
    state, said = fs.Lateness(), []
    for k, ms in enumerate(late_ms):
        state, found = fs.step_lateness(
            state, k * PERIOD, k * PERIOD + round(ms * MS), PERIOD, rules
        )
        said.append(found and found.severity)
    return said, state


def test_the_rules_are_the_thresholds():
    usual = fs.LatenessRules(25_000_000, 3, 0.02)
    assert fs.make_lateness_rules(Thresholds()) == fs.ON_HARDWARE == usual
    assert fs.make_lateness_rules(replace(Thresholds(), late=0.0125)).late_ns == 12_500_000


@pytest.mark.parametrize(("late_ms", "severity", "expected"), [
    ([10.1], Severity.WARN, "10.1 ms"), ([25], Severity.WARN, "25.0 ms"),
    ([25.001], Severity.HARD, "a tick 25 ms late"),
    ([1499.6], Severity.HARD, "a tick 1500 ms late"),
    ([12, 12, 12], Severity.HARD, "3 ticks in a row missed"),
    ([12, 0, 12, 0, 12], Severity.HARD, "3 of 100 ticks missed"),
])  # fmt: skip
def test_a_late_tick_warns_or_trips_and_says_why(late_ms, severity, expected):
    said, state = run(late_ms[:-1])
    assert Severity.HARD not in said
    due = len(said) * PERIOD
    _, found = fs.step_lateness(state, due, due + round(late_ms[-1] * MS), PERIOD)
    assert found.severity is severity
    assert f": {expected}; " in found.text


def test_a_second_ends_after_a_second_and_the_next_begins_where_it_ended():
    begun = fs.Lateness(missed=2, window_ns=fs.WINDOW_NS)
    late = fs.WINDOW_NS + 12 * MS
    same, found = fs.step_lateness(begun, 2 * fs.WINDOW_NS, fs.WINDOW_NS + late, PERIOD)
    assert (same.missed, same.window_ns) == (3, fs.WINDOW_NS)
    assert found.severity is Severity.HARD
    new, found = fs.step_lateness(begun, 2 * fs.WINDOW_NS + 1, fs.WINDOW_NS + late + 1, PERIOD)
    assert (new.missed, new.window_ns) == (1, 2 * fs.WINDOW_NS + 1)
    assert found.severity is Severity.WARN


def test_a_row_of_missed_ticks_ends_and_the_next_second_begins_anew():
    assert run([0, 10])[0] == [None, None], "in time"
    assert run([12, 12, 0, 12])[0] == [Severity.WARN, Severity.WARN, None, Severity.HARD]
    assert run([12, 12, 0])[1].run == 0
    said, state = run([12, 0, 12, *[0] * 98, 12])
    assert (said[-1], state.missed) == (Severity.WARN, 1)


@pytest.mark.parametrize(("name", "stricter", "late_ms", "laxer"), [
    ("late", 0.015, [15.1], 0.026), ("late_run", 2, [12, 12], 4),
    ("late_share", 0.0, [12, 0, 12], 0.03),
])  # fmt: skip
def test_a_car_file_may_be_stricter_and_never_laxer(name, stricter, late_ms, laxer):
    strict = fs.make_lateness_rules(replace(Thresholds(), **{name: stricter}))
    assert run(late_ms)[0][-1] is Severity.WARN
    assert run(late_ms, strict)[0][-1] is Severity.HARD
    with pytest.raises(LimitError):
        Thresholds(**{name: laxer})


def test_a_simulated_car_lives_with_a_machine_that_hiccups():
    assert run([200, 0, 12, 12, 12], fs.IN_SIMULATION)[0].count(Severity.HARD) == 0
    assert run([251], fs.IN_SIMULATION)[0] == [Severity.HARD]
