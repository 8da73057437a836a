"""Dead time between the steering command and the servo."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import T
from steerd.car_model.state import Delays


def _delays(p: Sequence[T]) -> Delays[T]:
    """The steering command alone comes later."""
    none = 0.0 * p[0]
    return Delays(steer=p[0], drive=none, pose=none)


EFFECT = Effect(
    name="steer_delay",
    stage=Stage.COMMAND,
    family="timing",
    summary="the steering command takes effect late",
    equation="steer_cmd(t) -> steer_cmd(t - delay)",
    parameters=(
        EffectParameter("delay", 0.0, 0.0, 0.3, "s", 0.03, "dead time beyond the car's own"),
    ),
    least_size=0.0015,
    confounded_with=None,
    needs_commands=Channel.STEER,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("steer_delay",),
    delays=_delays,
    aliases=("steering_delay", "steer_latency"),
)
