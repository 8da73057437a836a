"""Tyres whose lateral force levels off instead of growing for ever with slip."""

from collections.abc import Sequence

from steerd.car_model.chassis import Axles
from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Role, Stage
from steerd.car_model.effects.tyre._saturation import saturated
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car


def _forces(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    slips: Axles[T],
    loads: Axles[T],
    accel: T,
    forces: Axles[T],
) -> Axles[T]:
    """Both axles' forces, levelled off."""
    return Axles(
        saturated(ops, forces.front, car.c_sf * slips.front, p[0], p[1]),
        saturated(ops, forces.rear, car.c_sr * slips.rear, p[0], p[1]),
    )


EFFECT = Effect(
    name="tyre_saturation",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyre forces level off at large slip",
    equation="F = mu Fz z / sqrt(1 + q (z^2 + early |z|)), z = C_S slip",
    parameters=(
        EffectParameter(
            "q", 0.0, 0.0, 12.0, "1", 1.0, "1: plateau at mu Fz; 4: at half of it; 0: never"
        ),
        EffectParameter(
            "early", 0.0, 0.0, 4.0, "1", 0.5, "0.5: brushes; 0: straight at first", role=Role.FORM
        ),
    ),
    least_size=0.2,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    forces=_forces,
    aliases=("saturation", "pacejka"),
)
