"""A floor that is not level: gravity pulls the same way in the world, whatever the heading.

Along the path it has to spin up wheels and motor as well as move the car, across it has not.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import SPEED_KINEMATIC, Axles, Rates, dynamic_share
from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Role, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car
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
    """Along the path it changes speed, across it slip; crawling wheels hold the car sideways."""
    course = state.yaw + state.slip_angle
    along, across = ops.cos(course), ops.sin(course)
    pull = GRAVITY * (p[0] * along + p[1] * across)
    push = GRAVITY * (p[1] * along - p[0] * across)
    speed = ops.maximum(state.speed, SPEED_KINEMATIC)
    return rates._replace(
        speed=rates.speed + pull / (1.0 + p[2]),
        slip_angle=rates.slip_angle + dynamic_share(ops, state.speed) * push / speed,
    )


EFFECT = Effect(
    name="floor_slope",
    stage=Stage.FORCES,
    family="ground",
    summary="the floor is not level",
    equation="acceleration += g (x, y) in the world, along the path / (1 + spinning)",
    parameters=(
        EffectParameter("x", 0.0, -0.1, 0.1, "rad", 0.01, "downhill towards world x"),
        EffectParameter("y", 0.0, -0.1, 0.1, "rad", 0.01, "downhill towards world y"),
        EffectParameter(
            "spinning",
            0.0,
            0.0,
            1.0,
            "1",
            0.15,
            "inertia of wheels and motor per mass of the car",
            role=Role.FORM,
        ),
    ),
    least_size=0.004,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    rates=_rates,
    aliases=("slope", "tilt"),
)
