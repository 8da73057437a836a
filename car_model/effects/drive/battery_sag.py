"""A battery that runs down: the same command gives less and less speed.

The motor controller sees the lower speed too, so its report stays true.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.state import Command


def _reference(ops: Ops[T], p: Sequence[T], ref: Command[T], t: float) -> Command[T]:
    """A speed aim that fades over the run."""
    return ref._replace(speed=ref.speed * ops.exp(-p[0] * (t / 60.0)))


EFFECT = Effect(
    name="battery_sag",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="speed per command falls over the run",
    equation="speed aim = speed_gain cmd exp(-rate t)",
    parameters=(
        EffectParameter("rate", 0.0, -0.3, 1.0, "1/min", 0.05, "share of speed lost per minute"),
    ),
    least_size=0.025,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.NEVER,
    zero_gradient=False,
    reference=_reference,
    aliases=("battery", "voltage_sag"),
)
