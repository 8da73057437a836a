"""Does the car do as ordered? What cars close to the car file would do, and what this one does.

A car whose parameters lie within a share of the file's moves inside a band; lags and slew rates
that were never identified may be off by a factor instead. The ends of the band follow from
the orders that really left, by comparison: a first-order lag with a slew limit is monotone in its
state and its aim, so the upper end rises as the fastest such car would and falls as the slowest
one, and the lower end the other way round. Speed is compared with the wheels', steering with the
turn of the mocap pose over a short stretch, which knows nothing of the filter. Pure functions over
small tuples.
"""

# Why: docs/decisions/safety.md#d70

from collections.abc import Sequence
from math import exp, hypot, inf, remainder, tan, tau

from steerd.car_model.actuators import LAG_FLOOR
from steerd.car_model.chassis import KINEMATIC_RATE, SPEED_DYNAMIC
from steerd.car_model.state import Command
from steerd.daemon.loop.follow_model import Actuator, Band, FollowModel
from steerd.daemon.loop.supervisor import SOFT_BRAKE_SPEED
from steerd.daemon.settings.thresholds import Thresholds
from steerd.steer_bus.messages import MocapPose
from steerd.steer_bus.quick_values import changed, quick_value

LONG_TURN, LONG_TURN_S = 3.0, 0.2
"""A turn is measured over a short stretch and over this many times as long, at most so long [s]."""
TRAIL_S = 0.35  # how long ends of the bands are kept, for measurements that arrive late [s]
_NS, _SECONDS = 1_000_000_000, 1e-9
_TRAIL_NS = round(TRAIL_S * _NS)
Orders = tuple[tuple[int, Command[float]], ...]
"""Orders with the times at which they left, in their order."""


@quick_value
class Mark:
    """The bands at one moment: speed [m/s], and curvature summed over time [s/m]."""

    t_ns: int
    speed: Band
    turned: Band


@quick_value
class FollowState:
    """Memory between ticks; empty while no speed is ordered."""

    orders: Orders = ()  # that may still take effect, with their times, in order
    steer: Band = Band(0.0, 0.0)  # wheel angle [rad]
    curvature: Band = Band(0.0, 0.0)  # of the path [1/m]
    trail: tuple[Mark, ...] = ()  # the bands lately, the newest last


@quick_value
class Turn:
    """What mocap saw between two poses: times of validity [ns], turn [rad], way [m]."""

    t0_ns: int
    t1_ns: int
    angle: float
    way: float


@quick_value
class Followed:
    """Measurement against band; the excess is above zero where no car of the file does this."""

    # By the wheels [m/s]; `speed_band` what was expected, `speed_excess` beyond it
    speed: float = 0.0
    speed_band: Band = Band(0.0, 0.0)
    speed_excess: float = 0.0
    turn_rate: float = 0.0  # by mocap [rad/s]; the same for it
    turn_band: Band = Band(0.0, 0.0)
    turn_excess: float = 0.0


def follow_span(th: Thresholds, speed: float) -> float:
    """Time [s] over which an order may be missed: `follow_distance` metres, at most `follow_hold`.

    It is also the stretch over which a turn is measured, which then may be missed half as long.
    """
    if not abs(speed) * th.follow_hold > th.follow_distance:
        return th.follow_hold
    return th.follow_distance / abs(speed)


def send_order(
    state: FollowState, model: FollowModel, t_ns: int, order: Command[float] | None, speed: float
) -> FollowState:
    """Remember the order that leaves now; None, a brake or silence, ends the comparison.

    The first one starts it: at the wheels' measured speed, with the steering anywhere.
    """
    if order is None:
        return FollowState()
    if state.orders:
        same = state.orders[-1][1] == order
        return state if same else changed(state, orders=(*state.orders, (t_ns, order)))
    steer = Band(model.right.low, model.left.high)
    start = Band(min(0.0, speed), max(0.0, speed))
    mark = Mark(t_ns, start, Band(0.0, 0.0))
    curvature = _curvature(model, steer, speed)
    return FollowState(((t_ns, order),), steer, curvature, (mark,))


