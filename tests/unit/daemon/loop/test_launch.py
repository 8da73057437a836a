"""The launch window, and lateness (W15): each rule at its edge."""

from dataclasses import replace
from math import atan, cos, pi, sin, tan

import pytest

from steerd.controller.limits import LimitError
from steerd.daemon.loop import findings as fs
from steerd.daemon.loop.checks import LaunchInput, make_launch_state, step_launch
from steerd.daemon.loop.findings import ON_HARDWARE, WINDOW_NS, Lateness, Severity, step_lateness
from steerd.daemon.settings.thresholds import Thresholds

WHEELBASE = 0.33


def launch(steer=0.0, scale=1.0, flip=0.0, turn=1.0, erpm=1.0, speed=0.5, yaw0=0.3, noise=0.0):
    """Drive a kinematic car; return (what was wrong, distance by the wheels, done)."""
    x = y = travelled = 0.0
    yaw, dt = yaw0, 0.01
    start = LaunchInput(0, x * scale, y * scale, yaw + flip, 0.0, steer)
    state, wrong = make_launch_state(start), ""
    for k in range(1, 400):
        x, y = x + speed * dt * cos(yaw), y + speed * dt * sin(yaw)
        yaw += turn * speed * dt * tan(steer) / WHEELBASE
        wobble = noise if k % 2 else -noise
        i = LaunchInput(k * 10**7, x * scale + wobble, y * scale, yaw + flip, speed * erpm, steer)
        state, wrong = step_launch(state, i, WHEELBASE)
        travelled += abs(speed) * erpm * dt
        if wrong or state.done:
            break
    return wrong, travelled, state.done


@pytest.mark.parametrize("steer", [0.0, 0.34, -0.34, 0.05])
@pytest.mark.parametrize("yaw0", [0.0, 3.0, -3.1])
def test_a_good_launch_ends_after_half_a_metre(steer, yaw0):
    wrong, travelled, done = launch(steer=steer, yaw0=yaw0, noise=0.002)
    assert (wrong, done) == ("", True)
    assert travelled == pytest.approx(0.5, abs=0.006)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        *(({"scale": scale}, "units") for scale in (0.001, 1000.0, 0.0, 0.69, 1.42)),
        ({"erpm": 0.0}, "units"),  # wheels that do not count
        *(({"flip": flip}, "body forward axis") for flip in (pi, pi / 2, -0.55, 0.55)),
        ({"flip": 0.5}, ""), ({"flip": -0.5}, ""),
        *(({"steer": steer, "turn": -1.0}, "against its steering") for steer in (0.2, -0.2)),
        # A reversing car is judged in its own direction.
        ({"speed": -0.5}, ""), ({"speed": -0.5, "flip": pi}, "body forward axis"),
    ],
)  # fmt: skip
def test_a_launch_finds_what_is_wrong_and_is_done_otherwise(given, said):
    wrong, travelled, done = launch(**given)
    assert said in wrong
    assert (wrong == "") is (said == "") is done
    assert travelled <= 0.26 or said != "units"


def test_time_does_not_run_backwards():
    start = LaunchInput(0, 0.0, 0.0, 0.0, 0.5, 0.0)
    back, wrong = step_launch(make_launch_state(start), start._replace(t_ns=-(10**9)), WHEELBASE)
    assert (back.travelled, wrong) == (0.0, "")


def shown(mocap, wheels, turned=0.0, expected=0.0):
    """What one more, motionless tick says to a launch that has shown this, far from the origin."""
    here = LaunchInput(0, 5.0 + mocap, -3.0, 0.0, 0.0, 0.0)
    state = make_launch_state(here)._replace(
        x0=5.0, travelled=wheels, turned=turned, expected_turn=expected, forward=mocap
    )
    return step_launch(state, here, WHEELBASE)


def test_every_bound_of_the_launch_exactly():
    assert shown(0.0, 0.2499)[1] == shown(0.2499, 0.0)[1] == ""
    for distances in ((0.0, 0.25), (0.25, 0.0)):
        assert "units" in shown(*distances)[1]
    assert shown(0.5, 0.5) == (shown(0.5, 0.5)[0]._replace(done=True), "")
    assert not shown(0.5, 0.4999)[0].done
    assert "against" in shown(0.5, 0.5, turned=-0.03, expected=0.10)[1]
    for turned, expected in ((-0.0299, 0.10), (-0.03, 0.0999), (0.03, 0.10)):
        assert shown(0.5, 0.5, turned, expected)[1] == ""


def end_of(x=0.25, y=0.0, wheels=0.25, yaw=0.0, steer=0.0, wheelbase=1.0):
    """One long step from the origin, heading along x: the state after it, and what was wrong."""
    start = LaunchInput(0, *(0.0,) * 5)
    step = LaunchInput(1_000_000_000, x, y, yaw, wheels, steer)
    return step_launch(make_launch_state(start), step, wheelbase)


