"""A slower steering servo."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The servo's time constant, longer."""
    return car._replace(steer_lag=car.steer_lag + p[0])


EFFECT = Effect(
    name="steer_lag",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the servo answers more slowly than the model's",
    equation="(steer_lag + lag) d(steer)/dt = aim - steer",
    parameters=(
        EffectParameter("lag", 0.0, -0.1, 0.4, "s", 0.05, "time constant beyond the car's own"),
    ),
    least_size=0.003,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("steer_lag",),
    car=_car,
    aliases=("servo_lag", "steering_lag"),
)
