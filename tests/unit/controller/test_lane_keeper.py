"""Lane errors, the steering law and the whole controller, a tick at a time."""

import math
from dataclasses import replace
from math import exp, inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerd.car_model.chassis import derivative
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import Path, Projection, interpolate, project
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command, State
from steerd.controller import live
from steerd.controller.build import make_controller
from steerd.controller.config import ControllerConfig
from steerd.controller.design import assess, find_faults
from steerd.controller.gain_table import N_LANE, N_TURNING, Turning
from steerd.controller.lane_controller import control, start_controller, to_command
from steerd.controller.lane_keeper import LaneErrors, LaneKeeper, lane_errors, step
from steerd.controller.learnt import KEPT_NS, Servo, order_servo, step_servo
from steerd.controller.live import AS_DESIGNED, LiveValues, approach, limit_target
from steerd.controller.speed import SpeedProfile, make_speed_profile, profile_speed, step_speed

LINE = parse_path("line:length=10")
KEEPER = LaneKeeper(LINE, 0.06, -0.34, 0.34)
NO_TURNING = Turning(0.33, 0.0, -0.15, 0.0)


def row(past: tuple[float, ...] = (), **gains: float) -> tuple[float, ...]:
    names = ("e1", "e1_rate", "e2", "e2_rate", "steer")
    assert len(names) == N_LANE
    return (*(gains.get(name, 0.0) for name in names), *past, *NO_TURNING)


def wheel_reference(gains: tuple[float, ...], errors: LaneErrors, past: tuple[float, ...] = ()):
    at = Projection(1.0, 50, errors.e1, 0.0, 0.0, abs(errors.e1))
    return step(KEEPER, gains, errors, at, ORIGIN._replace(speed=1.0, steer=0.1), past)[0]


def test_each_gain_steers_against_its_error_up_to_the_end_stops_and_a_past_has_to_fit():
    errors = LaneErrors(0.1, 0.2, 0.03, 0.4)
    for name, gain, steer in (("e1", 2.0, -0.2), ("e1_rate", 0.5, -0.1), ("e2", 2.0, -0.06),
                              ("e2_rate", 0.5, -0.2), ("steer", 0.5, -0.05)):  # fmt: skip
        assert wheel_reference(row(**{name: gain}), errors) == pytest.approx(steer)
    assert wheel_reference(row(past=(0.5, 0.25)), errors, (0.1, -0.4)) == pytest.approx(0.05)
    assert wheel_reference(row(e1=100.0), LaneErrors(1.0, 0.0, 0.0, 0.0)) == KEEPER.wheel_min
    assert wheel_reference(row(e1=100.0), LaneErrors(-1.0, 0.0, 0.0, 0.0)) == KEEPER.wheel_max
    with pytest.raises(ValueError, match="zip"):
        wheel_reference(row(past=(0.5,)), errors, (0.1, 0.2))


def test_the_curvature_is_read_where_the_order_will_act():
    eight = parse_path("figure8")
    keeper = LaneKeeper(eight, 0.2, -0.34, 0.34)
    at = project(eight, eight.x[100], eight.y[100], 100)
    estimate = ORIGIN._replace(speed=2.0, steer=DEFAULT_CAR.steer_bias)
    _, feedforward = step(keeper, row(), LaneErrors(0.0, 0.0, 0.0, 0.0), at, estimate, ())
    assert feedforward == pytest.approx(0.33 * interpolate(eight, eight.curvature, at.s + 0.4))


# The speed profile's limits and the reference's ramps.
CONFIG = ControllerConfig(speed=3.0, lateral_accel_max=2.0, accel_max=1.0, decel_max=2.0)


def profile_of(path: Path, config: ControllerConfig = CONFIG) -> SpeedProfile:
    return make_speed_profile(DEFAULT_CAR, path, config)


def test_no_limit_is_exceeded_anywhere_round_a_figure_eight():
    path = parse_path("figure8:radius=1")
    v = np.array(profile_of(path).speed)
    assert (v**2 * np.abs(path.curvature)).max() <= 2.0 + 1e-9
    gain = (np.roll(v, -1) ** 2 - v**2) / (2.0 * path.step)  # also from the last to the first
    assert gain.max() <= 1.0 + 1e-9
    assert gain.min() >= -2.0 - 1e-9
    assert v.max() > 1.2 * v.min()


