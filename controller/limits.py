"""The output limiter, the last stage before the wire: every order stays within the car's limits.

A pure function over a small frozen state, in this order: finite? -> absolute -> lateral
acceleration -> rate, first for the steering, then for the speed. The rate comes last because it
must hold for every sequence of orders: where the tyre's limit falls faster than the servo may turn,
the order moves towards it at full rate and the speed is taken back instead. A number that is not
finite is never clipped, it is a verdict and the caller brakes.

Source: `docs/reference/safety-requirements.md#s4.1`; lateral acceleration as ISO 11270, rates as
F1TENTH's throttle interpolator.
"""

# Why: docs/decisions/safety.md#d11

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import IntEnum
from math import atan, isfinite, sqrt, tan
from typing import Annotated, NamedTuple, get_type_hints

from steerd.car_model.state import Command
from steerd.steer_bus.quick_values import quick_value


class LimitError(ValueError):
    """A car file asks for more than the compiled-in ceilings allow."""


class Bound(NamedTuple):
    """Closed range that a configured number must stay in, and its unit for people."""

    low: float
    high: float
    unit: str


def find_out_of_bounds(values: Mapping[str, float], bounds: Mapping[str, Bound]) -> tuple[str, ...]:
    """Name every value outside its bound, one sentence each; NaN is outside every bound."""
    return tuple(
        f"{name} = {values[name]:g} {bound.unit} is outside {bound.low:g}..{bound.high:g}"
        f" {bound.unit}: the car file may tighten this limit, never exceed it"
        for name, bound in bounds.items()
        if not bound.low <= values[name] <= bound.high
    )


def find_bounds(cls: type[object]) -> Mapping[str, Bound]:
    """Ranges and units as the annotations of a class state them."""
    hints = get_type_hints(cls, include_extras=True).items()
    return {name: hint.__metadata__[0] for name, hint in hints if hasattr(hint, "__metadata__")}


@dataclass(frozen=True, slots=True)
class Limits:
    """What an order may be; cannot be made beyond the compiled-in ceilings.

    Raises:
        LimitError: with one line for each value outside ``CEILINGS``.
    """

    wheelbase: Annotated[float, Bound(0.05, 1.0, "m")]  # distance between the axles
    # Largest steering angles to the left and to the right, both positive
    steer_left_max: Annotated[float, Bound(0.01, 0.6, "rad")] = 0.34
    steer_right_max: Annotated[float, Bound(0.01, 0.6, "rad")] = 0.34
    steer_rate_max: Annotated[float, Bound(0.1, 3.2, "rad/s")] = 3.2  # servo rate
    # Largest speed; the smallest is 0, there is no reverse in automatic driving. 6 m/s is where the
    # shortest mocap timeout (50 ms) still means 0.30 m of blind driving
    speed_max: Annotated[float, Bound(0.1, 6.0, "m/s")] = 3.0
    # Growth of the ordered speed, and its fall, which is at least the 1.5 m/s2 of a soft stop
    accel_max: Annotated[float, Bound(0.1, 2.5, "m/s2")] = 2.5
    decel_max: Annotated[float, Bound(1.5, 6.0, "m/s2")] = 4.0
    lateral_accel_max: Annotated[float, Bound(0.1, 3.0, "m/s2")] = 3.0  # v^2 tan(steer) / wheelbase
    # Longest time that a rate is granted for, so a pause does not allow a jump
    step_max: Annotated[float, Bound(0.001, 0.025, "s")] = 0.025

    def __post_init__(self) -> None:
        """Refuse what the ceilings do not allow."""
        problems = find_out_of_bounds(asdict(self), CEILINGS)
        if problems:
            raise LimitError("\n".join(problems))


CEILINGS = find_bounds(Limits)


@quick_value
class LimiterState:
    """The last order that left the limiter, and when [ns]."""

    order: Command[float]
    t_ns: int