def advance(state: FollowState, model: FollowModel, t_ns: int, speed: float) -> FollowState:
    """Move the bands on to `t_ns`, at a ground speed of `speed` [m/s]."""
    if not state.orders or t_ns <= state.trail[-1].t_ns:
        return state
    last, before = state.trail[-1], state.curvature
    h = (t_ns - last.t_ns) * _SECONDS
    pushed = _aim_speed(state.orders, last.t_ns, t_ns, model.drive, last.speed)
    steered = _aim_steer(state.orders, last.t_ns, t_ns, model, state.steer)
    steer = _step_band(model.servo, state.steer, steered, h)
    bend = _settle(before, _curvature(model, steer, speed), h, _settling(model, speed))
    turned = Band(
        last.turned.low + h * (bend.low if bend.low < before.low else before.low),
        last.turned.high + h * (bend.high if bend.high > before.high else before.high),
    )
    oldest = t_ns - _TRAIL_NS
    # After a tick later than the trail is long, the last mark alone is kept.
    first = 0
    while state.trail[first].t_ns < oldest and state.trail[first] is not last:
        first += 1
    past = first if state.trail[first].t_ns < oldest else first - 1 if first else 0
    mark = Mark(t_ns, _step_band(model.drive, last.speed, pushed, h), turned)
    orders = _still_open(state.orders, t_ns - model.latest_ns)
    return FollowState(orders, steer, bend, (*state.trail[past:], mark))


def compare(
    state: FollowState, model: FollowModel, wheel: tuple[int, float] | None, turns: tuple[Turn, ...]
) -> Followed:
    """Hold the latest measurements against the bands of their own time.

    `wheel` is the time of validity [ns] and speed [m/s] of the last telemetry; of what mocap saw,
    the turn that is furthest off counts.
    """
    trail = state.trail
    if not trail:
        return Followed()
    speed, speed_band, speed_excess = 0.0, _NO_BAND, 0.0
    if wheel is not None and wheel[0] >= trail[0].t_ns:
        speed, speed_band = wheel[1], _speed_at(trail, wheel[0])
        over, under = speed - speed_band.high, speed_band.low - speed
        speed_excess = (over if over > under else under) - model.speed_margin
    begin_ns, end_ns = trail[0].t_ns, trail[-1].t_ns
    worst = _NO_TURN
    t1_ns, last = -1, (0.0, 0.0)
    for turn in turns:
        if turn.t0_ns < begin_ns or turn.t1_ns > end_ns:
            continue
        if turn.t1_ns != t1_ns:  # all of a tick end at its newest pose
            t1_ns, last = turn.t1_ns, _turned_at(trail, turn.t1_ns)
        found = _compare_turn(_turned_at(trail, turn.t0_ns), last, turn, model.turn_margin)
        if worst is _NO_TURN or found[2] > worst[2]:
            worst = found
    return Followed(speed, speed_band, speed_excess, *worst)


_NO_BAND = Band(0.0, 0.0)
_NO_TURN = (0.0, _NO_BAND, 0.0)


def _compare_turn(
    first: tuple[float, float], last: tuple[float, float], turn: Turn, margin: float
) -> tuple[float, Band, float]:
    """Rate of a turn, the band of its time and the excess, all [rad/s]."""
    span = (turn.t1_ns - turn.t0_ns) * _SECONDS
    (low0, high0), (low1, high1) = first, last
    speed = turn.way / span
    band = Band((low1 - low0) / span * speed, (high1 - high0) / span * speed)
    rate = turn.angle / span
    over, under = rate - band.high, band.low - rate
    return rate, band, (over if over > under else under) - margin / span


def measure_turns(track: Sequence[MocapPose], span: float) -> tuple[Turn, ...]:
    """The ways from the newest pose back over `span` [s] and over `LONG_TURN` times as long.

    A large miss shows in the short one at once, a small one in the long one above the noise.
    """
    newest = len(track) - 1
    if newest < 1:
        return ()
    last = track[newest]
    found = []
    for length in (span, min(LONG_TURN * span, LONG_TURN_S)):
        latest = last.t_valid_ns - round(length * _NS)
        at = newest
        while at and track[at].t_valid_ns > latest:
            at -= 1
        first = track[at]
        if first.t_valid_ns < last.t_valid_ns:
            way = hypot(last.x - first.x, last.y - first.y)
            angle = remainder(last.yaw - first.yaw, tau)
            found.append(Turn(first.t_valid_ns, last.t_valid_ns, angle, way))
    return tuple(found)


def _sent(orders: Orders, begin_ns: int, end_ns: int, actuator: Actuator) -> tuple[Orders, bool]:
    """The orders that may act between two moments, and whether the first has surely arrived."""
    earliest = begin_ns - actuator.latest_ns
    latest = end_ns - actuator.soonest_ns
    stop = first = 0
    for sent_ns, _ in orders:
        if sent_ns > latest:
            break
        if sent_ns <= earliest:
            first = stop
        stop += 1
    return orders[first:stop], orders[0][0] <= earliest


def _still_open(orders: Orders, certain_ns: int) -> Orders:
    """The orders without those whose successor has certainly arrived."""
    first, last = 0, len(orders) - 1
    while first < last and orders[first + 1][0] <= certain_ns:
        first += 1
    return orders[first:] if first else orders


