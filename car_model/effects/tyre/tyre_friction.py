"""A floor with less grip: softer tyres that also level off sooner.

In gentle driving it is a lower cornering stiffness and nothing else; only slip near the limit shows
the plateau, `p^2 / sqrt(1 - p^2)` of the base car's `mu Fz` (0.33 at p = 0.53).
"""

# Why: docs/decisions/vehicle-model.md#d7

from collections.abc import Sequence

from steerd.car_model.chassis import Axles
from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
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
    """Both axles' forces with friction scaled by p, and a plateau that comes with it."""
    q = 1.0 / (p[0] * p[0]) - 1.0
    return Axles(
        saturated(ops, p[0] * forces.front, car.c_sf * slips.front, q),
        saturated(ops, p[0] * forces.rear, car.c_sr * slips.rear, q),
    )


EFFECT = Effect(
    name="tyre_friction",
    stage=Stage.FORCES,
    family="tyre",
    summary="the floor grips less (or more) than modelled",
    equation="F = p mu Fz z / sqrt(1 + (1/p^2 - 1) z^2), z = C_S slip",
    parameters=(
        EffectParameter("ratio", 1.0, 0.2, 1.3, "1", 0.2, "p: friction per modelled friction"),
    ),
    least_size=0.02,
    confounded_with=Confounding(
        ("cornering_stiffness",),
        "cornering_stiffness below about 70 % of the limit",
    ),
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    forces=_forces,
    aliases=("friction", "mu", "grip", "low_friction"),
)
