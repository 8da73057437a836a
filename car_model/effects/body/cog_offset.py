"""A centre of gravity ahead of (or behind) where the car file has it.

The mocap body stays where it was calibrated, so the poses seen are of the old place: close to a
marker offset, and the same as one at low speed.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Confounding, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import Observation, State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """A shorter distance to the front axle, a longer one to the rear."""
    return car._replace(lf=car.lf - p[0], lr=car.lr + p[0])


def _observe(ops: Ops[T], p: Sequence[T], state: State[T], seen: Observation[T]) -> Observation[T]:
    """The pose of where the centre of gravity was thought to be."""
    return seen._replace(x=seen.x - p[0] * ops.cos(state.yaw), y=seen.y - p[0] * ops.sin(state.yaw))


EFFECT = Effect(
    name="cog_offset",
    stage=Stage.FORCES,
    family="mass",
    summary="the centre of gravity is elsewhere along the car",
    equation="lf, lr -> lf - offset, lr + offset",
    parameters=(
        EffectParameter("offset", 0.0, -0.1, 0.1, "m", 0.02, "forward of the modelled CoG"),
    ),
    least_size=0.012,
    confounded_with=Confounding(
        ("marker_offset",),
        "marker_offset in slow drives",
    ),
    needs_commands=None,
    selectable_in_base=BaseSelection.NEVER,
    zero_gradient=False,
    car=_car,
    observe=_observe,
    aliases=("cg_offset", "cog_shift"),
)
