"""The car model's step as straight-line Python: its own equations, run over a recording number.

`car_model` is generic over the number type. Here it runs once over numbers that write down each
operation, and the record is compiled: the same operations on the same floats in the same order
(equal bit for bit, tested), without the tuples and calls between them. A step costs a third.
A model that a record cannot hold (one that branches on a value) runs as it is. Without an
effect in it, a step is machine code where there is a compiler.
"""

from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any, NamedTuple

from steerd.car_model.model import Model, Moment, aim, car_now, drive_actuators, memory_size
from steerd.car_model.ops import FLOAT, Ops
from steerd.car_model.params import Car
from steerd.car_model.rollout import glide
from steerd.car_model.state import Command, State
from steerd.car_model.straight_line import compiled
from steerd.car_model.tape import TAPE, Node, Tape
from steerd.sim_hw.plant.native.follow import make_native

Numbers = tuple[float, ...]
_Half = Callable[[Ops[Any], Model[Any], Sequence[Any]], Sequence[Any]]
_STATE = State._fields


class Steps(NamedTuple):
    """A step and its two halves, over plain floats.

    ``actuate(*state, *memory, steer, speed, t, h)`` gives the steering angle at the step's end and
    the acceleration; ``glide(*state, *memory, steer_end, accel, t, h)`` gives state and memory.
    ``follow(*state, *memory, steer, speed, t, h)`` is both.
    """

    actuate: Callable[..., Numbers]
    glide: Callable[..., Numbers]
    follow: Callable[..., Numbers]
    unrolled: bool


@lru_cache(maxsize=64)
def make_steps(model: Model[float]) -> Steps:
    """The halves of a step of this model, unrolled where that is possible.

    Kept: a second car of the same make (the next seed, the next fault) costs nothing.
    """
    try:
        return Steps(**{name: _make_half(model, name) for name in _HALVES}, unrolled=True)
    except TypeError:
        halves = {name: _plain(model, half) for name, half in _HALVES.items()}
        return Steps(**halves, unrolled=False)


def _make_half(model: Model[float], name: str) -> Callable[..., Numbers]:
    """In machine code where that is possible; recorded only when it is asked for."""
    in_python = cache(lambda: _unroll(model, _HALVES[name]))
    return make_native(model, name, lambda *numbers: in_python()(*numbers)) or in_python()


def _actuate(ops: Ops[Any], model: Model[Any], numbers: Sequence[Any]) -> Sequence[Any]:
    state, _, (steer, speed, t, h) = _split(model, numbers)
    car = car_now(ops, model, state, t)
    ref = aim(ops, model, car, Command(steer, speed), t)
    return drive_actuators(ops, model, car, state, ref, h)


def _glide(ops: Ops[Any], model: Model[Any], numbers: Sequence[Any]) -> Sequence[Any]:
    state, memory, (steer, accel, t, h) = _split(model, numbers)
    car = car_now(ops, model, state, t)
    after = glide(ops, model, car, Moment(state, memory), steer, accel, h)
    return (*after.state, *after.memory)


def _follow(ops: Ops[Any], model: Model[Any], numbers: Sequence[Any]) -> Sequence[Any]:
    return _glide(ops, model, [*numbers[:-4], *_actuate(ops, model, numbers), *numbers[-2:]])


_HALVES: dict[str, _Half] = {"actuate": _actuate, "glide": _glide, "follow": _follow}


def _split(
    model: Model[Any], numbers: Sequence[Any]
) -> tuple[State[Any], tuple[Any, ...], Sequence[Any]]:
    end = len(_STATE) + memory_size(model.effects)
    return State(*numbers[: len(_STATE)]), tuple(numbers[len(_STATE) : end]), numbers[end:]


def _plain(model: Model[float], half: _Half) -> Callable[..., Numbers]:
    return lambda *numbers: tuple(half(FLOAT, model, numbers))


def _unroll(model: Model[float], half: _Half) -> Callable[..., Numbers]:
    """Run a half once over recorded numbers and compile the record.

    Raises:
        TypeError: it needs a number's value.
    """
    tape = Tape(exact=True)
    values = tuple(tuple(map(tape.constant, own)) for own in model.values)
    fixed = Model(Car(*map(tape.constant, model.car)), model.effects, values, model.chassis)
    return compiled(*_record(tape, fixed, half))


def record_half(tape: Tape, model: Model[Node], name: str) -> tuple[list[Node], list[Node]]:
    """Inputs and outputs of a field of `Steps`, of a model whose numbers are on the tape."""
    return _record(tape, model, _HALVES[name])


def _record(tape: Tape, model: Model[Node], half: _Half) -> tuple[list[Node], list[Node]]:
    memory = (f"memory_{i}" for i in range(memory_size(model.effects)))
    inputs = [tape.symbol(name) for name in (*_STATE, *memory, "first", "second", "t", "h")]
    return inputs, [tape.node(result) for result in half(TAPE, model, inputs)]
