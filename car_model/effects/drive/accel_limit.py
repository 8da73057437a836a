"""A motor that cannot speed up or brake as hard as the model's.

Below the limit it changes nothing, so its gradient at the null is zero: it must be looked for with
a scan.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The lower of the car's limits and this one, speeding up and braking."""
    return car._replace(
        accel_max=ops.minimum(car.accel_max, p[0]), decel_max=ops.minimum(car.decel_max, p[0])
    )


EFFECT = Effect(
    name="accel_limit",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="current or ramp limits cap the acceleration",
    equation="|d(speed)/dt| <= limit",
    parameters=(
        EffectParameter(
            "limit",
            20.0,
            0.2,
            20.0,
            "m/s^2",
            16.0,
            "largest acceleration and deceleration",
            scan=(0.5, 1.0, 1.5, 2.0, 3.0, 4.0),
        ),
    ),
    least_size=0.0,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=True,
    same_as=("accel_max", "decel_max"),
    car=_car,
    aliases=("current_limit", "acceleration_limit"),
)
