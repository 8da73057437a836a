"""A linkage that turns further to one side than to the other."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T


def _linkage(ops: Ops[T], p: Sequence[T], memory: Sequence[T], angle: T) -> tuple[T, tuple[T, ...]]:
    """More gain to the left, as much less to the right."""
    return angle + p[0] * ops.absolute(angle), ()


EFFECT = Effect(
    name="steer_asymmetry",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="left and right turns get different wheel angles",
    equation="wheel = steer + asymmetry |steer|",
    parameters=(
        EffectParameter(
            "asymmetry",
            0.0,
            -0.5,
            0.5,
            "1",
            0.1,
            "gain 1 + this to the left, 1 - this to the right",
        ),
    ),
    least_size=0.0045,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    linkage=_linkage,
    aliases=("left_right_asymmetry", "steering_asymmetry"),
)