def test_the_ratio_of_distances_to_its_last_digit():
    wrong = ["units" in end_of(x=x, wheels=1.0)[1] for x in (0.6999, 0.7, 1.4, 1.4001)]
    assert wrong == [True, False, False, True]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_thirty_degrees_off_the_heading(side):
    inside, beyond = (
        end_of(x=0.5 * cos(angle), y=side * 0.5 * sin(angle), wheels=0.5)[1]
        for angle in (pi / 6 - 1e-9, pi / 6 + 1e-9)
    )
    assert "body forward axis" not in inside
    assert f"travels {side * 30:.0f}° off its mocap heading: body forward axis" in beyond


def test_a_launch_that_went_wrong_is_not_done_and_a_done_one_is_left_alone():
    state, wrong = end_of(x=2.0, wheels=1.0)
    assert wrong
    assert not state.done
    done = end_of(x=0.5, wheels=0.5)[0]
    after = LaunchInput(2_000_000_000, 99.0, 0.0, 3.0, 0.0, 0.0)
    assert step_launch(done, after, 1.0) == (done, "")


def test_what_is_said_is_said_to_the_letter():
    units = end_of(x=2.0, wheels=1.0)[1]
    assert units == "mocap moved 2.00 m, wheels 1.00 m: units, body or gear ratio"
    turned = end_of(y=0.5, x=0.0, wheels=0.5)[1]
    assert turned == "the car travels 90° off its mocap heading: body forward axis"
    against = end_of(x=0.5, wheels=0.5, yaw=-0.1, steer=atan(0.5))[1]
    assert against == "the car turns against its steering: servo direction, or mocap handedness"


# W15 over due and wake times: each rule at its edge, and what a car file may tighten.

MS, PERIOD = 1_000_000, 10_000_000


def run(late_ms, rules=ON_HARDWARE):
    """Findings of ticks so late, one period apart."""
    state, said = Lateness(), []
    for k, ms in enumerate(late_ms):
        state, found = step_lateness(state, k * PERIOD, k * PERIOD + round(ms * MS), PERIOD, rules)
        said.append(found and found.severity)
    return said, state


def test_the_rules_are_the_thresholds():
    usual = fs.LatenessRules(25_000_000, 3, 0.02)
    assert fs.make_lateness_rules(Thresholds()) == ON_HARDWARE == usual
    assert fs.make_lateness_rules(replace(Thresholds(), late=0.0125)).late_ns == 12_500_000


@pytest.mark.parametrize(
    ("late_ms", "severity", "expected"),
    [
        ([10.1], Severity.WARN, "10.1 ms"), ([25], Severity.WARN, "25.0 ms"),
        ([25.001], Severity.HARD, "a tick 25 ms late"),
        ([1499.6], Severity.HARD, "a tick 1500 ms late"),
        ([12, 12, 12], Severity.HARD, "3 ticks in a row missed"),
        ([12, 0, 12, 0, 12], Severity.HARD, "3 of 100 ticks missed"),
    ],
)  # fmt: skip
def test_a_late_tick_warns_or_trips_and_says_why(late_ms, severity, expected):
    said, state = run(late_ms[:-1])
    assert Severity.HARD not in said
    due = len(said) * PERIOD
    _, found = step_lateness(state, due, due + round(late_ms[-1] * MS), PERIOD)
    assert found.severity is severity
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


def test_a_row_of_missed_ticks_ends_and_the_next_second_begins_anew():
    assert run([0, 10])[0] == [None, None], "in time"
    assert run([12, 12, 0, 12])[0] == [Severity.WARN, Severity.WARN, None, Severity.HARD]
    assert run([12, 12, 0])[1].run == 0
    said, state = run([12, 0, 12, *[0] * 98, 12])
    assert (said[-1], state.missed) == (Severity.WARN, 1)


@pytest.mark.parametrize(
    ("name", "stricter", "late_ms", "laxer"),
    [("late", 0.015, [15.1], 0.026), ("late_run", 2, [12, 12], 4),
     ("late_share", 0.0, [12, 0, 12], 0.03)],
)  # fmt: skip
def test_a_car_file_may_be_stricter_and_never_laxer(name, stricter, late_ms, laxer):
    strict = fs.make_lateness_rules(replace(Thresholds(), **{name: stricter}))
    assert run(late_ms)[0][-1] is Severity.WARN
    assert run(late_ms, strict)[0][-1] is Severity.HARD
    with pytest.raises(LimitError):
        Thresholds(**{name: laxer})


def test_a_simulated_car_lives_with_a_machine_that_hiccups():
    assert run([200, 0, 12, 12, 12], fs.IN_SIMULATION)[0].count(Severity.HARD) == 0
    assert run([251], fs.IN_SIMULATION)[0] == [Severity.HARD]
