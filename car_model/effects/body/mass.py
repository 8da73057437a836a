"""A payload at the centre of gravity.

Tyre forces grow with load as mass does, so mass cancels from the planar motion except against the
yaw inertia, which it leaves alone, and in what the motor can do: it looks like a smaller inertia
and lower acceleration limits.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """More mass, and less acceleration from the same motor."""
    heavy = car.mass + p[0]
    share = car.mass / heavy
    return car._replace(
        mass=heavy, accel_max=car.accel_max * share, decel_max=car.decel_max * share
    )


EFFECT = Effect(
    name="mass",
    stage=Stage.FORCES,
    family="mass",
    summary="the car carries more (or less) than modelled",
    equation="m -> m + payload; accel limits -> m / (m + payload) of themselves",
    parameters=(
        EffectParameter("payload", 0.0, -0.15, 5.0, "kg", 0.5, "mass beyond the car's own"),
    ),
    least_size=0.16,
    confounded_with=Confounding(
        ("yaw_inertia",),
        "smaller yaw_inertia with lower acceleration limits: mass cancels from planar motion",
    ),
    nameable_alone=False,
    needs_commands=None,
    selectable_in_base=BaseSelection.NEVER,
    zero_gradient=False,
    same_as=("inertia_z",),
    car=_car,
    aliases=("payload",),
)
