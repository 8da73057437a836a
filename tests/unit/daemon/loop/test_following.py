"""Bands of motion after orders: their ends against closed forms, and what is compared with them."""

from math import exp, inf, nan, pi, sqrt, tan

import pytest

from steerd.car_model.params import DEFAULT_CAR, Car
from steerd.car_model.state import Command
from steerd.daemon.loop import follow_model as fm
from steerd.daemon.loop import following as fo
from steerd.daemon.loop.follow_model import LATE_S, UNKNOWN, Band, make_follow_model
from steerd.daemon.loop.following import Followed, FollowState, Mark, Turn, compare
from steerd.daemon.settings.thresholds import Thresholds
from steerd.estimator.config import FilterConfig
from steerd.steer_bus.quick_values import changed
from tests.unit.daemon.loop.watching import seen

MS = 1_000_000
TH = Thresholds(follow_hold=0.0625, follow_distance=0.125, follow_noise=4.0, follow_steer=0.02)
CAR = DEFAULT_CAR._replace(
    lf=0.15, lr=0.25, c_sf=5.0, c_sr=4.0, mu=0.8, steer_delay=0.05, steer_lag=0.1, steer_rate=2.0,
    speed_lag=0.2, drive_delay=0.1, accel_max=4.0, decel_max=3.0, steer_min=-0.3, steer_max=0.4,
)  # fmt: skip
KNOWN = dict.fromkeys(Car._fields, 0.0)


def make_model():
    return make_follow_model(CAR, KNOWN, FilterConfig(), TH)


@pytest.fixture
def model():
    """Made anew in each test: a mutant of a function that ran on import would go unseen."""
    return make_model()


def near(low, high):
    return Band(pytest.approx(low), pytest.approx(high))


def go(orders, until_ms, model=None, step_ms=10, speed=1.0, start=0.0):
    """The state after orders {ms: order}, ticked at a step."""
    state, model = FollowState(), model or make_model()
    for ms in range(0, until_ms + 1, step_ms):
        state = fo.advance(state, model, ms * MS, speed)
        if ms in orders:
            state = fo.send_order(state, model, ms * MS, orders[ms], start)
    return state


@pytest.mark.parametrize(("speed", "span"), [
    (0.0, 0.0625), (2.0, 0.0625), (-2.0, 0.0625), (4.0, 0.03125), (-4.0, 0.03125), (nan, 0.0625),
])  # fmt: skip
def test_an_order_may_be_missed_for_a_time_and_for_a_distance(speed, span):
    assert fo.follow_span(TH, speed) == span


def test_ranges_of_an_identified_car():
    m = make_model()
    assert m.drive.lag == near(0.16, 0.24)
    assert m.drive.slew == near(3.2, 4.8)
    assert m.drive.fall == near(2.4, 3.6)
    assert m.drive.delay == near(0.08, 0.12 + LATE_S)
    assert m.servo.lag == near(0.08, 0.12)
    assert m.servo.slew == m.servo.fall == near(1.6, 2.4)
    assert m.servo.delay == near(0.04, 0.06 + LATE_S)
    assert m.gain == near(0.8, 1.2)
    assert (m.left, m.right) == (near(0.32, 0.48), near(-0.36, -0.24))
    together = 0.2 * (sqrt(2.0) - 1.0)
    assert m.base == near(0.4 * (1.0 - together), 0.4 * (1.0 + together))
    assert m.bias == 0.0
    assert m.slack == 0.02
    soft, stiff = 1.0 / (9.81 * 0.8 * 0.64), 1.0 / (9.81 * 0.8 * 1.44)
    assert m.understeer == near(stiff / 5.0 - soft / 4.0, soft / 5.0 - stiff / 4.0)
    assert m.speed_margin == pytest.approx(4.0 * 0.03)
    assert m.turn_margin == pytest.approx(4.0 * sqrt(2.0) * 0.002)


def test_yaw_settles_with_the_slower_of_its_two_motions(model):
    weight = 0.8 * CAR.mass * 9.81
    front, rear = 5.0 * weight * 0.25 / 0.4, 4.0 * weight * 0.15 / 0.4
    turning = CAR.inertia_z / (front * 0.15**2 + rear * 0.25**2)
    assert model.settling == pytest.approx(1.4 * max(turning, CAR.mass / (front + rear)))
    slow = make_follow_model(CAR._replace(inertia_z=1.0), KNOWN, FilterConfig(), TH)
    assert slow.settling == pytest.approx(1.4 / (front * 0.15**2 + rear * 0.25**2))
    slippery = make_follow_model(CAR._replace(inertia_z=1e-3), KNOWN, FilterConfig(), TH)
    assert slippery.settling == pytest.approx(1.4 * CAR.mass / (front + rear))


