"""Lateral grip that acceleration and braking use up.

Needs hard driving to show: at 3 m/s^2 on a floor of mu 1.05 a full ellipse costs 4 % of the force.
"""

from collections.abc import Sequence

from car_model.effect import Effect, EffectParameter, Stage
from car_model.ops import Ops, T
from car_model.params import GRAVITY, Car
from car_model.single_track import Axles

_FLOOR = 0.01
"""Some lateral grip stays when the tyres are spinning."""


def _forces(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    slips: Axles[T],
    loads: Axles[T],
    accel: T,
    forces: Axles[T],
) -> Axles[T]:
    """What the longitudinal force leaves; both axles drive and brake alike."""
    used = accel / (car.mu * GRAVITY)
    left = ops.sqrt(ops.maximum(1.0 - p[0] * used * used, _FLOOR))
    return Axles(forces.front * left, forces.rear * left)


EFFECT = Effect(
    name="friction_ellipse",
    stage=Stage.FORCES,
    family="tyre",
    summary="accelerating and braking take lateral grip away",
    equation="F -> F sqrt(1 - share (accel / (mu g))^2)",
    parameters=(
        EffectParameter("share", 0.0, 0.0, 4.0, "1", 0.5, "1: the textbook ellipse at mu"),
    ),
    forces=_forces,
    aliases=("combined_slip", "friction_circle"),
)
