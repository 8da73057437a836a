"""What several tyre effects share: a force that levels off."""

from steerd.car_model.ops import Ops, T

_FLOOR = 0.25
"""Keeps the square root real where a fit tries tyres that stiffen: at most twice the force."""
_ROUND = 0.05
"""Rounds off the corner of `|z|` at zero."""


def _size(ops: Ops[T], z: T) -> T:
    """`|z|`, smooth at zero."""
    size: T = ops.sqrt(z * z + _ROUND * _ROUND) - _ROUND
    return size


def saturated(ops: Ops[T], force: T, z: T, q: T, early: T | float = 0.0) -> T:
    """`force / sqrt(1 + q (z^2 + early |z|))`: the linear force levels off at `mu Fz / sqrt(q)`.

    `z = C_S slip` is the linear force per friction limit. Like tanh(sqrt(q) z) / sqrt(q) it has one
    parameter, slope 1 at zero slip and a plateau, but it is analytic in `q` at 0, where it is the
    linear tyre exactly, with gradient -z^3 / 2.

    A brush tyre slides at the rear edge of its contact patch from the first slip on, so that the
    slope at zero is larger than any secant (Pacejka, Tire and Vehicle Dynamics, section 3.2): that
    is `early`, 0.5 (with q 1.7) for brushes that slide as a whole at 0.6 mu Fz.
    """
    bend = q * (z * z + early * _size(ops, z))
    level: T = force / ops.sqrt(ops.maximum(1.0 + bend, _FLOOR))
    return level