def test_an_open_path_ends_standing_and_its_profile_is_read_ahead_by_the_drives_lag():
    path = parse_path("line:length=10")
    profile = profile_of(path)
    assert (profile.speed[0], profile.speed[-1]) == (3.0, 0.0)
    expected = np.minimum(3.0, np.sqrt(2.0 * 2.0 * (10.0 - np.array(path.s))))
    np.testing.assert_allclose(expected, profile.speed, atol=1e-6)
    assert profile.preview_s == pytest.approx(DEFAULT_CAR.speed_lag + DEFAULT_CAR.drive_delay)
    ahead = profile_speed(profile, 9.0, 2.0)
    assert ahead == pytest.approx(math.sqrt(4.0 * (1.0 - 0.2)), abs=1e-3)
    assert profile_speed(profile, 9.0, -1.0) == pytest.approx(2.0, abs=1e-3)


def test_a_files_speeds_cap_it_unless_configured_not_to():
    path = parse_path("circle:radius=20")
    slow = replace(path, speed=(0.7,) * len(path.x))
    assert profile_of(slow).fastest == pytest.approx(0.7)
    assert profile_of(slow, replace(CONFIG, file_speeds=False)).fastest == 3.0


def test_the_reference_climbs_at_the_start_ramp_and_stops_at_the_stop_ramp():
    config, speeds = ControllerConfig(start_ramp=1.5, stop_ramp=1.0), [0.0]
    for k in range(210):
        speeds.append(step_speed(speeds[-1], 1.0, 0.01, config, stop=k >= 100))
    assert (speeds[1], speeds.index(1.0), speeds[100]) == (pytest.approx(0.015), 67, 1.0)
    assert (speeds[150], speeds[-1]) == (pytest.approx(0.5), 0.0)
    assert step_speed(2.0, 1.2, 0.01, config, stop=False) == 1.2, "it follows the profile down"


# Where the wheels are, by the orders that left.
MS = 1_000_000
CAR = DEFAULT_CAR._replace(steer_gain=0.9, steer_bias=0.01, steer_lag=0.05)


@pytest.mark.parametrize(("ms", "order", "wheel", "rel"), [
    (29, 0.2, 0.01, 1e-6), (79, 0.2, 0.01 + 0.18 * (1.0 - exp(-1.0)), 1e-2),
    (500, 0.2, 0.9 * 0.2 + 0.01, 1e-3), (800, 1.0, CAR.steer_max, 1e-3),
], ids=["dead time", "lag", "settled", "end stop"])  # fmt: skip
def test_where_the_wheel_is(ms, order, wheel, rel):
    servo = order_servo(Servo(t_ns=0, wheel=0.01), 0, Command(order, 1.0))
    for t in range(1, ms + 1):
        servo = step_servo(servo, CAR, 0.03, t * MS)
    assert servo.wheel == pytest.approx(wheel, rel=rel)


def test_orders_are_kept_as_long_as_a_dead_time_can_be_and_no_longer():
    servo = Servo()
    for k in range(300):
        servo = order_servo(servo, k * 10 * MS, Command(0.001 * k, 1.0))
    times = [t for t, _ in servo.orders]
    assert times[0] < 2990 * MS - KEPT_NS <= times[1]
    assert order_servo(servo, 3_000 * MS, None) == servo, "a brake moves no wheel"


# The whole controller, a tick at a time; whole drives are those of `tests/e2e`.
SLOW_SERVO = DEFAULT_CAR._replace(steer_lag=0.08, steer_delay=DEFAULT_CAR.steer_delay + 0.03)
"""30 ms more dead time and 80 ms servo lag."""


def make(speed=1.5, spec="circle:radius=2", car=DEFAULT_CAR):
    return make_controller(car, parse_path(spec), ControllerConfig(speed=speed), 100.0)


def test_a_cars_gain_and_bias_are_undone():
    crooked = DEFAULT_CAR._replace(steer_gain=0.8, steer_bias=0.05, speed_gain=0.9)
    assert to_command(crooked, 0.05, 0.9) == pytest.approx((0.0, 1.0))


SEEN = ORIGIN._replace(y=0.05, speed=1.0)


def test_a_command_is_remembered_as_it_left():
    controller = make(1.5, "figure8", SLOW_SERVO)
    state = start_controller(controller, SEEN, 0)
    assert len(state.past) == 4
    command, _, after = control(controller, state, SEEN, 10_000_000)
    alone = control(controller, after, SEEN, 20_000_000)
    informed = control(controller, after, SEEN, 20_000_000, issued=command)
    assert informed[0] == pytest.approx(alone[0]), "one that left unchanged changes nothing"
    assert informed[2].past == pytest.approx(alone[2].past)
    held = command._replace(steer=0.5 * command.steer)
    _, _, informed = control(controller, after, SEEN, 20_000_000, issued=held)
    assert informed.past[1] == pytest.approx(held.steer - after.feedforward)
    controller = make(1.0, car=DEFAULT_CAR._replace(steer_delay=0.0))
    command, _, after = control(controller, start_controller(controller, SEEN, 0), SEEN, 10_000_000)
    again = control(controller, after, SEEN, 20_000_000, issued=command)[2]
    assert after.past == again.past == (), "no delay means no past"