def test_what_was_never_identified_may_be_off_by_a_factor(model):
    m = make_follow_model(CAR, {}, FilterConfig(), TH)
    assert m.drive.lag == near(0.2 / UNKNOWN, 0.2 * UNKNOWN)
    assert m.drive.slew == near(4.0 / UNKNOWN, 4.0 * UNKNOWN)
    assert m.drive.fall == near(3.0 / UNKNOWN, 3.0 * UNKNOWN)
    assert m.drive.delay == near(0.1 / UNKNOWN, 0.3 + LATE_S)
    assert m.servo.delay == near(0.05 / UNKNOWN, 0.15 + LATE_S)
    assert m.slack == fm.UNKNOWN_BIAS
    wide = make_follow_model(CAR, {}, FilterConfig(), Thresholds(follow_steer=0.08))
    assert wide.slack == 0.08
    for known, late in (({}, fm.UNKNOWN_LATE_S), (KNOWN, LATE_S), ({"drive_delay": 0.0}, LATE_S)):
        prompt = make_follow_model(CAR._replace(drive_delay=0.0), known, FilterConfig(), TH)
        assert prompt.drive.delay == near(0.0, late), "identified as none, it is believed"
    assert m.gain == model.gain


def test_a_large_standard_error_widens_the_range_and_noise_never_switches_it_off():
    m = make_follow_model(CAR, {**KNOWN, "speed_lag": 0.02, "steer_lag": 0.05}, FilterConfig(), TH)
    assert (m.drive.lag, m.servo.lag) == (near(0.14, 0.26), near(0.0, 0.25))
    loud = FilterConfig(wheel_speed_sd=10.0, pose_yaw_sd=1.0)
    m = make_follow_model(CAR, KNOWN, loud, TH)
    assert (m.speed_margin, m.turn_margin) == (fm.SPEED_MARGIN_MAX, fm.TURN_MARGIN_MAX)


def test_nothing_is_compared_without_orders(model):
    assert fo.advance(FollowState(), model, 5 * MS, 1.0) == FollowState()
    assert compare(FollowState(), model, (0, 9.0), (Turn(0, 1, 3.0, 1.0),)) == Followed()
    state = go({0: Command(0.1, 1.0)}, 300)
    assert fo.send_order(state, model, 310 * MS, None, 0.5) == FollowState()


@pytest.mark.parametrize(("rolling", "band"), [(0.5, (0.0, 0.5)), (-0.5, (-0.5, 0.0))])
def test_the_first_order_starts_at_the_measured_speed_with_the_steering_anywhere(
    model, rolling, band
):
    order = Command(0.1, 1.0)
    state = fo.send_order(FollowState(), model, 7, order, rolling)
    assert state.orders == ((7, order),)
    assert state.trail == (Mark(7, Band(*band), Band(0.0, 0.0)),)
    assert state.steer == Band(model.right.low, model.left.high)
    short = model.base.low + model.understeer.low * 0.25
    assert state.curvature == near(tan(-0.36 - 0.02) / short, tan(0.48 + 0.02) / short)


@pytest.mark.parametrize(("bias", "wish", "band"), [
    (0.0, 0.1, (0.08, 0.12)), (0.0, 0.5, (0.32, 0.48)), (0.0, -0.5, (-0.36, -0.24)),
    (0.05, -0.1, (-0.07, -0.03)),
], ids=["gain", "left end stop", "right end stop", "bias"])  # fmt: skip
def test_both_ends_come_to_rest_on_the_order(bias, wish, band):
    model = make_follow_model(CAR._replace(steer_bias=bias), KNOWN, FilterConfig(), TH)
    state = go({0: Command(wish, 1.0)}, 4000, model)
    assert state.trail[-1].speed == near(1.0, 1.0)
    assert state.steer == near(*band)
    assert len(state.orders) == 1


@pytest.mark.parametrize(("first", "then", "until_ms", "step_ms", "low", "high"), [
    (3.0, None, 300, 10, 3.2 * (0.3 - 0.132), 4.8 * 0.23),
    (3.0, 1.0, 4400, 10, 3.0 - 3.6 * (0.4 - 0.08), 3.0 - 2.4 * (0.4 - 0.132 - 0.01)),
    (1.0, 0.7, 4200, 2, 1.0 - 0.3 * (1.0 - exp(-0.12 / 0.16)),
     1.0 - 0.3 * (1.0 - exp(-0.068 / 0.24))),
    (2.0, 0.29, 8000, 10, 0.0, 2.0),
    (2.0, 0.3, 9000, 10, 0.3, 0.3),
], ids=["slew limits", "a fall has its own", "0.3 m/s over 0.16 s is below them: the lag",
        "below 0.3 m/s a VESC lets go: it may stand at once or coast for ever",
        "0.3 m/s"])  # fmt: skip
