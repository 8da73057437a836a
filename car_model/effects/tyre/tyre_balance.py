"""Front tyres stiffer than modelled and rear tyres softer, or the other way round."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The ratio of the coefficients changed, their geometric mean kept."""
    root = ops.sqrt(p[0])
    return car._replace(c_sf=car.c_sf * root, c_sr=car.c_sr / root)


EFFECT = Effect(
    name="tyre_balance",
    stage=Stage.FORCES,
    family="tyre",
    summary="front tyres grip more against rear tyres than modelled",
    equation="C_Sf / C_Sr -> ratio C_Sf / C_Sr",
    parameters=(EffectParameter("ratio", 1.0, 0.35, 3.0, "1", 0.2, "front to rear, per modelled"),),
    least_size=0.029,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    car=_car,
    aliases=("balance", "front_balance"),
)
