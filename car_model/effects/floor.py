"""Effects of the floor: slope and places or times of less grip."""

from collections.abc import Sequence

from steerd.car_model.chassis import SPEED_KINEMATIC, Rates, dynamic_share
from steerd.car_model.effect import Contact, Effect, EffectParameter, Role, Stage, Values
from steerd.car_model.effects.tyre import SLOPE, with_friction
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car
from steerd.car_model.state import State


def _floor_slope_rates(ops: Ops[T], p: Values[T], at: Contact[T], rates: Rates[T]) -> Rates[T]:
    """Along the path it changes speed, across it slip; crawling wheels hold the car sideways."""
    course = at.state.yaw + at.state.slip_angle
    along, across = ops.cos(course), ops.sin(course)
    pull = GRAVITY * (p[0] * along + p[1] * across)
    push = GRAVITY * (p[1] * along - p[0] * across)
    speed = ops.maximum(at.state.speed, SPEED_KINEMATIC)
    return rates._replace(
        speed=rates.speed + pull / (1.0 + p[2]),
        slip_angle=rates.slip_angle + dynamic_share(ops, at.state.speed) * push / speed,
    )


FLOOR_SLOPE = Effect(
    name="floor_slope",
    stage=Stage.FORCES,
    family="ground",
    summary="the floor is not level",
    equation="acceleration += g (x, y) in the world, along the path / (1 + spinning)",
    parameters=(
        EffectParameter("x", 0.0, -0.1, 0.1, "rad", 0.01, "downhill towards world x"),
        EffectParameter("y", 0.0, -0.1, 0.1, "rad", 0.01, "downhill towards world y"),
        EffectParameter("spinning", 0.0, 0.0, 1.0, "1", 0.15,
                        "inertia of wheels and motor per mass of the car", role=Role.FORM),
    ),
    least_size=0.004,
    rates=_floor_slope_rates,
    aliases=("slope", "tilt"),
)  # fmt: skip
"""A floor that is not level: gravity pulls the same way in the world, whatever the heading.

Along the path it has to spin up wheels and motor as well as move the car, across it has not.
"""


def _grip_drift_car(ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """Friction that grows with run time."""
    return with_friction(car, ops.exp(p[0] * (t / 60.0)), p[1])


GRIP_DRIFT = Effect(
    name="grip_drift",
    stage=Stage.FORCES,
    family="tyre",
    summary="grip changes over the run",
    equation="mu(t) = mu exp(rate t), slope as of tyre_friction",
    parameters=(EffectParameter("rate", 0.0, -1.0, 1.0, "1/min", 0.1, "growth per minute"), SLOPE),
    least_size=0.27,
    in_base=False,
    at_once=False,
    car=_grip_drift_car,
    aliases=("tyre_warmup", "warm_up"),
)
"""Grip that changes over the run: tyres warm up, dust comes off, or goes on."""


_EDGE = 0.1  # half width of the edge [m]
_SCAN_DROPS = (0.25, 0.5)  # shares of grip lost that a scan tries


def _grip_patch_car(ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """Less friction inside the disc; (d^2 - r^2) / 2r is the distance from its edge, near it."""
    x, y, radius, drop, slope = p
    dx, dy = state.x - x, state.y - y
    outside = (dx * dx + dy * dy - radius * radius) / (2.0 * _EDGE * radius)
    inside = 0.5 * (1.0 - ops.tanh(outside))
    return with_friction(car, 1.0 - drop * inside, slope)


def _grip_patch_scan(discs: Sequence[tuple[float, float, float]]) -> Sequence[tuple[float, ...]]:
    """Discs of two strengths where errors are larger than elsewhere."""
    return [(*disc, drop, 0.5) for disc in discs for drop in _SCAN_DROPS]


GRIP_PATCH = Effect(
    name="grip_patch",
    stage=Stage.FORCES,
    family="ground",
    summary="a slippery patch on the floor",
    equation="mu(x, y) = mu (1 - drop [distance to (x, y) < radius]), slope as of tyre_friction",
    parameters=(
        EffectParameter("x", 0.0, -100.0, 100.0, "m", 2.0, "centre in the world", role=Role.PLACE),
        EffectParameter("y", 0.0, -100.0, 100.0, "m", 2.0, "centre in the world", role=Role.PLACE),
        EffectParameter("radius", 0.5, 0.1, 20.0, "m", 0.5, "of the disc", role=Role.PLACE),
        EffectParameter("drop", 0.0, 0.0, 0.95, "1", 0.3, "share of grip lost inside",
                        scan=(0.2, 0.4, 0.6)),
        SLOPE,
    ),
    least_size=0.0,
    in_base=False,
    at_once=False,
    scan=_grip_patch_scan,
    car=_grip_patch_car,
    aliases=("slippery_patch", "patch"),
)  # fmt: skip
"""A slippery place on the floor: a disc with a soft edge, fixed in the world.

Where it lies has no gradient while it does nothing: look for place and drop together.
"""
