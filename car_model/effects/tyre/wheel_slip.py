"""Driven wheels that turn faster than the car moves while they accelerate it, slower in braking.

A tyre's longitudinal force needs slip, F_x = mu Fz C kappa, so wheels that give an acceleration a
turn by the share a / (mu g C) faster: 0.0045 a for C = 22. Seen from the poses the car lags its
speed command and its reported wheel speed by slip x speed, a few milliseconds, which otherwise
passes for a late pose.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import Axles, Rates
from steerd.car_model.effect import BaseSelection, Channel, Effect, EffectParameter, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State


def _rates(
    ops: Ops[T],
    p: Sequence[T],
    car: Car[T],
    state: State[T],
    wheel: T,
    forces: Axles[T],
    rates: Rates[T],
) -> Rates[T]:
    """The state's speed is the wheels'; the car moves by what slip leaves of it."""
    kept = 1.0 - p[0] * rates.speed
    return rates._replace(x=rates.x * kept, y=rates.y * kept)


EFFECT = Effect(
    name="wheel_slip",
    stage=Stage.FORCES,
    family="drive",
    summary="driven wheels slip as they accelerate and brake the car",
    equation="(dx/dt, dy/dt) -> (1 - slip d(speed)/dt) (dx/dt, dy/dt)",
    parameters=(
        EffectParameter(
            "slip", 0.0, 0.0, 0.1, "s^2/m", 0.005, "slip per acceleration: 1 / (mu g C)"
        ),
    ),
    least_size=0.004,
    confounded_with=None,
    needs_commands=Channel.SPEED,
    selectable_in_base=BaseSelection.HEALTHY,
    on_every_car=True,
    zero_gradient=False,
    follows_acceleration=True,
    built_into=("planar",),
    rates=_rates,
    aliases=("longitudinal_slip",),
)
