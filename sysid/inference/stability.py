"""Steps short enough for the yaw mode, which is stiff at low speed."""

import math

import numpy as np

from steerd.car_model.chassis import KINEMATIC_RATE, dynamic_share
from steerd.car_model.numpy_ops import NUMPY
from steerd.car_model.params import Car
from steerd.car_model.rollout import stiffness_rate

DECAY_MAX = {"rk4": 2.0, "midpoint": 1.4, "euler": 1.4}
"""Decay per step that is surely stable (the limits are 2.78, 2 and 2)."""
SUBSTEPS_MAX = 16


def decay_rate(car: Car[float], slowest: float, fastest: float) -> float:
    """Fastest decay of yaw rate and slip between two speeds [1/s].

    Below walking pace the tyre equations fade into the kinematic ones, so the rate stays bounded.
    """
    speeds = np.linspace(slowest, fastest, 32)
    share = np.asarray(dynamic_share(NUMPY, speeds), float)
    tyres = np.array([stiffness_rate(car, float(v)) for v in speeds])
    return float(np.max(share * tyres + (1.0 - share) * KINEMATIC_RATE))


def stable_substeps(
    car: Car[float], slowest: float, fastest: float, h: float, integrator: str = "rk4"
) -> int:
    """Integration steps that a step of `h` seconds needs for speeds in this range [m/s]."""
    rate = decay_rate(car, slowest, fastest)
    if not math.isfinite(rate):
        return SUBSTEPS_MAX
    return min(max(1, math.ceil(h * rate / DECAY_MAX[integrator])), SUBSTEPS_MAX)
