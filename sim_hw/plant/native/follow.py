"""The step of a car without effects in machine code."""

import ctypes
from collections.abc import Callable
from functools import cache
from math import isfinite
from pathlib import Path
from struct import Struct

from steerd.car_model.chassis import Chassis
from steerd.car_model.machine_code import Source, load_library
from steerd.car_model.model import Model
from steerd.car_model.params import Car
from steerd.car_model.state import State

PLANT = Source("plant", Path(__file__).parent, ("plant.c",))
Numbers = tuple[float, ...]
_CAR = Struct(f"={len(Car._fields)}d")
_GIVEN = Struct(f"={len(State._fields) + 4}d")
"""State, servo and speed demand, time and length of the step."""
_AFTER = ctypes.c_double * len(State._fields)


def function_name(chassis: Chassis) -> str:
    """Of the chassis' function in the library."""
    return f"follow_{chassis.name}{f'_{chassis.drive}' if chassis.drive else ''}"


@cache
def _library() -> ctypes.PyDLL | None:
    return load_library(PLANT)


def make_native_follow(
    model: Model[float], in_python: Callable[..., Numbers]
) -> Callable[..., Numbers] | None:
    """`Steps.follow` of a model in machine code; None where there is none.

    Args:
        model: the car.
        in_python: what is asked where a number is not finite: it says what is wrong.
    """
    library = _library()
    function = getattr(library, function_name(model.chassis), None)
    if library is None or function is None or model.effects:
        return None
    car = _CAR.pack(*model.car)

    def follow(*numbers: float) -> Numbers:
        after = _AFTER()
        function(car, _GIVEN.pack(*numbers), after)
        found = tuple(after)
        return found if isfinite(sum(found)) else in_python(*numbers)

    return follow
