"""A mocap body whose forward axis is not the car's."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.state import Observation, State


def _observe(ops: Ops[T], p: Sequence[T], state: State[T], seen: Observation[T]) -> Observation[T]:
    """A heading with an offset."""
    return seen._replace(yaw=seen.yaw + p[0])


EFFECT = Effect(
    name="mocap_yaw",
    stage=Stage.OBSERVE,
    family="sensor",
    summary="the mocap body's heading is off the car's",
    equation="yaw_seen = yaw + offset",
    parameters=(
        EffectParameter("offset", 0.0, -0.3, 0.3, "rad", 0.02, "body's heading in the car"),
    ),
    least_size=0.0012,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    observe=_observe,
    aliases=("yaw_misalignment", "mount_yaw", "yaw_offset"),
)
