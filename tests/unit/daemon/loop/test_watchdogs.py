"""Each watchdog exactly at its boundary, with numbers that floats represent exactly."""

from dataclasses import replace
from math import inf, nan, pi

import pytest

from steerd.daemon.loop import watchdogs as wd
from steerd.daemon.loop.findings import Severity, make_finding, summarise
from steerd.daemon.loop.follow_model import Band
from steerd.daemon.loop.following import Followed
from steerd.daemon.loop.transitions import Fact, SupervisorState
from steerd.daemon.loop.watchdogs_pose import PoseWatch
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.watching import TH, S, after, brief, down, look, step, up

WARN, SOFT, HARD, KILL = Severity


def test_calm_driving_has_no_findings_and_needs_no_motor_sensor():
    assert look() == look(Thresholds()) == look(motor_temperature=nan) == ()


def row(id, severity, at, beyond, said="", *, held=0.0, warned=False):
    """A watchdog at its edge and beyond it for so long [s]; `warned`: at its edge it warns."""
    return pytest.param(id, severity, at, beyond, said, held, warned)


TINY = 5e-324
FAST = {"speed_erpm": 4.0, "speed_mocap": 4.0, "speed_limit": 6.0}
STUCK = {"current_share": up(0.5), "speed_erpm": 0.0, "speed_mocap": 0.0, "speed": 2.0}
"""The wheels stand and the motor pushes, whatever the filter believes."""
OFF = Followed(2.5, Band(0.75, 1.25), TINY, -0.5, Band(0.125, 0.25), TINY)
SPEED_OFF, TURN_OFF = Followed(speed_excess=TINY), Followed(turn_excess=TINY)
EDGES = [
    row("W1", WARN, {"speed": 0.0, "mocap_age": 0.03125}, {"speed": 0.0, "mocap_age": up(0.03125)},
        "no good frame for 31 ms (limit 125 ms)"),
    row("W1", HARD, {"mocap_age": 0.125}, {"mocap_age": up(0.125)}, warned=True),
    row("W1", HARD, {}, {"mocap_age": 2.0, "speed": 4.0},
        "no good frame for 2000 ms (limit 62 ms)"),
    row("W2", WARN, {"pose": PoseWatch(frozen=2)}, {"pose": PoseWatch(frozen=3)},
        "3 identical frames at 1.50 m/s"),
    row("W2", HARD, {"pose": PoseWatch(frozen=4)}, {"pose": PoseWatch(frozen=5)}, warned=True),
    row("W3", WARN, {}, {"pose": PoseWatch(invalid=1)}, "1 bad frames in a row"),
    row("W3", HARD, {"pose": PoseWatch(invalid=4)}, {"pose": PoseWatch(invalid=5)}, warned=True),
    row("W4", WARN, {}, {"pose": PoseWatch(jumps=1)}, "1 jumps in a row, 0 lately"),
    row("W4", HARD, {"pose": PoseWatch(jumps=2)}, {"pose": PoseWatch(jumps=3)}, warned=True),
    *(row("W4", HARD, {"pose": PoseWatch(jump_times=few)},
          {"pose": PoseWatch(jump_times=(0, 1, 2, 3, 4))}, "0 jumps in a row, 5 lately")
      for few in ((-1, 1, 2, 3, 4), (1, 2, 3, 4))),
    row("W5", WARN, {}, {"pose": PoseWatch(rejections=0b1)},
        "0 frames in a row rejected, 2% lately"),
    row("W5", HARD, {"pose": PoseWatch(rejections=0b1111, rejected=4)},
        {"pose": PoseWatch(rejections=0b11111, rejected=5)}, warned=True),
    row("W5", HARD, {"pose": PoseWatch(rejections=int("10" * 15, 2))},  # 15 of 50: 30 %
        {"pose": PoseWatch(rejections=int("10" * 16, 2))}, warned=True),
    row("W6", HARD, {"sigma_position": 0.125}, {"sigma_position": up(0.125)},
        "sigma 0.125 m, 0.6°"),
    row("W6", HARD, {"sigma_yaw": 0.125}, {"sigma_yaw": up(0.125)}, "sigma 0.010 m, 7.2°"),
    row("W6", HARD, {}, {"covariance_ok": False}, "covariance not positive definite"),
    row("W7", WARN, {"telemetry_age": 0.0625}, {"telemetry_age": up(0.0625)}),
    row("W7", HARD, {"telemetry_age": 0.09375}, {"telemetry_age": up(0.09375)}, warned=True),
    row("W7", HARD, {}, {"telemetry_age": 3.0}, "no reply for 3000 ms"),
    row("W9", HARD, {}, {"status": 1}, "status bit 0 stays set", held=0.2),
    row("W10", KILL, {"status": 1}, {"status": 3}, "status bit 1 is set"),
    row("W11", HARD, {}, {"fault_code": 1}, "fault code 1"),
    row("W12", HARD, {}, {"fault_code": 10}, "fault code 10"),
    row("W13", WARN, {"cell_voltage": 3.5}, {"cell_voltage": down(3.5)}, "3.50 V per cell"),
    row("W13", SOFT, {"cell_voltage": 3.25}, {"cell_voltage": down(3.25)}, "3.25 V per cell",
        held=0.5, warned=True),
    row("W13", SOFT, {}, {"cell_voltage": nan}, held=0.5),
    row("W14", WARN, {"fet_temperature": 75.0}, {"fet_temperature": up(75.0)},
        "transistors at 75 C"),
    row("W14", SOFT, {"fet_temperature": 85.0}, {"fet_temperature": up(85.0)}, warned=True),
    row("W14", WARN, {"motor_temperature": 80.0}, {"motor_temperature": up(80.0)},
        "motor at 80 C"),
    row("W14", SOFT, {"motor_temperature": 95.0}, {"motor_temperature": up(95.0)}, warned=True),
    *(row("W17", severity, {"lateral_error": side * at}, {"lateral_error": side * up(at)},
          f"{at:.2f} m", held=held, warned=severity is HARD)
      for severity, at, held in ((WARN, 0.1875, 0.0), (HARD, 0.5, 0.0), (HARD, 0.3125, 0.125))
      for side in (1.0, -1.0) if (at, side) != (0.5, 1.0)),
    *(row("W18", WARN, {"heading_error": side * 0.5}, {"heading_error": side * up(0.5)}, "29°")
      for side in (1.0, -1.0)),
    row("W18", HARD, {"heading_error": -0.75}, {"heading_error": down(-0.75)}, warned=True),
    row("W20", HARD, {"speed_erpm": 2.25, "speed_mocap": 2.25}, {"speed_erpm": up(2.25)},
        "wheels 2.25, mocap 1.50 m/s", held=0.0625),
    row("W20", HARD, {"speed_mocap": -2.25, "speed_erpm": -2.25},
        {"speed_mocap": -up(2.25), "speed_erpm": -2.25}, held=0.0625),
    row("W20", HARD, {"speed_mocap": 0.625, "speed_erpm": 0.5, "speed_limit": 0.5},
        {"speed_mocap": up(0.625), "speed_erpm": 0.5, "speed_limit": 0.5}, held=0.0625),
    row("W21", HARD, {"speed_erpm": 1.0, "speed_mocap": 1.5},
        {"speed_erpm": 1.0, "speed_mocap": up(1.5)}, "wheels 1.00, mocap 1.50 m/s", held=0.1875),
    row("W21", HARD, {**FAST, "speed_erpm": 3.0}, {**FAST, "speed_erpm": 3.0,
        "speed_mocap": up(4.0)}, held=0.1875),
    *(row("W22", HARD, {**STUCK, **at}, {**STUCK, "speed_erpm": slow},
          "50% of the current limit at 0.06 m/s" if slow > 0.0 else "", held=1.0)
      for at in ({"current_share": 0.5}, {"speed_erpm": 0.0625}, {"speed_erpm": -0.0625})
      for slow in (down(0.0625), -down(0.0625))),
    row("W25", WARN, {"lease_age": 0.125}, {"lease_age": up(0.125)}),
    row("W25", SOFT, {"lease_age": 0.25}, {"lease_age": up(0.25)}, warned=True),
    row("W25", SOFT, {}, {"lease_age": 2.0}, "not renewed for 2000 ms"),
    row("W30", HARD, {"followed": Followed()}, {"followed": changed(OFF, turn_excess=0.0)},
        "wheels 2.50 m/s, orders allow 0.75 to 1.25", held=0.0625),
    row("W30", HARD, {}, {"followed": Followed(speed_excess=nan),
                          "state": SupervisorState.STOPPING}, held=0.0625),
    row("W30", HARD, {}, {**FAST, "followed": SPEED_OFF}, held=0.03125),
    row("W31", HARD, {"followed": Followed()}, {"followed": changed(OFF, speed_excess=0.0)},
        "turns at -0.50 rad/s, orders allow 0.12 to 0.25", held=0.03125),
    row("W31", HARD, {}, {"followed": Followed(turn_excess=nan),
                          "state": SupervisorState.STOPPING}, held=0.03125),
    row("W31", HARD, {}, {**FAST, "followed": TURN_OFF}, held=0.015625),
]  # fmt: skip


