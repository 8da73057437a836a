"""Grip lost because the outer wheels carry more and the inner less: mu falls with load.

Near a bend's steady state it looks like friction; the lateral acceleration is the one that the
tyre forces give.
"""

from collections.abc import Sequence

from car_model.effect import Effect, EffectParameter, Stage
from car_model.ops import Ops, T
from car_model.params import GRAVITY, Car
from car_model.single_track import Axles


def _forces(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    slips: Axles[T],
    loads: Axles[T],
    accel: T,
    forces: Axles[T],
) -> Axles[T]:
    """Both axles weaker with the square of the lateral acceleration."""
    lateral = (forces.front + forces.rear) / (car.mass * GRAVITY)
    left = 1.0 + p[0] * lateral * lateral
    return Axles(forces.front / left, forces.rear / left)


EFFECT = Effect(
    name="lateral_load_transfer",
    stage=Stage.FORCES,
    family="tyre",
    summary="grip falls as load moves to the outer wheels",
    equation="F -> F / (1 + k (a_y / g)^2)",
    parameters=(EffectParameter("k", 0.0, 0.0, 5.0, "1", 0.5, "loss of grip at 1 g, first order"),),
    forces=_forces,
    aliases=("lateral_transfer", "roll_transfer"),
)
