"""Dead time between the speed command and the motor."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import T
from steerd.car_model.state import Delays


def _delays(p: Sequence[T]) -> Delays[T]:
    """The speed command alone comes later."""
    none = 0.0 * p[0]
    return Delays(steer=none, drive=p[0], pose=none)


EFFECT = Effect(
    name="drive_delay",
    stage=Stage.COMMAND,
    family="timing",
    summary="the speed command takes effect late",
    equation="speed_cmd(t) -> speed_cmd(t - delay)",
    parameters=(
        EffectParameter("delay", 0.0, 0.0, 0.3, "s", 0.03, "dead time beyond the car's own"),
    ),
    least_size=0.004,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("drive_delay",),
    delays=_delays,
    aliases=("speed_delay", "motor_delay"),
)
