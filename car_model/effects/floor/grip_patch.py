"""A slippery place on the floor: a disc with a soft edge, fixed in the world.

Where it lies has no gradient while it does nothing: look for place and drop together.
"""

from collections.abc import Sequence

from steerd.car_model.effect import BaseSelection, Effect, EffectParameter, Role, Stage
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import State

_EDGE = 0.1
"""Half width of the edge [m]."""
_SCAN_DROPS = (0.25, 0.5)
"""Shares of grip lost that a scan tries."""


def _car(ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float) -> Car[T]:
    """Less friction inside the disc; (d^2 - r^2) / 2r is the distance from its edge, near it."""
    x, y, radius, drop = p
    dx, dy = state.x - x, state.y - y
    outside = (dx * dx + dy * dy - radius * radius) / (2.0 * _EDGE * radius)
    inside = 0.5 * (1.0 - ops.tanh(outside))
    return car._replace(mu=car.mu * (1.0 - drop * inside))


def _scan(discs: Sequence[tuple[float, float, float]]) -> Sequence[tuple[float, ...]]:
    """Discs of two strengths where errors are larger than elsewhere."""
    return [(*disc, drop) for disc in discs for drop in _SCAN_DROPS]


EFFECT = Effect(
    name="grip_patch",
    stage=Stage.FORCES,
    family="ground",
    summary="a slippery patch on the floor",
    equation="mu(x, y) = mu (1 - drop [distance to (x, y) < radius])",
    parameters=(
        EffectParameter("x", 0.0, -100.0, 100.0, "m", 2.0, "centre in the world", role=Role.PLACE),
        EffectParameter("y", 0.0, -100.0, 100.0, "m", 2.0, "centre in the world", role=Role.PLACE),
        EffectParameter("radius", 0.5, 0.1, 20.0, "m", 0.5, "of the disc", role=Role.PLACE),
        EffectParameter(
            "drop", 0.0, 0.0, 0.95, "1", 0.3, "share of grip lost inside", scan=(0.2, 0.4, 0.6)
        ),
    ),
    least_size=0.0,
    confounded_with=None,
    needs_commands=None,
    selectable_in_base=BaseSelection.NEVER,
    zero_gradient=True,
    scan=_scan,
    car=_car,
    aliases=("slippery_patch", "patch"),
)
