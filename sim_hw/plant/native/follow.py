"""A step of the car in machine code: without effects, or with those outside it: delays, sensors."""

import ctypes
from collections.abc import Callable
from functools import cache
from math import isfinite
from pathlib import Path
from struct import Struct

from steerd.car_model.chassis import Chassis
from steerd.car_model.machine_code import Source, load_library
from steerd.car_model.model import Model, hooked, memory_size
from steerd.car_model.params import Car
from steerd.car_model.state import State

PLANT = Source("plant", Path(__file__).parent, ("plant.c",))
Numbers = tuple[float, ...]
_CAR = Struct(f"={len(Car._fields)}d")
_GIVEN = Struct(f"={len(State._fields) + 4}d")
"""State, servo and speed demand, time and length of the step."""
HALVES: dict[str, int] = {"actuate": 2, "glide": len(State._fields), "follow": len(State._fields)}
"""Functions of each chassis, and how many numbers they give."""
_OUTSIDE = frozenset({"delays", "observe"})
"""Hooks that a step does not ask."""


def function_name(half: str, chassis: Chassis) -> str:
    """Of a chassis' function in the library."""
    return "_".join(word for word in (half, chassis.name, chassis.drive) if word)


@cache
def _library() -> ctypes.PyDLL | None:
    return load_library(PLANT)


def make_native(
    model: Model[float], half: str, in_python: Callable[..., Numbers]
) -> Callable[..., Numbers] | None:
    """A half of `Steps` in machine code; None where there is none for this model.

    Args:
        model: the car.
        half: which of `HALVES`.
        in_python: what is asked where a number is not finite: it says what is wrong.
    """
    library = _library()
    function = getattr(library, function_name(half, model.chassis), None)
    inside = hooked(model.effects) - _OUTSIDE
    if library is None or function is None or inside or memory_size(model.effects):
        return None
    car, taken = _CAR.pack(*model.car), Struct(f"={HALVES[half]}d")
    memory = bytearray(taken.size)
    after = (ctypes.c_char * taken.size).from_buffer(memory)

    def step(*numbers: float) -> Numbers:
        function(car, _GIVEN.pack(*numbers), after)
        found = taken.unpack(memory)
        return found if isfinite(sum(found)) else in_python(*numbers)

    return step
