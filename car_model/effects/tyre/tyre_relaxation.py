"""Tyres that must roll a distance before their force has built up.

The memory is the felt slip's deviation `d` from the steady slip, `d' = -(v / length) d - slip'`,
solved exactly over each step for a steady slip that changes linearly; at length 0 it stays zero.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import SPEED_KINEMATIC, Axles
from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T

_TINY = 1e-7
"""A length this short has relaxed within any step: the exponential underflows to zero [m]."""


def _slips(ops: Ops[T], p: Sequence[T], memory: Sequence[T], slips: Axles[T]) -> Axles[T]:
    """Slip that the tyres feel: the steady one and the deviation."""
    return Axles(slips.front + memory[0], slips.rear + memory[1])


def _remember(
    ops: Ops[T],
    p: Sequence[T],
    memory: Sequence[T],
    speed: T,
    before: Axles[T],
    after: Axles[T],
    h: float,
) -> tuple[T, ...]:
    """Each axle's deviation after the step."""
    rolling = ops.maximum(ops.absolute(speed), SPEED_KINEMATIC)
    kept = ops.exp(-h * rolling / ops.maximum(p[0], _TINY))
    gained = (p[0] / (h * rolling)) * (1.0 - kept)
    return (
        memory[0] * kept - (after.front - before.front) * gained,
        memory[1] * kept - (after.rear - before.rear) * gained,
    )


EFFECT = Effect(
    name="tyre_relaxation",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyre force builds up over a rolled distance",
    equation="(length / speed) d(felt slip)/dt = slip - felt slip",
    parameters=(
        EffectParameter("length", 0.0, 0.0, 0.5, "m", 0.05, "distance to 63 % of the force"),
    ),
    least_size=0.003,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.IDENTIFY,
    on_every_car=True,
    zero_gradient=False,
    memory=2,
    slips=_slips,
    remember=_remember,
    aliases=("relaxation", "relaxation_length"),
)
