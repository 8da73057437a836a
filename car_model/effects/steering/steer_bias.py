"""Steering trim: the wheels do not point straight at command zero."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """More wheel angle at command zero, within the same end stops."""
    return car._replace(steer_bias=car.steer_bias + p[0])


EFFECT = Effect(
    name="steer_bias",
    stage=Stage.COMMAND,
    family="steering",
    summary="the wheels are off centre at command zero (trim)",
    equation="aim = clip(steer_gain cmd + steer_bias + bias)",
    parameters=(
        EffectParameter("bias", 0.0, -0.15, 0.15, "rad", 0.02, "trim beyond the car's own"),
    ),
    least_size=0.0006,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("steer_bias",),
    car=_car,
    aliases=("trim", "steer_trim", "steer_offset"),
)
