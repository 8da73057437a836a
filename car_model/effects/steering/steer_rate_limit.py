"""A servo that turns no faster than so.

Below the limit it changes nothing, so its gradient at the null is zero: it must be looked for with
a scan.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The lower of the car's slew limit and this one."""
    return car._replace(steer_rate=ops.minimum(car.steer_rate, p[0]))


EFFECT = Effect(
    name="steer_rate_limit",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the servo turns no faster than its slew rate",
    equation="|d(steer)/dt| <= rate",
    parameters=(
        EffectParameter(
            "rate",
            50.0,
            0.2,
            50.0,
            "rad/s",
            45.0,
            "largest speed of the wheel angle",
            scan=(0.5, 0.8, 1.2, 1.6, 2.0, 2.5, 3.0, 4.0),
        ),
    ),
    least_size=0.0,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=True,
    same_as=("steer_rate",),
    car=_car,
    aliases=("rate_limit", "slew_limit", "steer_slew"),
)
