"""Rolling resistance of tyres and drivetrain.

The same at all speeds but fading out at standstill; against a speed loop with a lag it leaves a
constant speed error, so at one speed it looks like a speed scale.
"""

# Why: docs/decisions/diagnosis.md#d53

from collections.abc import Sequence

from steerd.car_model.chassis import Axles, Rates
from steerd.car_model.effect import (
    BaseSelection,
    Channel,
    Confounding,
    Effect,
    EffectParameter,
    Stage,
)
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State

_FADE = 10.0
"""Full drag from about 0.2 m/s up [s/m]."""


def _rates(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    state: State[T],
    wheel: T,
    forces: Axles[T],
    rates: Rates[T],
) -> Rates[T]:
    """Less acceleration, against the direction of travel."""
    return rates._replace(speed=rates.speed - p[0] * ops.tanh(_FADE * state.speed))


EFFECT = Effect(
    name="rolling_drag",
    stage=Stage.ACTUATOR,
    family="drive",
    summary="rolling resistance slows the car",
    equation="d(speed)/dt = accel - drag tanh(speed / 0.1)",
    parameters=(
        EffectParameter("drag", 0.0, -1.0, 3.0, "m/s^2", 0.4, "deceleration when left to roll"),
    ),
    least_size=0.07,
    confounded_with=Confounding(
        ("speed_scale",),
        "speed_scale at a single speed",
    ),
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    on_every_car=True,
    zero_gradient=False,
    rates=_rates,
    aliases=("drag", "rolling_resistance", "friction_drag"),
)
