"""A yaw inertia other than modelled: it turns in more slowly or more quickly."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """The inertia, scaled."""
    return car._replace(inertia_z=car.inertia_z * p[0])


EFFECT = Effect(
    name="yaw_inertia",
    stage=Stage.FORCES,
    family="mass",
    summary="the car is slower (or quicker) to turn than modelled",
    equation="I_z -> ratio I_z",
    parameters=(
        EffectParameter("ratio", 1.0, 0.4, 3.0, "1", 0.25, "inertia per modelled inertia"),
    ),
    least_size=0.063,
    confounded_with=Confounding(
        ("mass",),
    ),
    nameable_alone=False,
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    zero_gradient=False,
    same_as=("inertia_z",),
    car=_car,
    aliases=("inertia", "inertia_z"),
)
