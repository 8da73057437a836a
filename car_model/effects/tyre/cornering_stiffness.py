"""Tyres that are stiffer or softer than modelled, front and rear alike."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """Both cornering coefficients, scaled."""
    return car._replace(c_sf=car.c_sf * p[0], c_sr=car.c_sr * p[0])


EFFECT = Effect(
    name="cornering_stiffness",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyres are stiffer or softer than modelled",
    equation="C_Sf, C_Sr -> ratio C_Sf, ratio C_Sr",
    parameters=(
        EffectParameter("ratio", 1.0, 0.25, 3.0, "1", 0.2, "stiffness per modelled stiffness"),
    ),
    least_size=0.034,
    confounded_with=Confounding(
        ("tyre_friction",),
        "tyre_friction below about 70 % of the limit",
    ),
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    car=_car,
    aliases=("stiffness", "tyre_stiffness"),
)