@pytest.mark.parametrize(("id", "severity", "at", "beyond", "said", "held", "warned"), EDGES)
def test_each_watchdog_trips_beyond_its_edge_after_its_time_and_not_before(
    id, severity, at, beyond, said, held, warned
):
    quiet = [(id, WARN)] * warned
    assert brief(after(100.0 * held, **at)) == quiet
    found = after(held, **beyond)
    assert brief(found) == quiet * bool(held) + [(id, severity)]
    assert not said or f": {said}; " in found[-1].text
    if held:
        assert brief(look(**beyond)) == brief(after(held - 1e-9, **beyond)) == quiet


def test_mocap_is_never_blind_for_more_than_its_distance():
    edges = {0.0: 0.125, 2.0: 0.125, -4.0: 0.0625, 5.0: 0.05, 8.0: 0.046875, nan: 0.046875}
    assert {speed: wd.mocap_timeout(TH, speed) for speed in edges} == edges
    for speed in (k / 16 for k in range(97)):
        assert wd.mocap_timeout(Thresholds(), speed) * speed <= 0.30 * (1 + 1e-12)


@pytest.mark.parametrize(("speed", "erpm"), [(4.0, 0.0), (0.0, 4.0), (0.0, -4.0), (-4.0, 1.0)])
def test_mocap_age_is_judged_at_the_faster_speed(speed, erpm):
    changes = {"speed": speed, "speed_erpm": erpm, "state": SupervisorState.ARMED}
    assert brief(look(mocap_age=0.0625, **changes)) == [("W1", WARN)]
    assert brief(look(mocap_age=up(0.0625), **changes)) == [("W1", HARD)]


