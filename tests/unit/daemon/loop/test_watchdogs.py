"""Each watchdog exactly at its boundary, with numbers that floats represent exactly."""

from dataclasses import replace
from math import cos, inf, nan, nextafter, pi

import pytest

from steerd.daemon.loop.findings import WATCHDOGS, Severity, make_finding, summarise
from steerd.daemon.loop.follow_model import Band
from steerd.daemon.loop.following import Followed
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.loop.watchdogs import (
    COMMANDED_S,
    WatchdogState,
    is_inside,
    is_slowing,
    mocap_timeout,
    step_watchdogs,
)
from steerd.daemon.loop.watchdogs_pose import PoseWatch
from steerd.daemon.settings.thresholds import Thresholds
from tests.unit.daemon.loop.calm import CALM

# Binary fractions, so that "exactly at the threshold" is exact.
TH = Thresholds(
    mocap_warn=0.03125, mocap_blind=0.25, mocap_shortest=0.046875, mocap_longest=0.125,
    sigma_position=0.125, sigma_yaw=0.125, telemetry_warn=0.0625, telemetry=0.09375,
    cell_warn=3.5, cell=3.25, cell_hold=0.5, fet_warn=75.0, fet=85.0, motor_warn=80.0, motor=95.0,
    lateral_warn=0.1875, lateral=0.3125, lateral_hold=0.125, lateral_max=0.5,
    heading_warn=0.5, heading=0.75, fence_warn=0.5, fence_delay=0.125, fence_margin=0.125,
    overspeed_ratio=1.125, overspeed_margin=0.125, overspeed_hold=0.0625,
    mismatch_speed=0.5, mismatch_share=0.25, mismatch_hold=0.1875,
    blocked_current=0.5, blocked_speed=0.0625, blocked_hold=1.0,
    saturated=0.984375, saturated_warn=0.5, saturated_hold=1.0,
    brake_decel=4.0, stop_share=0.5, stop_lag=0.125, stop_window=0.25, stop_speed=0.125,
    lease_warn=0.125, lease=0.25, follow_hold=0.0625, follow_distance=0.125,
)  # fmt: skip
S = 10**9
WARN, SOFT, HARD, KILL = Severity


def up(value):
    return nextafter(value, inf)


def down(value):
    return nextafter(value, -inf)


def look(th=TH, memory=None, **changes):
    return step_watchdogs(th, memory or WatchdogState(), CALM._replace(**changes))[1]


def brief(findings):
    return [(f.id, f.severity) for f in findings]


def hold(seconds, th=TH, **changes):
    """Findings of the first and of the last of two ticks so many seconds apart."""
    memory, first = step_watchdogs(th, WatchdogState(), CALM._replace(**changes))
    end = CALM.t_ns + round(seconds * S)
    return brief(first), brief(look(th, memory, **{**changes, "t_ns": end}))


def test_calm_driving_has_no_findings():
    assert look() == ()
    assert look(Thresholds()) == ()


INSTANT = [
    # what changes, to what at the threshold, first value beyond it, id, severity
    ({"speed": 0.0}, "mocap_age", 0.03125, up(0.03125), "W1", WARN),
    ({"telemetry_age": 0.0}, "telemetry_age", 0.0625, up(0.0625), "W7", WARN),
    ({}, "sigma_position", 0.125, up(0.125), "W6", HARD),
    ({}, "sigma_yaw", 0.125, up(0.125), "W6", HARD),
    ({}, "cell_voltage", 3.5, down(3.5), "W13", WARN),
    ({}, "fet_temperature", 75.0, up(75.0), "W14", WARN),
    ({}, "motor_temperature", 80.0, up(80.0), "W14", WARN),
    ({}, "lateral_error", 0.1875, up(0.1875), "W17", WARN),
    ({}, "lateral_error", -0.1875, down(-0.1875), "W17", WARN),
    ({}, "heading_error", 0.5, up(0.5), "W18", WARN),
    ({}, "heading_error", -0.5, down(-0.5), "W18", WARN),
    ({}, "lease_age", 0.125, up(0.125), "W25", WARN),
]


@pytest.mark.parametrize(("base", "name", "edge", "beyond", "id", "severity"), INSTANT)
def test_first_threshold(base, name, edge, beyond, id, severity):
    assert brief(look(**{**base, name: edge})) == []
    assert brief(look(**{**base, name: beyond})) == [(id, severity)]


