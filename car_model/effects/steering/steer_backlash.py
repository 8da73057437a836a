"""Play in the linkage: the wheels follow only after the slack is taken up.

The play operator: the wheel angle stays until the servo pushes it from one side of the gap or the
other. It has a kink at the null (the gap cannot be negative): look for it with a scan.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T


def _linkage(ops: Ops[T], p: Sequence[T], memory: Sequence[T], angle: T) -> tuple[T, tuple[T, ...]]:
    """The last wheel angle, kept within the gap about the servo's."""
    half = 0.5 * p[0]
    wheel = ops.clip(memory[0], angle - half, angle + half)
    return wheel, (wheel,)


EFFECT = Effect(
    name="steer_backlash",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="play in the steering linkage",
    equation="wheel = clip(last wheel, steer - play/2, steer + play/2)",
    parameters=(
        EffectParameter(
            "play",
            0.0,
            0.0,
            0.15,
            "rad",
            0.02,
            "whole width of the gap",
            scan=(0.005, 0.01, 0.02, 0.03, 0.04, 0.06),
        ),
    ),
    least_size=0.0019,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.IDENTIFY,
    zero_gradient=True,
    memory=1,
    linkage=_linkage,
    aliases=("backlash", "play", "steer_deadband"),
)
