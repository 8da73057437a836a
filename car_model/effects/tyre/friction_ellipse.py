"""Lateral grip that acceleration and braking use up.

Rear-wheel drive takes it from the rear axle alone. Needs hard driving to show: at 3 m/s^2 on a
floor of mu 1.05 a full ellipse costs 4 % of the force where both axles drive alike.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import Axles
from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Role, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import GRAVITY, Car

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
    """What each axle's part of the longitudinal force leaves."""
    used = accel / (car.mu * GRAVITY)
    front, rear = 2.0 * (1.0 - p[1]) * used, 2.0 * p[1] * used
    return Axles(
        forces.front * ops.sqrt(ops.maximum(1.0 - p[0] * front * front, _FLOOR)),
        forces.rear * ops.sqrt(ops.maximum(1.0 - p[0] * rear * rear, _FLOOR)),
    )


EFFECT = Effect(
    name="friction_ellipse",
    stage=Stage.FORCES,
    family="tyre",
    summary="accelerating and braking take lateral grip away",
    equation="F -> F sqrt(1 - share (2 part accel / (mu g))^2), part: rear, or 1 - rear in front",
    parameters=(
        EffectParameter("share", 0.0, 0.0, 9.0, "1", 0.5, "1: the textbook ellipse at mu"),
        EffectParameter(
            "rear",
            0.5,
            0.0,
            1.0,
            "1",
            0.15,
            "rear axle's part of drive and braking",
            role=Role.FORM,
        ),
    ),
    least_size=0.16,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    on_every_car=True,
    zero_gradient=False,
    follows_acceleration=True,
    forces=_forces,
    aliases=("combined_slip", "friction_circle"),
)