def test_a_clock_that_stands_or_leaps_is_no_leap_in_speed():
    controller = make(1.0)
    state = start_controller(controller, ORIGIN, 0)
    for t_ns, speed in ((0, 0.0), (-5, 0.0), (10**12, pytest.approx(0.15))):
        assert control(controller, state, ORIGIN, t_ns)[2].speed == speed


@pytest.mark.parametrize("field", State._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_an_estimate_that_is_not_finite_is_refused(field, value):
    controller = make(1.0)
    begun = start_controller(controller, SEEN, 0)
    with pytest.raises(ValueError, match="not finite"):
        control(controller, begun, SEEN._replace(**{field: value}), 1)


# What lane errors promise for any place.
EIGHT = parse_path("figure8")
TURN, MIRRORED = parse_path("circle:radius=1.4"), parse_path("circle:radius=-1.4")

# Share of the way round, offset, heading error; speed, yaw rate, slip angle.
PLACES = st.tuples(st.floats(0.05, 0.95), st.floats(-0.3, 0.3), st.floats(-0.8, 0.8))
MOTIONS = st.tuples(st.floats(0.0, 4.0), st.floats(-3.0, 3.0), st.floats(-0.2, 0.2))


def beside(path: Path, place, motion) -> tuple[int, State[float]]:
    share, e1, e2 = place
    i = int(share * len(path.x))
    yaw = path.yaw[i]
    x, y = path.x[i] - e1 * math.sin(yaw), path.y[i] + e1 * math.cos(yaw)
    return i, State(x, y, yaw + e2, *motion, 0.0)


def errors_at(path: Path, state: State[float], hint: int) -> LaneErrors:
    return lane_errors(state, project(path, state.x, state.y, hint))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(PLACES, MOTIONS)
def test_rates_are_the_derivatives_of_the_errors(place, motion):
    hint, state = beside(EIGHT, place, motion)
    rates, h = derivative(SINGLE_TRACK, FLOAT, DEFAULT_CAR, state, 0.0, 0.0), 1e-3

    def moved(by: float) -> LaneErrors:
        there = (at + by * rate for at, rate in zip(state[:3], rates[:3], strict=True))
        return errors_at(EIGHT, State(*there, *state[3:]), hint)

    before, now, after = moved(-h), errors_at(EIGHT, state, hint), moved(h)
    assert now.e1_rate == pytest.approx((after.e1 - before.e1) / (2.0 * h), abs=2e-3)
    assert now.e2_rate == pytest.approx((after.e2 - before.e2) / (2.0 * h), abs=2e-2)


@settings(max_examples=50, deadline=None, derandomize=True)
@given(PLACES, MOTIONS)
def test_left_is_the_mirror_image_of_right(place, motion):
    hint, at = beside(TURN, place, motion)
    mirrored = State(at.x, -at.y, -at.yaw, at.speed, -at.yaw_rate, -at.slip_angle, 0.0)
    left, right = errors_at(TURN, at, hint), errors_at(MIRRORED, mirrored, hint)
    assert right == pytest.approx(tuple(-value for value in left), abs=1e-9)


# Live parameters of the lane keeper: their bounds, and a lane beside the path.
CIRCLE = parse_path("circle:radius=2")
AT = State(2.1, 0.3, 1.8, 0.9, 0.4, 0.01, 0.15)


def bounds_of(made, offset_max=0.15):
    path, timing = made.keeper.path, made.report.timing
    return live.make_live_bounds(made.car, path, made.config, made.table, timing, offset_max)


def tick(made, live, **more):
    state = start_controller(made, AT, 0)
    return control(made, state, AT, 10_000_000, live=live, **more)


def test_the_designs_own_share_changes_no_bit_and_lies_within_bounds_that_pass_its_check():
    made = make()
    plain = control(made, start_controller(made, AT, 0), AT, 10_000_000)
    assert tick(made, AS_DESIGNED) == plain
    assert tick(made, bounds_of(made).start) == plain
    timing, damping = made.report.timing, made.config.damping_min
    low, high = live.find_gain_bounds(made.car, made.table, timing, damping)
    assert live.GAIN_LEAST <= low <= 1.0 <= high <= live.GAIN_MOST
    for share in (low, high):
        rows = ((*(share * v for v in r[:-N_TURNING]), *r[-N_TURNING:]) for r in made.table.rows)
        scaled = made.table._replace(rows=tuple(rows))
        assert not find_faults(assess(made.car, scaled, timing), damping)


def test_a_loop_with_little_margin_grants_less_and_none_grants_nothing():
    made = make(3.0)
    late = made.report.timing._replace(delay_s=made.report.timing.delay_s + 0.1)
    wide = live.find_gain_bounds(made.car, made.table, made.report.timing, 0.1)
    assert wide[1] - wide[0] > 0.5
    narrow = live.find_gain_bounds(made.car, made.table, late, 0.1)
    assert narrow[1] < wide[1]
    assert live.find_gain_bounds(made.car, made.table, made.report.timing, 0.999) == (1.0, 1.0)


def test_a_lane_that_the_car_cannot_turn_is_not_granted():
    free = bounds_of(make())
    assert (free.low.offset, free.high.offset) == (-0.15, 0.15)
    tight = bounds_of(make(0.8, "circle:radius=1.35"), 0.5)
    assert tight.low.offset == pytest.approx(-0.5), "outwards the turn is wider"
    assert 0.0 < tight.high.offset < 0.45
    wheel = max(row[-N_TURNING] for row in make(0.8).table.rows)
    turned = wheel * live.shift_curvature(1 / 1.35, tight.high.offset)
    assert turned <= DEFAULT_CAR.steer_max


def test_a_shifted_circle_is_the_one_beside_it_where_lateral_acceleration_stays():
    at = live.shift_lane(project(CIRCLE, 1.9, 0.0, 0), 0.1)
    beside = parse_path("circle:radius=1.9")
    assert at.curvature == pytest.approx(beside.curvature[0], rel=1e-6)
    assert at.e1 == pytest.approx(project(CIRCLE, 1.9, 0.0, 0).e1 - 0.1)
    config = ControllerConfig(speed=3.0, lateral_accel_max=2.0)
    inner = LiveValues(inf, 0.1, 1.0)
    assert limit_target(2.0, CIRCLE, 0.0, inner, config) == pytest.approx((2.0 * 1.9) ** 0.5, 1e-6)
    assert limit_target(1.5, CIRCLE, 0.0, inner, config) == 1.5
    assert limit_target(2.0, CIRCLE, 0.0, LiveValues(inf, -0.1, 1.0), config) == 2.0
    assert limit_target(2.0, CIRCLE, 0.0, LiveValues(0.7, 0.0, 1.0), config) == 0.7


def test_a_lower_speed_is_reached_by_the_stop_ramp():
    made = make(1.5)
    state = start_controller(made, AT, 0)._replace(speed=1.4)
    slow = LiveValues(0.5, 0.0, 1.0)
    command, _, after = control(made, state, AT, 100_000_000, live=slow)
    ramp = made.config.stop_ramp * 0.1
    assert after.speed == pytest.approx(1.4 - ramp)
    assert command.speed == pytest.approx(after.speed / DEFAULT_CAR.speed_gain)
    _, _, held = control(made, after._replace(speed=0.5), AT, 200_000_000, live=slow)
    assert held.speed == 0.5


def test_more_feedback_steers_more_and_feed_forward_stays():
    made = make()
    wheel = {g: tick(made, LiveValues(inf, 0.0, g))[1].wheel for g in (0.5, 1.0, 1.5)}
    ahead = tick(made, AS_DESIGNED)[1].feedforward
    assert wheel[1.0] - ahead == pytest.approx(2.0 * (wheel[0.5] - ahead))
    limit = made.keeper.wheel_min if wheel[1.5] < 0.0 else made.keeper.wheel_max
    assert wheel[1.5] in (pytest.approx(ahead + 1.5 * (wheel[1.0] - ahead)), limit)


def test_new_values_come_into_force_gradually():
    now, aim = LiveValues(1.0, 0.0, 1.0), LiveValues(0.5, 0.1, 0.8)
    assert approach(now, aim, 0.1) == LiveValues(0.5, pytest.approx(0.01), pytest.approx(0.95))
    assert approach(now, aim, 10.0) == aim
    assert approach(aim, now, 0.1).offset == pytest.approx(0.09)
    assert approach(aim, aim, 0.0) == aim
