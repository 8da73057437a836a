"""Poses older than their stamps say.

Exactly an equal dead time on both command channels, seen from the poses alone: never separable from
it without a second clock (a gyro, wheel speed).
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
from steerd.car_model.ops import T
from steerd.car_model.state import Delays


def _delays(p: Sequence[T]) -> Delays[T]:
    """The pose alone comes later."""
    none = 0.0 * p[0]
    return Delays(steer=none, drive=none, pose=p[0])


EFFECT = Effect(
    name="mocap_latency",
    stage=Stage.OBSERVE,
    family="timing",
    summary="poses are older than their stamps say",
    equation="pose_seen(t) = pose(t - latency)",
    parameters=(
        EffectParameter("latency", 0.0, 0.0, 0.3, "s", 0.02, "age of a pose at its stamp"),
    ),
    least_size=0.002,
    confounded_with=Confounding(
        ("steer_delay", "drive_delay"),
        "equal dead time on both commands (steer_delay and drive_delay): the same"
        " poses without a second clock",
    ),
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("pose_delay",),
    delays=_delays,
    aliases=("latency", "pose_latency", "mocap_delay"),
)
