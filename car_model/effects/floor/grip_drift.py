"""Grip that changes over the run: tyres warm up, dust comes off, or goes on."""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """Friction that grows with run time."""
    return car._replace(mu=car.mu * ops.exp(p[0] * (t / 60.0)))


EFFECT = Effect(
    name="grip_drift",
    stage=Stage.FORCES,
    family="tyre",
    summary="grip changes over the run",
    equation="mu(t) = mu exp(rate t)",
    parameters=(EffectParameter("rate", 0.0, -1.0, 1.0, "1/min", 0.1, "growth per minute"),),
    least_size=0.27,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.NEVER,
    zero_gradient=False,
    car=_car,
    aliases=("tyre_warmup", "warm_up"),
)
