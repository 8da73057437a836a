"""End stops inside the model's: a servo limit, a wheel touching the chassis.

Where no command passes the stop it changes nothing, so its gradient at the null is zero: it must be
looked for with a scan.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.state import Command


def _reference(ops: Ops[T], p: Sequence[T], ref: Command[T], t: float) -> Command[T]:
    """The servo aims no further than the stop."""
    return ref._replace(steer=ops.clip(ref.steer, -p[0], p[0]))


EFFECT = Effect(
    name="steer_clip",
    stage=Stage.ACTUATOR,
    family="steering",
    summary="the wheels stop before the model's end stops",
    equation="aim = clip(aim, -limit, limit)",
    parameters=(
        EffectParameter(
            "limit",
            1.0,
            0.03,
            1.0,
            "rad",
            0.75,
            "largest wheel angle either way",
            scan=(0.1, 0.15, 0.2, 0.24, 0.28, 0.32),
        ),
    ),
    least_size=0.0,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=True,
    reference=_reference,
    aliases=("clip", "end_stop", "steer_limit"),
)
