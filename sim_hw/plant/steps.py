"""A step of the simulated car, by the compiled library; on floats where an effect is not in it."""

from collections.abc import Callable
from ctypes import byref, c_char
from functools import lru_cache
from math import inf
from struct import Struct
from typing import NamedTuple

from steerd.car_model.actuators import actuate
from steerd.car_model.model import Model, Moment, aim, car_now, memory_size
from steerd.car_model.native.windows import (
    STATES,
    Kernels,
    car_numbers,
    make_kernels,
    parameter_vector,
)
from steerd.car_model.ops import FLOAT
from steerd.car_model.rollout import glide
from steerd.car_model.rollout import step as step_floats
from steerd.car_model.state import Command, State

Numbers = tuple[float, ...]


class Steps(NamedTuple):
    """A step and its two halves, over plain floats."""

    memory: int  # how many numbers the car remembers beside its state; all begin at zero
    # ``follow(*state, *memory, steer, speed, t)`` gives state and memory
    follow: Callable[..., Numbers]
    # Takes the same, gives the steering angle at the step's end and the acceleration
    actuate: Callable[..., Numbers]
    # ``glide(count, *state, *memory, steer_end, accel, t)`` gives state and memory, by `count`
    # shorter steps
    glide: Callable[..., Numbers]


@lru_cache(maxsize=64)
def make_steps(model: Model[float], h: float) -> Steps:
    """Steps of `h` seconds; kept, since a second car of the same make (a seed, a fault) is alike.

    Raises:
        LibraryError: the library was not built.
    """
    try:
        kernels = make_kernels(model.effects, model.chassis)
    except ValueError:
        return plain_steps(model, h)
    size = STATES + kernels.memory

    @lru_cache(maxsize=16)
    def part(count: int) -> Callable[..., Numbers]:
        return _compiled(kernels, model, "glide", size, h, count)

    return Steps(
        kernels.memory,
        _compiled(kernels, model, "follow", size, h),
        _compiled(kernels, model, "actuated", 2, h),
        lambda count, *numbers: part(count)(*numbers),
    )


def _compiled(
    kernels: Kernels, model: Model[float], name: str, size: int, h: float, count: int = 1
) -> Callable[..., Numbers]:
    """A function of the library that takes state, memory and three numbers and gives `size`."""
    car = car_numbers(kernels, parameter_vector(model), h / count, "rk4", count)
    function, given = kernels.function(name), Struct(f"={STATES + kernels.memory + 3}d")
    taken, integration = Struct(f"={size}d"), byref(car.integration)
    memory = bytearray(taken.size)
    into = (c_char * taken.size).from_buffer(memory)

    def call(*numbers: float, _alive: object = car) -> Numbers:
        function(integration, given.pack(*numbers), into)
        found = taken.unpack(memory)
        if not -inf < sum(found) < inf:
            raise ValueError(f"the simulated car's motion is no number after {numbers}")
        return found

    return call


def plain_steps(model: Model[float], h: float) -> Steps:
    """The same on floats."""
    memory = memory_size(model.effects)

    def split(numbers: Numbers) -> tuple[Moment[float], Numbers]:
        return Moment(State(*numbers[:STATES]), numbers[STATES:-3]), numbers[-3:]

    def follow_floats(*numbers: float) -> Numbers:
        moment, (steer, speed, t) = split(numbers)
        after = step_floats(FLOAT, model, moment, Command(steer, speed), t, h)
        return (*after.state, *after.memory)

    def actuate_floats(*numbers: float) -> Numbers:
        moment, (steer, speed, t) = split(numbers)
        car = car_now(FLOAT, model, moment.state, t)
        ref = aim(FLOAT, model, car, Command(steer, speed), t)
        return tuple(actuate(FLOAT, car, moment.state, ref, h))

    def glide_floats(count: int, *numbers: float) -> Numbers:
        moment, (end, accel, t) = split(numbers)
        begun, part = moment.state.steer, h / count
        for i in range(count):
            steer = begun + (end - begun) * (i + 1) / count
            moment = glide(FLOAT, model, moment, steer, accel, t + i * part, part)
        return (*moment.state, *moment.memory)

    return Steps(memory, follow_floats, actuate_floats, glide_floats)
