"""Tyres with a slip angle for the car in MuJoCo: magic formula, combined slip, relaxation.

MuJoCo's own contacts creep with a slip *velocity*; these forces take the wheels' loads from the
contacts and put a rubber tyre's forces on the wheels instead.
"""

from math import atan, exp, hypot, sin
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.blind_gap.plant import STEP

Array = NDArray[np.float64]

_SLOW = 0.3
"""Below this speed slip is measured against it [m/s]."""


class Tyre(NamedTuple):
    """A tyre; stiffnesses per load."""

    mu: float
    stiff_front: float
    """Cornering force per load and slip angle [1/rad]."""
    stiff_rear: float
    stiff_along: float
    """Longitudinal force per load and slip ratio."""
    shape: float
    """The formula's C: 1 levels off, more falls beyond its peak."""
    load_sensitivity: float
    """Friction lost per relative load."""
    relaxation: float
    """Rolled distance over which lateral force builds up [m]."""
    trail: float
    """Pneumatic trail [m]."""


@njit(cache=True)
def tyre_forces(
    tyre: Tyre, grips: Array, slips: Array, hubs: Array, loads: Array, rest: Array, spins: Array,
    radius: float, sides: Array, out: Array,
) -> None:  # fmt: skip
    """Forces of four tyres, in place.

    Args:
        tyre: the tyre.
        grips: (4,) friction of the floor under each wheel, per nominal friction.
        slips: (4, 2) slip ratio and slip angle's tangent as the tyre feels them; advanced.
        hubs: (4, 2) velocity of the hubs along and across [m/s].
        loads: (4,) wheel loads [N].
        rest: (4,) wheel loads at rest [N].
        spins: (4,) wheel speeds [rad/s].
        radius: of the wheels [m].
        sides: (4,) grip of each wheel per nominal.
        out: (4, 3) force along, across [N] and moment about the vertical [N m].
    """
    for i in range(4):
        along, across = hubs[i, 0], hubs[i, 1]
        pace = max(abs(along), _SLOW)
        ratio, angle = (radius * spins[i] - along) / pace, -across / pace
        stiff = tyre.stiff_front if i < 2 else tyre.stiff_rear
        slips[i, 0] += (ratio - slips[i, 0]) * (1.0 - exp(-STEP * pace / 0.02))
        slips[i, 1] += (angle - slips[i, 1]) * (1.0 - exp(-STEP * pace / tyre.relaxation))
        load = max(loads[i], 0.0)
        mu = tyre.mu * grips[i] * sides[i]
        mu *= max(1.0 - tyre.load_sensitivity * (load / rest[i] - 1.0), 0.1)
        fx = tyre.stiff_along * slips[i, 0]
        fy = stiff * sides[i] * slips[i, 1]
        size = max(hypot(fx, fy), 1e-9)
        share = mu * sin(tyre.shape * atan(size / (mu * tyre.shape))) / size
        out[i, 0] = share * fx * load
        out[i, 1] = share * fy * load
        out[i, 2] = -tyre.trail * share * fy * load * max(1.0 - size / (3.0 * mu), 0.0)