def test_unknown_speeds_count_as_blocked_overspeed_and_mismatch():
    unknown = {**STUCK, "speed_erpm": nan}
    assert look(**unknown) == ()
    assert ("W22", HARD) in brief(after(1.0, **unknown))
    for name in ("speed_erpm", "speed_mocap"):
        assert brief(after(0.5, **{name: nan})) == [("W20", HARD), ("W21", HARD)]


DRIVING = ("RUNNING", "STOPPING")


def test_an_interruption_starts_the_time_again():
    state, _ = step(lateral_error=0.4)
    state, _ = step(state, t_ns=S + S // 16)
    for t_ns in (S + S // 8, S + S // 4 - 1):
        state, found = step(state, t_ns=t_ns, lateral_error=0.4)
        assert brief(found) == [("W17", WARN)]
    found = look(memory=state, t_ns=S + S // 4, lateral_error=0.4)
    assert brief(found) == [("W17", WARN), ("W17", HARD)]


@pytest.mark.parametrize("state", [s for s in SupervisorState if s.name not in DRIVING])
def test_driving_watchdogs_are_silent_while_the_car_is_parked(state):
    off = Followed(speed_excess=1.0, turn_excess=1.0)
    wrong = {"lateral_error": 9.0, "heading_error": 3.0, "steer_share": 1.0, "followed": off}
    wrong |= {"state": state, "speed": 0.0, "current_share": 1.0}
    assert look(**wrong, speed_erpm=9.0) == after(0.24, **wrong, speed_erpm=9.0) == ()
    assert after(100.0, **wrong, speed_erpm=0.0) == ()


@pytest.mark.parametrize("state", SupervisorState)
def test_lease_matters_while_armed_or_driving(state):
    matters = state.name in ("ARMED", *DRIVING)
    assert brief(look(state=state, lease_age=inf)) == ([("W25", SOFT)] if matters else [])


@pytest.mark.parametrize(("seconds", "first", "last", "share", "severities"), [
    (0.5 - 1e-9, 0.0, 0.1, 0.99, []), (0.5, 0.0, 0.1, 0.99, [WARN]),
    (1.0 - 1e-9, 0.0, 0.1, 0.99, [WARN]), (1.0, 0.0, 0.1, 0.99, [SOFT]),
    (1.0, 0.1, -0.125, 0.99, [SOFT]), (1.0, -0.125, 0.125, 0.99, []),
    (1.0, 0.0, 0.02, 0.99, []), (1.0, 0.0, up(0.02), 0.99, [SOFT]),
    (1.0, 0.0, 0.1, 0.984375, []), (1.0, 0.0, 0.1, up(0.984375), [SOFT]),
])  # fmt: skip
def test_steering_saturated_and_the_error_grows(seconds, first, last, share, severities):
    state, found = step(steer_share=share, lateral_error=first)
    assert found == ()
    t_ns = S + round(seconds * S)
    found = look(memory=state, t_ns=t_ns, steer_share=share, lateral_error=last)
    assert brief(found) == [("W23", severity) for severity in severities]


def test_saturation_that_ends_is_forgotten():
    state, _ = step(steer_share=1.0)
    state, _ = step(state, t_ns=S + 1)
    state, _ = step(state, t_ns=2 * S, steer_share=1.0)
    found = look(memory=state, t_ns=3 * S - 1, steer_share=1.0, lateral_error=0.1)
    assert found[0].severity == WARN
    assert ": at the limit for 1.0 s, 0.10 m off and growing; " in found[0].text


def test_what_the_runner_reports_comes_first_and_counts():
    late = make_finding("W15", "a tick 31 ms late")
    found = look(reported=(late,), telemetry_age=1.0)
    assert brief(found) == [("W15", HARD), ("W7", HARD)]
    bits, text = summarise(found)
    assert bits == Fact.HARD
    assert text == late.text
    assert text.startswith("W15 loop late: a tick 31 ms late; run steerd rtcheck")


SQUARE = ((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0))
FENCED = replace(TH, fence=SQUARE)
ELL = ((0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0))
KITE = ((0.0, -2.0), (3.0, 1.0), (0.0, 2.0), (-1.0, 1.0))


@pytest.mark.parametrize(("fence", "inside", "outside"), [
    (SQUARE, [(0.0, 0.0), (down(2.0), 0.0)], [(2.0, 0.0), (up(2.0), 0.0), (nan, 0), (0, nan)]),
    (SQUARE[::-1], [(1.9, -1.9)], [(1.9, -2.1)]),
    (SQUARE[2:] + SQUARE[:2], [(1.9, -1.9)], [(1.9, -2.1)]),
    (ELL, [(1.0, 3.0), (3.0, 1.0)], [(3.0, 3.0)]),
    (KITE, [(1.0, 0.0), (1.9, 0.0), (-0.3, 0.0)], [(2.0, -0.5), (2.1, 0.0), (-0.7, 0.0)]),
])  # fmt: skip
def test_inside_a_polygon(fence, inside, outside):
    assert all(wd.is_inside(fence, *place) for place in inside)
    assert not any(wd.is_inside(fence, *place) for place in outside)


EDGE = 2.0 - (0.25 + 0.5 + 0.125)  # v 2: 2*0.125 + 4/8 + margin
PARKED = {"speed": 0.0, "state": SupervisorState.DISARMED}


@pytest.mark.parametrize(("changes", "severities"), [
    *(({"x": sign * (EDGE + beyond), "course": course, "speed": speed}, severities)
      for course, sign in ((0.0, 1.0), (pi, -1.0)) for speed in (2.0, -2.0)
      for beyond, severities in ((-0.51, []), (-0.49, [WARN]), (-0.001, [WARN]),
                                 (0.001, [HARD]))),
    ({"y": EDGE + 0.001, "course": pi / 2, "speed": 2.0}, [HARD]),
    ({"x": 1.0, **PARKED}, []), ({"x": 2.0 - 0.125, **PARKED}, [HARD]),
    # Aslant; 1 m from the edge it stays just inside.
    *(({"x": far * x, "y": far * y, "course": course, "speed": 2.0}, [severity])
      for course, x, y in ((0.6, 1.0, 0.0), (0.6 + pi, -1.0, 0.0), (0.9, 0.0, 1.0))
      for far, severity in ((1.0, WARN), (1.5, HARD))),
    ({"x": -1.0, "course": 0.6, "speed": 2.0}, []),
])  # fmt: skip
def test_fence_counts_the_stopping_distance(changes, severities):
    assert brief(look(FENCED, **changes)) == [("W19", severity) for severity in severities]


def test_a_fence_needs_a_place():
    (unknown,) = look(FENCED, x=nan)
    assert unknown.severity is HARD
    assert unknown.text == "W19 fence: where the car is is not known"


# Whether a stop slows the car: judged over lag and window, by each kind of stop (W24).
def stop(kind, speeds, dt=S // 16, wheels=0.0, telemetry_age=0.0):
    """Watch a stop; return per tick the W24 findings and whether it is slowing."""
    state, out = wd.WatchdogState(), []
    given = {"state": kind, "speed_erpm": wheels, "speed_mocap": 0.0}
    for k, speed in enumerate(speeds):
        tick = {"t_ns": S + k * dt, "speed": speed, "telemetry_age": telemetry_age}
        state, found = step(state, **given, **tick)
        words = [f.text for f in found if f.id == "W24"]
        out.append((words, state.weak == 0))
    return out


def slowed(decel, ticks):
    return [2.0 - decel * max(0.0, k / 16 - 0.125) for k in range(ticks)]


@pytest.mark.parametrize(("kind", "least"), [
    (SupervisorState.STOPPING, 0.75), (SupervisorState.FAULT_STOP, 2.0),
    (SupervisorState.ESTOP, 2.0),
])  # fmt: skip
def test_a_stop_below_its_least_deceleration_is_found_after_lag_and_window(kind, least):
    assert all(words == [] and slowing for words, slowing in stop(kind, slowed(least, 12)))
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
    memory = wd.WatchdogState()
    for k in range(7):
        memory, _ = step(memory, t_ns=S + k * S // 16, state=SupervisorState.STOPPING)
    assert memory.weak
    memory, found = step(memory, t_ns=2 * S, state=SupervisorState.FAULT_STOP)
    assert (memory.weak, found) == (0, ())
    assert step(memory, t_ns=2 * S, state=SupervisorState.DISARMED)[0].stop is None
    assert wd.WatchdogState().weak == 0, "before a stop"
    weak = wd.WatchdogState(stop=SupervisorState.STOPPING, weak=3)
    assert step(weak)[0].weak == 0, "after it"


# What the VESC says of itself: status bits, fault codes, its tachometer (W9 to W12).
def test_starved_at_once_after_commands_were_seen_to_arrive():
    state, _ = step(state=SupervisorState.ARMED)
    assert state.commanded
    still, found = step(state, state=SupervisorState.ARMED, status=1)
    assert (still.commanded, found) == (True, ())
    assert brief(look(memory=still, status=1)) == [("W9", HARD)]
    assert "while driving" in look(memory=still, status=1)[0].text


def test_timeout_bit_left_from_the_self_test_is_no_starvation():
    assert look(status=1) == ()
    quiet, _ = step(wd.WatchdogState(commanded=True), state=SupervisorState.READY)
    assert not quiet.commanded
    state, found = step(quiet, state=SupervisorState.ARMED, status=1)
    assert (state.commanded, found) == (False, ())
    assert step(state=SupervisorState.STOPPING)[0].commanded is False


def test_reboot_shows_in_the_tachometer():
    state = wd.WatchdogState()
    for tachometer in (100, 100, -1):  # unknown in the last tick
        state, found = step(state, tachometer=tachometer)
        assert (state.tachometer, found) == (100, ())
    after, found = step(state, tachometer=99)
    assert brief(found) == [("W12", HARD)]
    assert ": tachometer fell from 100 to 99; " in found[0].text
    assert after.tachometer == 99
    assert brief(look(memory=state, tachometer=0)) == [("W12", HARD)]
    assert step(tachometer=0)[0].tachometer == 0, "zero is known"


def test_only_their_own_status_bits_count():
    assert brief(look(memory=step()[0], status=2)) == [("W10", KILL)]
    assert brief(after(1.0, status=2)) == [("W10", KILL)]
