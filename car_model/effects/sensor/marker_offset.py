"""A mocap body whose origin is not where the calibration has it on the car."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.state import Observation, State


def _observe(ops: Ops[T], p: Sequence[T], state: State[T], seen: Observation[T]) -> Observation[T]:
    """The pose of a point beside the centre of gravity."""
    c, s = ops.cos(state.yaw), ops.sin(state.yaw)
    return seen._replace(
        x=seen.x + (c * p[0] - s * p[1]),
        y=seen.y + (s * p[0] + c * p[1]),
    )


EFFECT = Effect(
    name="marker_offset",
    stage=Stage.OBSERVE,
    family="sensor",
    summary="the mocap body's origin is off the centre of gravity",
    equation="(x, y)_seen = (x, y) + R(yaw) (forward, left)",
    parameters=(
        EffectParameter("forward", 0.0, -2.0, 2.0, "m", 0.02, "ahead of the CoG"),
        EffectParameter("left", 0.0, -2.0, 2.0, "m", 0.02, "to the left of the CoG"),
    ),
    least_size=0.0038,
    confounded_with=Confounding(
        ("cog_offset",),
        "cog_offset in slow drives",
    ),
    needs_commands=None,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    observe=_observe,
    aliases=("mocap_offset", "lever_arm"),
)
