"""A slower speed loop."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The speed loop's time constant, longer."""
    return car._replace(speed_lag=car.speed_lag + p[0])


EFFECT = Effect(
    name="drive_lag",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="speed follows its command more slowly than the model's",
    equation="(speed_lag + lag) d(speed)/dt = aim - speed",
    parameters=(
        EffectParameter("lag", 0.0, -0.2, 0.6, "s", 0.08, "time constant beyond the car's own"),
    ),
    least_size=0.0055,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("speed_lag",),
    car=_car,
    aliases=("motor_lag", "speed_lag", "esc_lag"),
)
