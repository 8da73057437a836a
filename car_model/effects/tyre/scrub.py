"""Tyres dragged sideways in a turn: a locked differential, and cornering drag.

A locked differential turns the left and right wheel alike, which holds the car straight: a yaw
moment against the yaw rate. Lateral forces also have a part that points back along the path; with
`drag` 1 it takes exactly the power that the tyres lose in slip.
"""

from collections.abc import Sequence

from steerd.car_model.chassis import Axles, Rates, dynamic_share
from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Stage
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
    """Yaw damping and drag, fading out at crawling speed with the forces themselves."""
    share = dynamic_share(ops, state.speed)
    slip = state.slip_angle
    back = (forces.front * (wheel - slip) - forces.rear * slip) / car.mass
    return rates._replace(
        yaw_rate=rates.yaw_rate - p[0] * share * state.yaw_rate,
        speed=rates.speed - p[1] * share * back,
    )


EFFECT = Effect(
    name="scrub",
    stage=Stage.FORCES,
    family="tyre",
    summary="tyres scrub in turns: locked differential, cornering drag",
    equation="d(yaw_rate)/dt -= yaw_damping yaw_rate; d(speed)/dt -= drag F_lat,back / m",
    parameters=(
        EffectParameter("yaw_damping", 0.0, 0.0, 20.0, "1/s", 2.0, "of a locked differential"),
        EffectParameter("drag", 0.0, -1.0, 4.0, "1", 0.5, "1: all slip power taken from speed"),
    ),
    least_size=0.39,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.HEALTHY,
    on_every_car=True,
    zero_gradient=False,
    rates=_rates,
    aliases=("locked_differential", "corner_drag", "tyre_scrub"),
)