TRIPS = [
    ("telemetry_age", 0.09375, up(0.09375), "W7", HARD),
    ("fet_temperature", 85.0, up(85.0), "W14", SOFT),
    ("motor_temperature", 95.0, up(95.0), "W14", SOFT),
    ("lateral_error", 0.5, up(0.5), "W17", HARD),
    ("heading_error", -0.75, down(-0.75), "W18", HARD),
    ("lease_age", 0.25, up(0.25), "W25", SOFT),
]


@pytest.mark.parametrize(("name", "edge", "beyond", "id", "severity"), TRIPS)
def test_warning_becomes_a_trip(name, edge, beyond, id, severity):
    assert brief(look(**{name: edge})) == [(id, WARN)]
    assert brief(look(**{name: beyond})) == [(id, severity)]


@pytest.mark.parametrize(
    ("name", "id"),
    [
        ("mocap_age", "W1"),
        ("telemetry_age", "W7"),
        ("lease_age", "W25"),
        ("sigma_position", "W6"),
        ("sigma_yaw", "W6"),
        ("fet_temperature", "W14"),
        ("lateral_error", "W17"),
        ("heading_error", "W18"),
    ],
)
def test_nan_trips_at_once(name, id):
    severity = WATCHDOGS[id].severity
    assert brief(look(**{name: nan})) == [(id, severity)]


def test_no_motor_sensor_is_allowed():
    assert look(motor_temperature=nan) == ()


def test_mocap_is_never_blind_for_more_than_its_distance():
    assert mocap_timeout(TH, 0.0) == 0.125
    assert mocap_timeout(TH, 2.0) == 0.125
    assert mocap_timeout(TH, -4.0) == 0.0625
    assert mocap_timeout(TH, 5.0) == 0.05
    assert mocap_timeout(TH, 8.0) == 0.046875
    assert mocap_timeout(TH, nan) == 0.046875
    for speed in (k / 16 for k in range(97)):
        assert mocap_timeout(Thresholds(), speed) * speed <= 0.30 * (1 + 1e-12)


@pytest.mark.parametrize(("speed", "erpm"), [(4.0, 0.0), (0.0, 4.0), (0.0, -4.0), (-4.0, 1.0)])
def test_mocap_age_is_judged_at_the_faster_speed(speed, erpm):
    changes = {"speed": speed, "speed_erpm": erpm, "state": SupervisorState.ARMED}
    assert brief(look(mocap_age=0.0625, **changes)) == [("W1", WARN)]
    assert brief(look(mocap_age=up(0.0625), **changes)) == [("W1", HARD)]


def test_a_50_ms_gap_and_single_losses_do_not_trip():
    for speed in (0.0, 1.0, 3.0, 4.0):
        found = look(Thresholds(), mocap_age=0.060, speed=speed, speed_erpm=speed)
        assert ("W1", HARD) not in brief(found)


@pytest.mark.parametrize(
    ("pose", "expected"),
    [
        (PoseWatch(frozen=2), []),
        (PoseWatch(frozen=3), [("W2", WARN)]),
        (PoseWatch(frozen=4), [("W2", WARN)]),
        (PoseWatch(frozen=5), [("W2", HARD)]),
        (PoseWatch(invalid=1), [("W3", WARN)]),
        (PoseWatch(invalid=4), [("W3", WARN)]),
        (PoseWatch(invalid=5), [("W3", HARD)]),
        (PoseWatch(jumps=1), [("W4", WARN)]),
        (PoseWatch(jumps=2), [("W4", WARN)]),
        (PoseWatch(jumps=3), [("W4", HARD)]),
        (PoseWatch(jump_times=(0, 1, 2, 3, 4)), [("W4", HARD)]),
        (PoseWatch(jump_times=(-1, 1, 2, 3, 4)), []),
        (PoseWatch(jump_times=(1, 2, 3, 4)), []),
        (PoseWatch(rejections=0b1), [("W5", WARN)]),
        (PoseWatch(rejections=0b1111, rejected=4), [("W5", WARN)]),
        (PoseWatch(rejections=0b11111, rejected=5), [("W5", HARD)]),
        (PoseWatch(rejections=int("10" * 15, 2)), [("W5", WARN)]),  # 15 of 50: 30 %
        (PoseWatch(rejections=int("10" * 16, 2)), [("W5", HARD)]),
    ],
)
def test_frame_watchdogs(pose, expected):
    assert brief(look(pose=pose)) == expected


def test_covariance_that_is_not_valid():
    found = look(covariance_ok=False)
    assert brief(found) == [("W6", HARD)]
    assert "positive definite" in found[0].text


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


