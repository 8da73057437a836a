"""Effects of the tyres: stiffness, grip, build-up, slip."""

from functools import partial

from steerd.car_model.chassis import SPEED_KINEMATIC, Axles, Rates, dynamic_share
from steerd.car_model.effect import (
    Channel,
    Confounding,
    Contact,
    Effect,
    EffectParameter,
    Role,
    Stage,
    Values,
    scale,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car
from steerd.car_model.state import State

_BEND_LEAST = 0.25
"""Keeps the square root real where a fit tries tyres that stiffen: at most twice the force."""
_ROUND = 0.05  # rounds off the corner of `|z|` at zero


def _smooth_size(ops: Ops[T], z: T) -> T:
    """`|z|`, smooth at zero."""
    size: T = ops.sqrt(z * z + _ROUND * _ROUND) - _ROUND
    return size


def _saturated(ops: Ops[T], force: T, z: T, q: T, early: T | float = 0.0) -> T:
    """`force / sqrt(1 + q (z^2 + early |z|))`: the linear force levels off at `mu Fz / sqrt(q)`.

    `z = C_S slip` is the linear force per friction limit. Like tanh(sqrt(q) z) / sqrt(q) it has one
    parameter, slope 1 at zero slip and a plateau, but it is analytic in `q` at 0, where it is the
    linear tyre exactly, with gradient -z^3 / 2.

    A brush tyre slides at the rear edge of its contact patch from the first slip on, so that the
    slope at zero is larger than any secant (Pacejka, Tire and Vehicle Dynamics, section 3.2): that
    is `early`, 0.5 (with q 1.7) for brushes that slide as a whole at 0.6 mu Fz.
    """
    bend = q * (z * z + early * _smooth_size(ops, z))
    level: T = force / ops.sqrt(ops.maximum(1.0 + bend, _BEND_LEAST))
    return level


CORNERING_STIFFNESS = Effect(
    name="cornering_stiffness",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyres are stiffer or softer than modelled",
    equation="C_Sf, C_Sr -> ratio C_Sf, ratio C_Sr",
    parameters=(
        EffectParameter("ratio", 1.0, 0.25, 3.0, "1", 0.2, "stiffness per modelled stiffness"),
    ),
    least_size=0.034,
    confounded_with=Confounding(
        ("tyre_friction",), "tyre_friction below about 70 % of the limit", alike=True
    ),
    car=partial(scale, ("c_sf", "c_sr")),
    aliases=("stiffness", "tyre_stiffness"),
)
"""Tyres that are stiffer or softer than modelled, front and rear alike."""


_GRIP_LEAST = 0.01  # some lateral grip stays when the tyres are spinning


def _friction_ellipse_forces(ops: Ops[T], p: Values[T], at: Contact[T]) -> Axles[T]:
    """What each axle's part of the longitudinal force leaves."""
    used = at.accel / (at.car.mu * GRAVITY)
    return Axles(
        at.forces.front * ops.sqrt(ops.maximum(1.0 - p[0] * used * used, _GRIP_LEAST)),
        at.forces.rear * ops.sqrt(ops.maximum(1.0 - p[1] * used * used, _GRIP_LEAST)),
    )


FRICTION_ELLIPSE = Effect(
    name="friction_ellipse",
    stage=Stage.FORCES,
    family="tyre",
    summary="accelerating and braking take lateral grip away",
    equation="F -> F sqrt(1 - share (accel / (mu g))^2), share: front or rear",
    parameters=(
        EffectParameter("front", 0.0, 0.0, 16.0, "1", 0.5, "1: the textbook ellipse at mu"),
        EffectParameter("rear", 0.0, 0.0, 16.0, "1", 0.5, "4: drive and brakes at the rear alone"),
    ),
    least_size=0.16,
    needs_commands=Channel.SPEED,
    on_every_car=True,
    follows_acceleration=True,
    forces=_friction_ellipse_forces,
    aliases=("combined_slip", "friction_circle"),
)  # fmt: skip
"""Lateral grip that acceleration and braking use up.

An axle with all of the force uses twice what it does with half of it: 4 for 1. Needs
hard driving to show: at 3 m/s^2 on a floor of mu 1.05 a full ellipse costs 4 % of the force where
both axles drive alike.
"""


_COEFFICIENT_LEAST = 0.1  # some of the coefficient stays under any load
_MOVED = 0.62  # 2 h / track of the F1TENTH car: CoG 74 mm high on a track of 240 mm


def _lateral_load_transfer_forces(ops: Ops[T], p: Values[T], at: Contact[T]) -> Axles[T]:
    """Weaker with the square of the lateral acceleration, and under the load that braking moves."""
    lateral = (at.forces.front + at.forces.rear) / (at.car.mass * GRAVITY)
    # 1 - k a^2 with a = lateral (1 - k a^2), solved for itself.
    left = 2.0 / (
        1.0 + ops.sqrt(ops.maximum(1.0 + 4.0 * p[0] * lateral * lateral, _COEFFICIENT_LEAST))
    )
    falls = p[0] / (p[1] * p[1])
    per_load = (at.car.lf + at.car.lr) / (at.car.mass * GRAVITY)
    front = 1.0 - falls * (per_load * at.loads.front / at.car.lr - 1.0)
    rear = 1.0 - falls * (per_load * at.loads.rear / at.car.lf - 1.0)
    return Axles(
        ops.maximum(front, _COEFFICIENT_LEAST) * at.forces.front * left,
        ops.maximum(rear, _COEFFICIENT_LEAST) * at.forces.rear * left,
    )


LATERAL_LOAD_TRANSFER = Effect(
    name="lateral_load_transfer",
    stage=Stage.FORCES,
    family="tyre",
    summary="grip falls as load moves to the outer wheels",
    equation="F -> F (1 - k / moved^2 (Fz / Fz0 - 1)) (1 - k (a_y / g)^2)",
    parameters=(
        EffectParameter("k", 0.0, 0.0, 5.0, "1", 0.5, "grip lost per (a_y / g)^2"),
        EffectParameter("moved", _MOVED, 0.3, 1.5, "1", 0.1,
                        "load moved at 1 g per load of a side: 2 h / track", role=Role.FORM),
    ),
    least_size=0.4,
    confounded_with=Confounding(
        ("tyre_friction",), "tyre_friction: less grip in hard bends", alike=True
    ),
    on_every_car=True,
    forces=_lateral_load_transfer_forces,
    aliases=("lateral_transfer", "roll_transfer"),
)  # fmt: skip
"""Grip lost because the outer wheels carry more and the inner less: mu falls with load.

A tyre's coefficient falls with its load, mu (1 - e (Fz / Fz0 - 1)). Across the car the two wheels
of an axle then lose e s^2 (a_y / g)^2 together, where s is the load that a lateral acceleration of
1 g moves per side: k = e s^2. Along the car the same tyre gives back less (or more) than the load
that moves between the axles. Near a bend's steady state it looks like friction; the lateral
acceleration a_y is the one that the weakened tyre forces give.
"""


def _scrub_rates(ops: Ops[T], p: Values[T], at: Contact[T], rates: Rates[T]) -> Rates[T]:
    """Yaw damping and drag, fading out at crawling speed with the forces themselves."""
    share = dynamic_share(ops, at.state.speed)
    slip = at.state.slip_angle
    back = (at.forces.front * (at.wheel - slip) - at.forces.rear * slip) / at.car.mass
    return rates._replace(
        yaw_rate=rates.yaw_rate - p[0] * share * at.state.yaw_rate,
        speed=rates.speed - p[1] * share * back,
    )


SCRUB = Effect(
    name="scrub",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyres scrub in turns: locked differential, cornering drag",
    equation="d(yaw_rate)/dt -= yaw_damping yaw_rate; d(speed)/dt -= drag F_lat,back / m",
    parameters=(
        EffectParameter("yaw_damping", 0.0, 0.0, 20.0, "1/s", 2.0, "of a locked differential"),
        EffectParameter("drag", 0.0, -1.0, 4.0, "1", 0.5, "1: all slip power taken from speed"),
    ),
    least_size=0.39,
    on_every_car=True,
    rates=_scrub_rates,
    aliases=("locked_differential", "corner_drag", "tyre_scrub"),
)
"""Tyres dragged sideways in a turn: a locked differential, and cornering drag.

A locked differential turns the left and right wheel alike, which holds the car straight: a yaw
moment against the yaw rate. Lateral forces also have a part that points back along the path; with
`drag` 1 it takes exactly the power that the tyres lose in slip.
"""


def _tyre_balance_car(ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The ratio of the coefficients changed, their geometric mean kept."""
    root = ops.sqrt(p[0])
    return car._replace(c_sf=car.c_sf * root, c_sr=car.c_sr / root)


TYRE_BALANCE = Effect(
    name="tyre_balance",
    stage=Stage.FORCES,
    family="tyre",
    summary="front tyres grip more against rear tyres than modelled",
    equation="C_Sf / C_Sr -> ratio C_Sf / C_Sr",
    parameters=(EffectParameter("ratio", 1.0, 0.35, 3.0, "1", 0.2, "front to rear, per modelled"),),
    least_size=0.029,
    car=_tyre_balance_car,
    aliases=("balance", "front_balance"),
)
"""Front tyres stiffer than modelled and rear tyres softer, or the other way round."""


SLOPE = EffectParameter(
    "slope", 0.0, 0.0, 1.0, "1", 0.5,
    "0: as stiff at small slip as before; 1: less stiff by the same ratio", role=Role.FORM,
)  # fmt: skip
"""How far the stiffness at small slip follows friction.

A brush is as stiff on ice as on rubber until it slides (Pacejka, Tire and Vehicle Dynamics, section
4.2, the similarity method: `F(slip) = ratio F0(slip / ratio)`); dust between them softens it too.
On tyres that never level off only the slope shows.
"""


def with_friction(car: Car[T], ratio: T, slope: T) -> Car[T]:
    """Another friction; the coefficients are stiffnesses per friction, so they change too."""
    per_friction = (1.0 - slope * (1.0 - ratio)) / ratio
    return car._replace(
        mu=car.mu * ratio,
        c_sf=car.c_sf * per_friction,
        c_sr=car.c_sr * per_friction,
        c_x=car.c_x * per_friction,
    )


def _tyre_friction_car(ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The same everywhere and all the time."""
    return with_friction(car, p[0], p[1])


TYRE_FRICTION = Effect(
    name="tyre_friction",
    stage=Stage.FORCES,
    family="tyre",
    summary="the floor grips less (or more) than modelled",
    equation="mu -> ratio mu, mu C_S -> (1 - slope (1 - ratio)) mu C_S",
    parameters=(
        EffectParameter("ratio", 1.0, 0.2, 1.3, "1", 0.2, "friction per modelled friction"),
        SLOPE,
    ),
    least_size=0.02,
    confounded_with=Confounding(
        ("cornering_stiffness", "lateral_load_transfer"),
        "cornering_stiffness below about 70 % of the limit, lateral_load_transfer above it",
        alike=True,
    ),
    in_base=False,
    car=_tyre_friction_car,
    aliases=("friction", "mu", "grip", "low_friction"),
)  # fmt: skip
"""A floor with another grip: where tyres level off scales with it, their stiffness in part."""
# Why: docs/decisions/vehicle-model.md#d7


_TINY = 1e-7
"""A length this short has relaxed within any step: the exponential underflows to zero [m]."""


def _tyre_relaxation_slips(
    ops: Ops[T], p: Values[T], memory: Values[T], slips: Axles[T]
) -> Axles[T]:
    """Slip that the tyres feel: the steady one and the deviation."""
    return Axles(slips.front + memory[0], slips.rear + memory[1])


def _tyre_relaxation_remember(
    ops: Ops[T],
    p: Values[T],
    memory: Values[T],
    speed: T,
    before: Axles[T],
    after: Axles[T],
    h: float,
) -> tuple[T, ...]:
    """Each axle's deviation after the step."""
    rolling = ops.maximum(ops.absolute(speed), SPEED_KINEMATIC)
    kept = ops.exp(-h * rolling / ops.maximum(p[0], _TINY))
    gained = (p[0] / (h * rolling)) * (1.0 - kept)
    return (
        memory[0] * kept - (after.front - before.front) * gained,
        memory[1] * kept - (after.rear - before.rear) * gained,
    )


TYRE_RELAXATION = Effect(
    name="tyre_relaxation",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyre force builds up over a rolled distance",
    equation="(length / speed) d(felt slip)/dt = slip - felt slip",
    parameters=(
        EffectParameter("length", 0.0, 0.0, 0.5, "m", 0.05, "distance to 63 % of the force"),
    ),
    least_size=0.003,
    on_every_car=True,
    memory=2,
    slips=_tyre_relaxation_slips,
    remember=_tyre_relaxation_remember,
    aliases=("relaxation", "relaxation_length"),
)
"""Tyres that must roll a distance before their force has built up.

The memory is the felt slip's deviation `d` from the steady slip, `d' = -(v / length) d - slip'`,
solved exactly over each step for a steady slip that changes linearly; at length 0 it stays zero.
"""


def _tyre_saturation_forces(ops: Ops[T], p: Values[T], at: Contact[T]) -> Axles[T]:
    """Both axles' forces, levelled off."""
    return Axles(
        _saturated(ops, at.forces.front, at.car.c_sf * at.slips.front, p[0], p[1]),
        _saturated(ops, at.forces.rear, at.car.c_sr * at.slips.rear, p[0], p[1]),
    )


TYRE_SATURATION = Effect(
    name="tyre_saturation",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyre forces level off at large slip",
    equation="F = mu Fz z / sqrt(1 + q (z^2 + early |z|)), z = C_S slip",
    parameters=(
        EffectParameter("q", 0.0, 0.0, 12.0, "1", 1.0,
                        "1: plateau at mu Fz; 4: at half of it; 0: never"),
        EffectParameter("early", 0.0, 0.0, 4.0, "1", 0.5, "0.5: brushes; 0: straight at first",
                        role=Role.FORM),
    ),
    least_size=0.2,
    changes=False,
    on_every_car=True,
    forces=_tyre_saturation_forces,
    aliases=("saturation", "pacejka"),
)  # fmt: skip
"""Tyres whose lateral force levels off instead of growing for ever with slip."""


def _wheel_slip_rates(ops: Ops[T], p: Values[T], at: Contact[T], rates: Rates[T]) -> Rates[T]:
    """The state's speed is the wheels'; the car moves by what slip leaves of it."""
    kept = 1.0 - p[0] * rates.speed
    return rates._replace(x=rates.x * kept, y=rates.y * kept)


WHEEL_SLIP = Effect(
    name="wheel_slip",
    stage=Stage.FORCES,
    family="drive",
    summary="driven wheels slip as they accelerate and brake the car",
    equation="(dx/dt, dy/dt) -> (1 - slip d(speed)/dt) (dx/dt, dy/dt)",
    parameters=(
        EffectParameter("slip", 0.0, 0.0, 0.1, "s^2/m", 0.005,
                        "slip per acceleration: 1 / (mu g C)"),
    ),
    least_size=0.004,
    needs_commands=Channel.SPEED,
    on_every_car=True,
    follows_acceleration=True,
    built_into=("planar",),
    rates=_wheel_slip_rates,
    aliases=("longitudinal_slip",),
)  # fmt: skip
"""Driven wheels that turn faster than the car moves while they accelerate it, slower in braking.

A tyre's longitudinal force needs slip, F_x = mu Fz C kappa, so wheels that give an acceleration a
turn by the share a / (mu g C) faster: 0.0045 a for C = 22. Seen from the poses the car lags its
speed command and its reported wheel speed by slip x speed, a few milliseconds, which otherwise
passes for a late pose.
"""
