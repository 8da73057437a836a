"""Grip lost because the outer wheels carry more and the inner less: mu falls with load.

A tyre's coefficient falls with its load, mu (1 - e (Fz / Fz0 - 1)). Across the car the two wheels
of an axle then lose e s^2 (a_y / g)^2 together, where s is the load that a lateral acceleration of
1 g moves per side: k = e s^2. Along the car the same tyre gives back less (or more) than the load
that moves between the axles. Near a bend's steady state it looks like friction; the lateral
acceleration a_y is the one that the weakened tyre forces give.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import Axles
from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Role, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car

_FLOOR = 0.1
"""Some of the coefficient stays under any load."""
_MOVED = 0.62
"""2 h / track of the F1TENTH car: CoG 74 mm high on a track of 240 mm."""


def _forces(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    slips: Axles[T],
    loads: Axles[T],
    accel: T,
    forces: Axles[T],
) -> Axles[T]:
    """Weaker with the square of the lateral acceleration, and under the load that braking moves."""
    lateral = (forces.front + forces.rear) / (car.mass * GRAVITY)
    # 1 - k a^2 with a = lateral (1 - k a^2), solved for itself.
    left = 2.0 / (1.0 + ops.sqrt(ops.maximum(1.0 + 4.0 * p[0] * lateral * lateral, _FLOOR)))
    falls = p[0] / (p[1] * p[1])
    per_load = (car.lf + car.lr) / (car.mass * GRAVITY)
    front = 1.0 - falls * (per_load * loads.front / car.lr - 1.0)
    rear = 1.0 - falls * (per_load * loads.rear / car.lf - 1.0)
    return Axles(
        ops.maximum(front, _FLOOR) * forces.front * left,
        ops.maximum(rear, _FLOOR) * forces.rear * left,
    )


EFFECT = Effect(
    name="lateral_load_transfer",
    stage=Stage.FORCES,
    family="tyre",
    summary="grip falls as load moves to the outer wheels",
    equation="F -> F (1 - k / moved^2 (Fz / Fz0 - 1)) (1 - k (a_y / g)^2)",
    parameters=(
        EffectParameter("k", 0.0, 0.0, 5.0, "1", 0.5, "grip lost per (a_y / g)^2"),
        EffectParameter(
            "moved",
            _MOVED,
            0.3,
            1.5,
            "1",
            0.1,
            "load moved at 1 g per load of a side: 2 h / track",
            role=Role.FORM,
        ),
    ),
    least_size=0.4,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    forces=_forces,
    aliases=("lateral_transfer", "roll_transfer"),
)