def _aim_speed(
    orders: Orders, begin_ns: int, end_ns: int, drive: Actuator, now: Band
) -> tuple[float, float]:
    """What the motor aims at. Slow orders may let it go: then it coasts, however long."""
    acting, sure = _sent(orders, begin_ns, end_ns, drive)
    low, high = (inf, -inf) if sure else (now.low, now.high)
    for _, (_, speed) in acting:
        low = speed if speed < low else low
        high = speed if speed > high else high
    if low < SOFT_BRAKE_SPEED:
        return low if low < 0.0 else 0.0, high if high > now.high else now.high
    return low, high


def _aim_steer(
    orders: Orders, begin_ns: int, end_ns: int, model: FollowModel, now: Band
) -> tuple[float, float]:
    """What the servo aims at, between the end stops."""
    acting, sure = _sent(orders, begin_ns, end_ns, model.servo)
    low, high = (inf, -inf) if sure else (now.low, now.high)
    least, most = model.gain.low, model.gain.high
    for _, (steer, _) in acting:
        one, other = least * steer + model.bias, most * steer + model.bias
        if one > other:
            one, other = other, one
        low = one if one < low else low
        high = other if other > high else high
    right, left = model.right, model.left
    low = right.low if right.low > low else low
    high = right.high if right.high > high else high
    return (left.low if left.low < low else low, left.high if left.high < high else high)


def _step_band(actuator: Actuator, band: Band, aim: tuple[float, float], h: float) -> Band:
    """Both ends after `h` seconds: outwards as fast as any, inwards as slowly as any."""
    a = actuator
    low, high, (aim_low, aim_high) = band.low, band.high, aim
    least, most = a.lag.low, a.lag.high
    quick = 1.0 - exp(-h / (least if least > LAG_FLOOR else LAG_FLOOR))
    slow = 1.0 - exp(-h / (most if most > LAG_FLOOR else LAG_FLOOR))
    if aim_low < low:
        way, most = quick * (low - aim_low), a.fall.high * h
        low -= way if way < most else most
    else:
        way, most = slow * (aim_low - low), a.slew.low * h
        low += way if way < most else most
    if aim_high > high:
        way, most = quick * (aim_high - high), a.slew.high * h
        high += way if way < most else most
    else:
        way, most = slow * (high - aim_high), a.fall.low * h
        high -= way if way < most else most
    return Band(low, high)


def _curvature(model: FollowModel, steer: Band, speed: float) -> Band:
    """Curvature of the steady turn at each end, the tightest and the widest car's."""
    square = speed * speed
    short, shortest = model.base.low + model.understeer.low * square, 0.5 * model.base.low
    short = short if short > shortest else shortest
    long = model.base.high + model.understeer.high * square
    low, high = tan(steer.low - model.slack), tan(steer.high + model.slack)
    return Band(low / (short if low < 0.0 else long), high / (short if high > 0.0 else long))


def _settling(model: FollowModel, speed: float) -> float:
    """Longest time that yaw needs to settle [s]."""
    lag = model.settling * abs(speed)
    crawling = 1.0 / KINEMATIC_RATE if -SPEED_DYNAMIC < speed < SPEED_DYNAMIC else 0.0
    return lag if lag > crawling else crawling


def _settle(now: Band, aim: Band, h: float, lag: float) -> Band:
    """Outwards at once, inwards with the lag: yaw follows the wheels within it."""
    share = 1.0 - exp(-h / lag)
    low = aim.low if aim.low < now.low else now.low + share * (aim.low - now.low)
    high = aim.high if aim.high > now.high else now.high + share * (aim.high - now.high)
    return Band(low, high)


def _around_time(trail: tuple[Mark, ...], t_ns: int) -> tuple[Mark, Mark]:
    """The marks before and after a moment not before the first; the last twice for what is later.

    A trail of one mark gives that one twice.
    """
    after = trail[-1]
    for mark in trail[:0:-1]:
        if mark.t_ns <= t_ns:
            return mark, after
        after = mark
    return trail[0], after


def _speed_at(trail: tuple[Mark, ...], t_ns: int) -> Band:
    before, after = _around_time(trail, t_ns)
    one, other = before.speed, after.speed
    return Band(
        other.low if other.low < one.low else one.low,
        other.high if other.high > one.high else one.high,
    )


def _turned_at(trail: tuple[Mark, ...], t_ns: int) -> tuple[float, float]:
    before, after = _around_time(trail, t_ns)
    low, high = before.turned.low, before.turned.high
    if after.t_ns == before.t_ns:
        return low, high
    part = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
    return low + part * (after.turned.low - low), high + part * (after.turned.high - high)
