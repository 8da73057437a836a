"""More or less wheel angle per command than the model's linkage."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The steering gain, scaled."""
    return car._replace(steer_gain=car.steer_gain * p[0])


EFFECT = Effect(
    name="steer_gain",
    stage=Stage.COMMAND,
    family="steering",
    summary="the linkage turns the wheels more or less than modelled",
    equation="aim = clip(gain steer_gain cmd + steer_bias)",
    parameters=(
        EffectParameter("gain", 1.0, 0.5, 1.6, "1", 0.1, "ratio to the car's steering gain"),
    ),
    least_size=0.009,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("steer_gain",),
    car=_car,
    aliases=("steering_gain", "steer_scale"),
)