TINY = 5e-324
FAST = {"speed_erpm": 4.0, "speed_mocap": 4.0, "speed_limit": 6.0}
STUCK = {"current_share": up(0.5), "speed_erpm": 0.0, "speed_mocap": 0.0, "speed": 2.0}
"""The wheels stand and the motor pushes, whatever the filter believes."""
HELD = [
    ("W9", COMMANDED_S, {"status": 1}, HARD, []),
    ("W13", 0.5, {"cell_voltage": down(3.25)}, SOFT, [("W13", WARN)]),
    ("W13", 0.5, {"cell_voltage": nan}, SOFT, []),
    ("W17", 0.125, {"lateral_error": up(0.3125)}, HARD, [("W17", WARN)]),
    ("W17", 0.125, {"lateral_error": down(-0.3125)}, HARD, [("W17", WARN)]),
    ("W20", 0.0625, {"speed_erpm": up(2.25)}, HARD, []),
    ("W20", 0.0625, {"speed_mocap": -up(2.25), "speed_erpm": -2.25}, HARD, []),
    ("W20", 0.0625, {"speed_mocap": up(0.625), "speed_erpm": 0.5, "speed_limit": 0.5}, HARD, []),
    ("W21", 0.1875, {"speed_erpm": 1.0, "speed_mocap": up(1.5)}, HARD, []),
    ("W21", 0.1875, {"speed_erpm": 3.0, "speed_mocap": up(4.0), "speed_limit": 6.0}, HARD, []),
    ("W22", 1.0, {**STUCK, "speed_erpm": down(0.0625)}, HARD, []),
    ("W30", 0.0625, {"followed": Followed(speed_excess=TINY)}, HARD, []),
    ("W30", 0.0625, {"followed": Followed(speed_excess=nan)}, HARD, []),
    ("W30", 0.03125, {**FAST, "followed": Followed(speed_excess=TINY)}, HARD, []),
    ("W31", 0.03125, {"followed": Followed(turn_excess=TINY)}, HARD, []),
    ("W31", 0.03125, {"followed": Followed(turn_excess=nan)}, HARD, []),
    ("W31", 0.015625, {**FAST, "followed": Followed(turn_excess=TINY)}, HARD, []),
    ("W22", 1.0, {**STUCK, "speed_erpm": -down(0.0625)}, HARD, []),
]
NOT_HELD = [
    {"cell_voltage": 3.25},
    {"lateral_error": 0.3125},
    {"speed_erpm": 2.25, "speed_mocap": 2.25},
    {"speed_mocap": 0.625, "speed_erpm": 0.5, "speed_limit": 0.5},
    {"speed_erpm": 1.0, "speed_mocap": 1.5},
    {"speed_erpm": 3.0, "speed_mocap": 4.0, "speed_limit": 6.0},
    {**STUCK, "current_share": 0.5},
    {**STUCK, "speed_erpm": 0.0625},
    {**STUCK, "state": SupervisorState.ARMED},
    {"followed": Followed(speed_excess=0.0, turn_excess=0.0)},
    {"state": SupervisorState.ARMED, "followed": Followed(speed_excess=1.0, turn_excess=1.0)},
]


