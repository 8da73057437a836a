"""How the motor's force divides between the axles: differentials and driveline, not the car file.

The chassis says which wheels are driven; an open centre differential, a worn slipper clutch or
tyres of two kinds move the front axle's share. Steered wheels that drive pull the car into the
bend, and they roll along their own direction, `v_x cos(delta) + (v_y + l_f r) sin(delta)`: what
they turn the motor by is not what the rear wheels do.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import SPEED_DYNAMIC, Axles, Rates, dynamic_share
from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _rates(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    state: State[T],
    wheel: T,
    forces: Axles[T],
    rates: Rates[T],
) -> Rates[T]:
    """Less speed over ground and more moment where the front axle drives more."""
    share = dynamic_share(ops, state.speed)
    speed = ops.maximum(state.speed, SPEED_DYNAMIC)
    sine, sideslip = ops.sin(wheel), ops.tan(state.slip_angle)
    felt = rates.speed - state.yaw_rate * state.speed * sideslip
    side = share * p[0] * (car.mass * felt + forces.front * sine) * sine
    rolled = ops.cos(wheel) + (sideslip + car.lf * state.yaw_rate / speed) * sine
    further = 1.0 + p[0] * (rolled - 1.0)
    turn = rates.slip_angle + share * state.yaw_rate
    sideways = side / (car.mass * speed)
    return rates._replace(
        x=rates.x / further,
        y=rates.y / further,
        yaw_rate=rates.yaw_rate + side * car.lf / car.inertia_z,
        slip_angle=rates.slip_angle + share * turn * (further - 1.0) + sideways,
    )


EFFECT = Effect(
    name="drive_split",
    stage=Stage.FORCES,
    family="drive",
    summary="the front axle drives more (or less) than its share",
    equation="F_x,front += front F_x; ground speed /= 1 + front (v_wheel,front / v_x - 1)",
    parameters=(
        EffectParameter("front", 0.0, -1.0, 1.0, "1", 0.25, "share of the drive force, added"),
    ),
    least_size=0.1,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    on_every_car=True,
    zero_gradient=False,
    follows_acceleration=True,
    rates=_rates,
    aliases=("torque_split", "centre_differential"),
)
