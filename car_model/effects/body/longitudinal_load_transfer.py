"""More load moved between the axles by acceleration than the CoG's height in use explains."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """A higher centre of gravity."""
    return car._replace(cog_height=car.cog_height + p[0])


EFFECT = Effect(
    name="longitudinal_load_transfer",
    stage=Stage.FORCES,
    family="tyre",
    summary="acceleration moves more load between the axles than modelled",
    equation="Fz = m (g l -+ (cog_height + height) accel) / L",
    parameters=(
        EffectParameter("height", 0.0, -0.1, 0.2, "m", 0.03, "CoG height beyond the car's own"),
    ),
    least_size=0.02,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    follows_acceleration=True,
    car=_car,
    aliases=("longitudinal_transfer", "pitch_transfer", "cog_height"),
)
