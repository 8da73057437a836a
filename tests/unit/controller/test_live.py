"""Live parameters of the lane keeper: their bounds, and a lane beside the path."""

from math import inf

import pytest

from steerd.car_model.params import DEFAULT_CAR
from steerd.car_model.path.path import project
from steerd.car_model.path.path_spec import parse_path
from steerd.car_model.state import State
from steerd.controller.build import make_controller
from steerd.controller.config import ControllerConfig
from steerd.controller.design import assess, find_faults
from steerd.controller.gain_table import N_TURNING
from steerd.controller.lane_controller import control, start_controller
from steerd.controller.live import (
    AS_DESIGNED,
    GAIN_LEAST,
    GAIN_MOST,
    LiveValues,
    approach,
    find_gain_bounds,
    limit_target,
    make_live_bounds,
    shift_curvature,
    shift_lane,
)

CIRCLE = parse_path("circle:radius=2")
AT = State(2.1, 0.3, 1.8, 0.9, 0.4, 0.01, 0.15)


def make(speed=1.5, path=CIRCLE, car=DEFAULT_CAR, **config):
    return make_controller(car, path, ControllerConfig(speed=speed, **config), 100.0)


def bounds_of(made, offset_max=0.15):
    path, timing = made.keeper.path, made.report.timing
    return make_live_bounds(made.car, path, made.config, made.table, timing, offset_max)


def tick(made, live, **more):
    state = start_controller(made, AT, 0)
    return control(made, state, AT, 10_000_000, live=live, **more)


def test_nothing_changed_changes_no_bit():
    made = make()
    plain = control(made, start_controller(made, AT, 0), AT, 10_000_000)
    assert tick(made, AS_DESIGNED) == plain
    assert tick(made, bounds_of(made).start) == plain


def test_the_designs_own_share_lies_within_bounds_that_pass_the_designs_check():
    made = make()
    timing, damping = made.report.timing, made.config.damping_min
    low, high = find_gain_bounds(made.car, made.table, timing, damping)
    assert GAIN_LEAST <= low <= 1.0 <= high <= GAIN_MOST
    for share in (low, high):
        rows = [
            tuple(share * v for v in row[:-N_TURNING]) + row[-N_TURNING:] for row in made.table.rows
        ]
        scaled = made.table._replace(rows=tuple(rows))
        assert not find_faults(assess(made.car, scaled, timing), damping)


def test_a_loop_with_little_margin_grants_less_and_none_grants_nothing():
    made = make(3.0)
    late = made.report.timing._replace(delay_s=made.report.timing.delay_s + 0.1)
    wide = find_gain_bounds(made.car, made.table, made.report.timing, 0.1)
    assert wide[1] - wide[0] > 0.5
    narrow = find_gain_bounds(made.car, made.table, late, 0.1)
    assert narrow[1] < wide[1]
    assert find_gain_bounds(made.car, made.table, made.report.timing, 0.999) == (1.0, 1.0)


def test_speed_only_falls_and_no_start_is_below_its_least():
    bounds = bounds_of(make(1.5))
    assert (bounds.low.speed, bounds.high.speed) == (0.3, 1.5)
    slow = bounds_of(make(0.2))
    assert (slow.low.speed, slow.high.speed) == (0.2, 0.2)


def test_a_lane_that_the_car_cannot_turn_is_not_granted():
    free = bounds_of(make())
    assert (free.low.offset, free.high.offset) == (-0.15, 0.15)
    tight = bounds_of(make(0.8, parse_path("circle:radius=1.35")), 0.5)
    assert tight.low.offset == pytest.approx(-0.5), "outwards the turn is wider"
    assert 0.0 < tight.high.offset < 0.45
    wheel = max(row[-N_TURNING] for row in make(0.8).table.rows)
    turned = wheel * shift_curvature(1 / 1.35, tight.high.offset)
    assert turned <= DEFAULT_CAR.steer_max


def test_a_shifted_circle_is_the_circle_beside_it():
    at = shift_lane(project(CIRCLE, 1.9, 0.0, 0), 0.1)
    beside = parse_path("circle:radius=1.9")
    own = project(beside, 1.9 * beside.x[0] / 1.9, 0.0, 0)
    assert at.curvature == pytest.approx(own.curvature, rel=1e-6)
    offsets = project(CIRCLE, 1.9, 0.0, 0).e1
    assert at.e1 == pytest.approx(offsets - 0.1)


def test_in_a_tighter_lane_the_lateral_acceleration_stays():
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
