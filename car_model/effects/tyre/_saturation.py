"""What several tyre effects share: a force that levels off."""

from steerd.car_model.ops import Ops, T

_FLOOR = 0.25
"""Keeps the square root real where a fit tries tyres that stiffen: at most twice the force."""


def saturated(ops: Ops[T], force: T, z: T, q: T) -> T:
    """`force / sqrt(1 + q z^2)`: the linear force levels off at `mu Fz / sqrt(q)`.

    `z = C_S slip` is the linear force per friction limit. Like tanh(sqrt(q) z) / sqrt(q) it has one
    parameter, slope 1 at zero slip and a plateau, but it is analytic in `q` at 0, where it is the
    linear tyre exactly, with gradient -z^3 / 2.
    """
    level: T = force / ops.sqrt(ops.maximum(1.0 + q * z * z, _FLOOR))
    return level
