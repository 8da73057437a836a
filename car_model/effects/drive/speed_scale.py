"""A wheel that is larger or smaller than the motor controller's gain says.

True speed changes against the command and against the reported wheel speed alike, so the reported
speed stays true to the command.
"""

from collections.abc import Sequence

from steerd.car_model.effect import (
    BaseSelection,
    Channel,
    Confounding,
    Effect,
    EffectParameter,
    Stage,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import Observation, State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """More true speed for the same command."""
    return car._replace(speed_gain=car.speed_gain * p[0])


def _observe(ops: Ops[T], p: Sequence[T], state: State[T], seen: Observation[T]) -> Observation[T]:
    """Wheel speed in the motor controller's own measure."""
    return seen._replace(wheel_speed=seen.wheel_speed / p[0])


EFFECT = Effect(
    name="speed_scale",
    stage=Stage.COMMAND,
    family="drive",
    summary="wheel radius or gear differ from the speed gain in use",
    equation="speed aim = scale speed_gain cmd; wheel_speed = speed / (scale speed_gain)",
    parameters=(
        EffectParameter("scale", 1.0, 0.6, 1.5, "1", 0.05, "true speed per modelled true speed"),
    ),
    least_size=0.0032,
    confounded_with=Confounding(
        ("rolling_drag",),
        "rolling_drag at a single speed",
    ),
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("speed_gain",),
    car=_car,
    observe=_observe,
    aliases=("erpm_gain", "wheel_radius", "speed_gain"),
)