def test_speeds_after_a_change(first, then, until_ms, step_ms, low, high):
    orders = {0: Command(0.0, first)} | ({4000: Command(0.0, then)} if then else {})
    band = go(orders, until_ms, step_ms=step_ms).trail[-1].speed
    near_low = {10: 0.05, 2: 0.004}[step_ms]
    assert band.low == pytest.approx(low, abs=1e-6 if then in (0.29, 0.3) else near_low)
    exact = then is None or then in (0.29, 0.3)
    assert band.high == pytest.approx(high, abs=1e-6 if exact else near_low)


def steady_ends(model, steer, speed):
    """Curvature of the steady turn to the left, or straight on, at both ends."""
    short = max(model.base.low + model.understeer.low * speed**2, 0.5 * model.base.low)
    wide = model.base.high + model.understeer.high * speed**2
    low, high = tan(steer.low - 0.02), tan(steer.high + 0.02)
    return Band(low / (short if low < 0.0 else wide), high / short)


@pytest.mark.parametrize(
    ("speed", "lag"), [(0.04, 0.02), (-0.04, 0.02), (0.5, None), (2.0, None), (-2.0, None)]
)
def test_curvature_grows_at_once_and_falls_with_the_yaw_lag(model, speed, lag):
    """A crawling car turns as its kinematics settle."""
    share = 1.0 - exp(-0.06 / (lag or model.settling * abs(speed)))
    for first, then in ((0.2, 0.0), (0.0, 0.2)):  # a turn to the left ends, and begins
        before = go({0: Command(first, 2.0), 3000: Command(then, 2.0)}, 3090, speed=speed)
        after = fo.advance(before, model, 3150 * MS, speed)
        aim = steady_ends(model, after.steer, speed)
        late, prompt = ("high", "low") if first else ("low", "high")
        ways = {end: getattr(aim, end) - getattr(before.curvature, end) for end in (late, prompt)}
        assert all((way > 0.01) if then else (way < -0.01) for way in ways.values())
        lagging = getattr(before.curvature, late) + share * ways[late]
        assert getattr(after.curvature, late) == pytest.approx(lagging)
        assert getattr(after.curvature, prompt) == pytest.approx(getattr(aim, prompt))


def test_orders_are_forgotten_when_their_successor_has_arrived():
    state = go({k: Command(0.0, 0.5 + 1e-4 * k) for k in range(0, 2001, 10)}, 2000)
    assert state.orders[-1][0] == 2000 * MS
    assert state.orders[0][0] <= (2000 - 132) * MS < state.orders[1][0]


def test_an_order_that_arrives_at_the_tick_counts_from_the_tick_on(model):
    """72 ms after it was sent an order to the servo has surely arrived, and no earlier."""
    straight, anywhere = {0: Command(0.0, 1.0)}, Band(model.right.low, model.left.high)
    assert go(straight, 72, step_ms=8).steer == anywhere
    settled = go(straight, 80, step_ms=8).steer
    assert anywhere.low < settled.low
    assert settled.high < anywhere.high
    again = {**straight, 4000: Command(0.1, 1.0)}
    assert go(again, 4072, step_ms=8).steer.low == pytest.approx(0.0, abs=1e-9)
    assert go(again, 4080, step_ms=8).steer.low > 1e-3


NOW = 4000 * MS


@pytest.mark.parametrize(("speed", "excess"), [(1.0, -0.12), (1.2, 0.08), (0.7, 0.18), (inf, inf)])
def test_wheels_against_the_band_of_their_time(model, speed, excess):
    steady = go({0: Command(0.0, 1.0)}, 4000)
    seen = compare(steady, model, (NOW, speed), ())
    assert seen.speed_excess == pytest.approx(excess)
    assert seen.speed == speed
    assert seen.speed_band == near(1.0, 1.0)
    assert (seen.turn_rate, seen.turn_excess) == (0.0, 0.0)