@pytest.mark.parametrize("state", [SupervisorState.RUNNING, SupervisorState.STOPPING])
def test_a_car_that_does_not_do_as_ordered_is_told_by_its_numbers(state):
    followed = Followed(2.5, Band(0.75, 1.25), 1.125, -0.5, Band(0.125, 0.25), 0.5)
    memory, _ = step_watchdogs(TH, WatchdogState(), CALM._replace(followed=followed, state=state))
    found = look(TH, memory, followed=followed, state=state, t_ns=CALM.t_ns + S // 16)
    speed, turn = (f.text for f in found if f.id in ("W30", "W31"))
    assert speed.startswith("W30 speed not followed: wheels 2.50 m/s, orders allow 0.75 to 1.25; ")
    assert turn.startswith(
        "W31 steering not followed: turns at -0.50 rad/s, orders allow 0.12 to 0.25; "
    )


def test_wheels_of_unknown_speed_count_as_blocked():
    first, last = hold(1.0, **{**STUCK, "speed_erpm": nan})
    assert first == []
    assert ("W22", HARD) in last


@pytest.mark.parametrize(("id", "seconds", "changes", "severity", "warned"), HELD)
def test_held_conditions_trip_after_their_time_and_not_before(
    id, seconds, changes, severity, warned
):
    assert hold(seconds - 1e-9, **changes) == (warned, warned)
    assert hold(seconds, **changes) == (warned, [*warned, (id, severity)])


@pytest.mark.parametrize("changes", NOT_HELD)
def test_held_conditions_at_their_edge_never_trip(changes):
    assert all(severity == WARN for _, severity in hold(100.0, **changes)[1])


def test_nan_speeds_count_as_overspeed_and_mismatch():
    for name in ("speed_erpm", "speed_mocap"):
        assert hold(0.5, **{name: nan})[1] == [("W20", HARD), ("W21", HARD)]


def test_an_interruption_starts_the_time_again():
    bad = CALM._replace(lateral_error=0.4)
    state, _ = step_watchdogs(TH, WatchdogState(), bad)
    state, _ = step_watchdogs(TH, state, CALM._replace(t_ns=S + S // 16))
    state, found = step_watchdogs(TH, state, bad._replace(t_ns=S + S // 8))
    assert brief(found) == [("W17", WARN)]
    state, found = step_watchdogs(TH, state, bad._replace(t_ns=S + S // 4 - 1))
    assert brief(found) == [("W17", WARN)]
    _, found = step_watchdogs(TH, state, bad._replace(t_ns=S + S // 4))
    assert brief(found) == [("W17", WARN), ("W17", HARD)]


@pytest.mark.parametrize(
    "state",
    [s for s in SupervisorState if s not in (SupervisorState.RUNNING, SupervisorState.STOPPING)],
)
def test_driving_watchdogs_are_silent_while_the_car_is_parked(state):
    changes = {
        "state": state, "lateral_error": 9.0, "heading_error": 3.0, "speed_erpm": 9.0,
        "speed": 0.0, "current_share": 1.0, "steer_share": 1.0,
    }  # fmt: skip
    assert hold(0.24, **changes) == ([], [])


@pytest.mark.parametrize("state", SupervisorState)
def test_lease_matters_while_armed_or_driving(state):
    matters = state in (SupervisorState.ARMED, SupervisorState.RUNNING, SupervisorState.STOPPING)
    assert brief(look(state=state, lease_age=inf)) == ([("W25", SOFT)] if matters else [])


def test_starved_at_once_after_commands_were_seen_to_arrive():
    state, _ = step_watchdogs(TH, WatchdogState(), CALM._replace(state=SupervisorState.ARMED))
    assert state.commanded
    still, found = step_watchdogs(TH, state, CALM._replace(state=SupervisorState.ARMED, status=1))
    assert (still.commanded, found) == (True, ())
    assert brief(look(memory=still, status=1)) == [("W9", HARD)]
    assert "while driving" in look(memory=still, status=1)[0].text


def test_timeout_bit_left_from_the_self_test_is_no_starvation():
    assert look(status=1) == ()
    quiet, _ = step_watchdogs(
        TH, WatchdogState(commanded=True), CALM._replace(state=SupervisorState.READY)
    )
    assert not quiet.commanded
    state, found = step_watchdogs(TH, quiet, CALM._replace(state=SupervisorState.ARMED, status=1))
    assert (state.commanded, found) == (False, ())
    assert (
        step_watchdogs(TH, WatchdogState(), CALM._replace(state=SupervisorState.STOPPING))[
            0
        ].commanded
        is False
    )


def test_reboot_shows_in_the_tachometer():
    state, found = step_watchdogs(TH, WatchdogState(), CALM._replace(tachometer=100))
    assert (state.tachometer, found) == (100, ())
    state, found = step_watchdogs(TH, state, CALM._replace(tachometer=100))
    assert found == ()
    state, found = step_watchdogs(TH, state, CALM)  # unknown in this tick
    assert (state.tachometer, found) == (100, ())
    after, found = step_watchdogs(TH, state, CALM._replace(tachometer=99))
    assert brief(found) == [("W12", HARD)]
    assert after.tachometer == 99
    assert brief(look(memory=state, tachometer=0)) == [("W12", HARD)]


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
    assert brief(look(th, x=1.0, speed=0.0, state=SupervisorState.DISARMED)) == []
    assert cos(0.0) == 1.0
    assert brief(look(th, x=2.0 - 0.125, speed=0.0, state=SupervisorState.DISARMED)) == [
        ("W19", HARD)
    ]


def saturate(seconds, first=0.0, last=0.1, share=0.99):
    changes = {"steer_share": share, "lateral_error": first}
    state, found = step_watchdogs(TH, WatchdogState(), CALM._replace(**changes))
    assert found == ()
    changes |= {"t_ns": S + round(seconds * S), "lateral_error": last}
    return brief(look(memory=state, **changes))


def test_steering_saturated_and_the_error_grows():
    assert saturate(0.5 - 1e-9) == []
    assert saturate(0.5) == [("W23", WARN)]
    assert saturate(1.0 - 1e-9) == [("W23", WARN)]
    assert saturate(1.0) == [("W23", SOFT)]
    assert saturate(1.0, first=0.1, last=-0.125) == [("W23", SOFT)]
    assert saturate(1.0, first=-0.125, last=0.125) == []
    assert saturate(1.0, last=0.02) == []
    assert saturate(1.0, last=up(0.02)) == [("W23", SOFT)]
    assert saturate(1.0, share=0.984375) == []
    assert saturate(1.0, share=up(0.984375)) == [("W23", SOFT)]


def test_saturation_that_ends_is_forgotten():
    state, _ = step_watchdogs(TH, WatchdogState(), CALM._replace(steer_share=1.0))
    state, _ = step_watchdogs(TH, state, CALM._replace(t_ns=S + 1))
    state, _ = step_watchdogs(TH, state, CALM._replace(t_ns=2 * S, steer_share=1.0))
    assert (
        look(memory=state, t_ns=3 * S - 1, steer_share=1.0, lateral_error=0.1)[0].severity == WARN
    )


def stop(kind, speeds, dt=S // 16):
    """Watch a stop; return per tick the W24 findings and whether it is slowing."""
    state, out = WatchdogState(), []
    for k, speed in enumerate(speeds):
        tick = CALM._replace(t_ns=S + k * dt, state=kind, speed=speed, speed_erpm=0.0)
        state, found = step_watchdogs(TH, state, tick._replace(speed_mocap=0.0))
        words = [f.text for f in found if f.id == "W24"]
        out.append((words, is_slowing(state)))
    return out


def test_a_stop_that_works_has_no_findings():
    for decel, kind in (
        (0.75, SupervisorState.STOPPING),
        (2.0, SupervisorState.FAULT_STOP),
        (2.0, SupervisorState.ESTOP),
    ):
        found = stop(kind, [2.0 - decel * max(0.0, k / 16 - 0.125) for k in range(12)])
        assert all(words == [] and slowing for words, slowing in found)


def test_a_stop_that_is_too_weak_is_found_after_lag_and_window():
    for decel, kind in (
        (0.74, SupervisorState.STOPPING),
        (1.99, SupervisorState.FAULT_STOP),
        (1.99, SupervisorState.ESTOP),
    ):
        found = stop(kind, [2.0 - decel * max(0.0, k / 16 - 0.125) for k in range(11)])
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


def test_each_kind_of_stop_is_judged_anew():
    state = WatchdogState()
    for k in range(7):
        state, _ = step_watchdogs(
            TH, state, CALM._replace(t_ns=S + k * S // 16, state=SupervisorState.STOPPING)
        )
    assert not is_slowing(state)
    state, found = step_watchdogs(
        TH, state, CALM._replace(t_ns=2 * S, state=SupervisorState.FAULT_STOP)
    )
    assert (is_slowing(state), found) == (True, ())
    state, _ = step_watchdogs(TH, state, CALM._replace(t_ns=2 * S, state=SupervisorState.DISARMED))
    assert state.stop is None


def test_what_the_runner_reports_comes_first_and_counts():
    late = make_finding("W15", "a tick 31 ms late")
    found = look(reported=(late,), telemetry_age=1.0)
    assert brief(found) == [("W15", HARD), ("W7", HARD)]
    bits, text = summarise(found)
    assert bits == Fact.HARD
    assert text == late.text
    assert text.startswith("W15 loop late: a tick 31 ms late; run steerd rtcheck")


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


def test_only_their_own_status_bits_count():
    armed, _ = step_watchdogs(TH, WatchdogState(), CALM)
    assert brief(look(memory=armed, status=2)) == [("W10", KILL)]
    assert hold(1.0, status=2) == ([("W10", KILL)], [("W10", KILL)])
    assert COMMANDED_S == 0.2


def test_nothing_is_weak_before_and_after_a_stop():
    assert is_slowing(WatchdogState())
    weak = WatchdogState(stop=SupervisorState.STOPPING, weak=3)
    assert is_slowing(step_watchdogs(TH, weak, CALM)[0])


def test_a_tachometer_of_zero_is_known():
    assert step_watchdogs(TH, WatchdogState(), CALM._replace(tachometer=0))[0].tachometer == 0
