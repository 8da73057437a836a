"""A linkage that bends: less (or more) wheel angle towards the ends.

The lower bound is 1 / (3 x 0.34^2): beyond it the wheels would turn back at the ends.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T


def _linkage(ops: Ops[T], p: Sequence[T], memory: Sequence[T], angle: T) -> tuple[T, tuple[T, ...]]:
    """A cubic on top of the straight line."""
    return angle + p[0] * angle * angle * angle, ()


EFFECT = Effect(
    name="steer_nonlinearity",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the linkage's gain changes towards the ends",
    equation="wheel = steer + cubic steer^3",
    parameters=(
        EffectParameter(
            "cubic", 0.0, -2.85, 4.0, "1/rad^2", 1.0, "at -1 the wheels turn 12 % less at 0.34 rad"
        ),
    ),
    least_size=0.2,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    linkage=_linkage,
    aliases=("steer_cubic", "steering_nonlinearity"),
)
