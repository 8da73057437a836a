"""The base parameters closest to a car with effects: what a controller or filter may know."""

from steerd.car_model.model import Model, car_now, delays
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import Car
from steerd.car_model.state import ORIGIN

_FAR = 1e6
"""A place outside every patch of floor [m]."""


def believed_car(model: Model[float]) -> Car[float]:
    """The car's parameters with those effects folded in that are changes of parameters.

    Dead times add up; gains, lags, limits, stiffnesses, masses and lengths are as the effects make
    them at the start of a drive and away from special places. What has no counterpart among the
    parameters (backlash, a saturating tyre, a slope) is left out. Without effects nothing changes.
    """
    car = car_now(FLOAT, model, ORIGIN._replace(x=_FAR, y=_FAR, speed=1.0), 0.0)
    late = delays(model)
    return car._replace(steer_delay=late.steer, drive_delay=late.drive, pose_delay=late.pose)