def test_a_measurement_between_two_ticks_may_lie_in_either_band(model):
    steady = go({0: Command(0.0, 1.0)}, 4000)
    marks = (Mark(0, Band(0.0, 1.0), Band(0, 0)), Mark(10, Band(-1.0, 0.5), Band(0, 0)))
    state = changed(steady, trail=marks)
    for t_ns, high in ((0, 1.0), (5, 1.0), (10, 0.5), (99, 0.5)):
        assert compare(state, model, (t_ns, 0.0), ()).speed_band == Band(-1.0, high)


def test_what_was_measured_before_the_band_began_is_not_judged(model):
    steady = go({0: Command(0.0, 1.0)}, 4000)
    oldest = steady.trail[0].t_ns
    assert compare(steady, model, (oldest - 1, 9.0), ()) == Followed()
    assert compare(steady, model, (oldest, 9.0), ()).speed_excess > 0.0
    assert compare(steady, model, None, (Turn(oldest, NOW, 1.0, 0.1),)).turn_excess > 0.0
    for span in ((oldest - 1, NOW), (oldest, NOW + 1)):
        assert compare(steady, model, None, (Turn(*span, 1.0, 0.1),)) == Followed()


def test_turns_against_the_band_over_the_way(model):
    """1 rad/m at most over 0.2 m in 0.1 s: 2 rad/s, and no less than 1 rad/s."""
    steady = go({0: Command(0.0, 1.0)}, 4000)
    curves = ((0, 1.0, 2.0), (50, 1.025, 2.05), (100, 1.05, 2.1), (200, 1.05, 2.1))
    marks = (Mark(t_ms * MS, Band(0, 0), Band(low, high)) for t_ms, low, high in curves)
    state = changed(steady, trail=tuple(marks))
    margin = model.turn_margin / 0.1

    def over(*turns):
        made = (Turn(from_ms * MS, to_ms * MS, *rest) for from_ms, to_ms, *rest in turns)
        return compare(state, model, None, tuple(made))

    fast = over((0, 100, 0.25, 0.2))
    assert fast.turn_band == near(1.0, 2.0)
    assert fast.turn_rate == pytest.approx(2.5)
    assert fast.turn_excess == pytest.approx(0.5 - margin)
    assert over((0, 100, 0.05, 0.2)).turn_excess == pytest.approx(0.5 - margin)
    assert over((25, 75, 0.05, 0.1)).turn_band == near(1.0, 2.0)
    assert over((0, 100, 0.15, 0.2), (25, 75, 0.2, 0.1)).turn_rate == pytest.approx(4.0)
    assert over((100, 200, 0.0, 0.2)).turn_band == near(0.0, 0.0)


ORIGIN = (0.0, 0.0, 0.1)


def test_turns_are_measured_over_a_short_and_a_long_stretch():
    track = tuple(seen(10 * k * MS, (0.03 * k, 0.04 * k, 0.1), 0.01 * k) for k in range(31))
    short, long = fo.measure_turns(track, 0.05)
    assert short == Turn(250 * MS, 300 * MS, pytest.approx(0.05), pytest.approx(0.25))
    assert long == Turn(150 * MS, 300 * MS, pytest.approx(0.15), pytest.approx(0.75))
    _, longest = fo.measure_turns(track, 0.1)
    assert longest.t0_ns == 300 * MS - round(fo.LONG_TURN_S * 1e9)
    _, early = fo.measure_turns(track[:8], 0.05)
    assert early.t0_ns == 0


def test_a_turn_through_the_back_is_a_small_one_and_one_pose_is_none():
    track = (seen(0, ORIGIN, pi - 0.01), seen(10 * MS, ORIGIN, -pi + 0.01))
    assert [turn.angle for turn in fo.measure_turns(track, 0.01)] == [pytest.approx(0.02)] * 2
    assert fo.measure_turns((), 0.1) == fo.measure_turns((seen(0, ORIGIN),), 0.1) == ()
    assert fo.measure_turns((seen(0, ORIGIN), seen(0, (1.0, 0.0, 0.1))), 0.0) == ()


@pytest.mark.parametrize("late_s", [fo.TRAIL_S - 0.01, fo.TRAIL_S, fo.TRAIL_S + 1e-9, 0.6, 10.0])
def test_a_tick_later_than_the_trail_is_long_goes_on(model, late_s):
    """A machine that stood still: that stops the car as what it is, and as no exception."""
    before = go({0: Command(0.1, 1.0)}, 1000)
    now = before.trail[-1].t_ns + round(late_s * 1e9)
    after = fo.advance(before, model, now, 1.0)
    assert after.trail[-1].t_ns == now
    assert after.trail[-2] == before.trail[-1]
    assert abs(compare(after, model, (now, 1.0), ()).speed_excess) < 1.0