class Verdict(IntEnum):
    """The limiter's verdict on an order; ``NOT_FINITE`` is a hard fault."""

    PASSED = 0
    CLIPPED = 1
    NOT_FINITE = 2


@quick_value
class LimitedOrder:
    """Result of the limiter; ``order`` is finite and within the limits whatever the verdict."""

    state: LimiterState
    order: Command[float]
    verdict: Verdict


def make_limiter_state(limits: Limits, order: Command[float], t_ns: int) -> LimiterState:
    """Return the state from which rates are counted, such as centred wheels and the measured speed.

    Raises:
        ValueError: ``order`` is not finite.
    """
    if not (isfinite(order.steer) and isfinite(order.speed)):
        raise ValueError(f"the limiter cannot start from {order}")
    steer = min(max(order.steer, -limits.steer_right_max), limits.steer_left_max)
    return LimiterState(Command(steer, min(max(order.speed, 0.0), limits.speed_max)), t_ns)


def steer_bound(limits: Limits, speed: float) -> float:
    """Largest steering angle [rad] at ``speed`` [m/s]: v^2 tan(steer) / L <= lateral_accel_max."""
    grip = limits.lateral_accel_max * limits.wheelbase
    square = speed * speed
    return atan(grip / square) if square > grip * 1e-6 else 1.6


def speed_bound(limits: Limits, steer: float) -> float:
    """Largest speed [m/s] at ``steer`` [rad]: v^2 tan(steer) / L <= lateral_accel_max."""
    slope = tan(abs(steer))
    grip = limits.lateral_accel_max * limits.wheelbase
    square = limits.speed_max * limits.speed_max
    return sqrt(grip / slope) if slope * square > grip else limits.speed_max


def _limit_steer(limits: Limits, request: float, last: float, speed: float, dt: float) -> float:
    out, bound = request, steer_bound(limits, speed)
    if not -limits.steer_right_max <= out <= limits.steer_left_max:
        out = limits.steer_left_max if out > 0.0 else -limits.steer_right_max
    if not -bound <= out <= bound:
        out = bound if out > 0.0 else -bound
    step = limits.steer_rate_max * dt
    if not last - step <= out <= last + step:
        out = last + step if out > last else last - step
    return out


def _limit_speed(
    limits: Limits, request: float, last: float, cap: float, bound: float, dt: float
) -> float:
    out, high = request, min(cap, limits.speed_max)
    if not 0.0 <= out <= high:
        out = high if out > high else 0.0
    if out > bound:
        out = bound
    low, high = last - limits.decel_max * dt, last + limits.accel_max * dt
    if not low <= out <= high:
        out = high if out > high else low
    return out


def limit_order(
    limits: Limits,
    state: LimiterState,
    request: Command[float],
    speed: float,
    cap: float,
    t_ns: int,
) -> LimitedOrder:
    """The order that may go on the wire, with its verdict.

    Applied twice at one instant it changes nothing more; its rates hold for any sequence. Grip is
    judged at the measured `speed` [m/s]. The supervisor allows `cap` [m/s] now, ``inf`` where it
    has no opinion; NaN and negative values get the verdict ``NOT_FINITE``, which repeats the last
    order: the caller must brake.
    """
    last = state.order
    if (
        not (isfinite(request.steer) and isfinite(request.speed) and isfinite(speed))
        or not cap >= 0.0
    ):
        return LimitedOrder(state, last, Verdict.NOT_FINITE)
    dt = min(max((t_ns - state.t_ns) * 1e-9, 0.0), limits.step_max)
    steer = _limit_steer(limits, request.steer, last.steer, speed, dt)
    bound = speed_bound(limits, steer)
    order = Command(steer, _limit_speed(limits, request.speed, last.speed, cap, bound, dt))
    verdict = Verdict.PASSED if order == request else Verdict.CLIPPED
    return LimitedOrder(LimiterState(order, max(t_ns, state.t_ns)), order, verdict)
