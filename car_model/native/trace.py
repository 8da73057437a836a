"""Records the equations of a car with effects: the source of the compiled kernels.

`car_model` is run once over a tape in the order in which a step uses it: actuators, rates,
memory, observation. No equation is written twice: the traced code also moves the simulated car.
"""

from itertools import chain
from typing import Any, NamedTuple

from steerd.car_model.chassis import Chassis
from steerd.car_model.effect import Effect
from steerd.car_model.model import (
    Model,
    bound_hooks,
    car_now,
    delays,
    link,
    memory_size,
    model_rates,
    observe,
    remember,
)
from steerd.car_model.params import Car
from steerd.car_model.rollout import move_actuators
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Arriving, Command, State
from steerd.car_model.tape import TAPE, Node, Tape

CHASSIS: tuple[str, ...] = State._fields[: State._fields.index("steer")]
"""States that the rates move; the actuators move the steer, which comes after them."""


class Piece(NamedTuple):
    """A block of formulas with named inputs."""

    inputs: tuple[Node, ...]  # symbols that change from step to step, differentiated
    outputs: tuple[Node, ...]  # formulas in inputs, parameters, `t` and `h`


class Traced(NamedTuple):
    """All formulas of one model."""

    parameters: tuple[str, ...]  # names, car fields first, then `effect.parameter`
    symbols: tuple[Node, ...]  # a symbol for each parameter
    memory: int  # how many numbers the effects remember
    # (states, memory, commands, time) -> wheel at start and end, steer at end, accel, memory
    actuators: Piece
    rates: Piece  # (chassis states, wheel, accel, memory, time) -> rates of the chassis states
    linkage: Piece  # (steer at start and end, memory) -> wheel at start and end, memory
    # (chassis before, wheel before, chassis after, wheel after, memory, time) -> memory
    remember: Piece
    remembers: bool  # whether `remember` does anything
    observe: Piece  # states -> x, y, yaw, wheel speed, yaw rate
    delays: tuple[Node, ...]  # dead times of steer, drive and pose, in the parameters
    t: Node  # time into the run; h: the step
    h: Node
    tape: Tape


def parameter_names(effects: tuple[Effect, ...]) -> tuple[str, ...]:
    """Names of all parameters: the car's fields, then `effect.parameter` for each effect."""
    own = (f"{effect.name}.{p.name}" for effect in effects for p in effect.parameters)
    return (*Car._fields, *own)


def _inputs(tape: Tape, *names: str) -> tuple[Node, ...]:
    return tuple(tape.symbol(name) for name in names)


class _Symbols(NamedTuple):
    tape: Tape
    model: Model[Node]
    state: State[Node]
    memory: tuple[Node, ...]
    t: Any
    h: Any


def _trace_actuators(s: _Symbols) -> Piece:
    commands = [
        Command(*_inputs(s.tape, f"{name}_steer", f"{name}_speed"))
        for name in ("newer", "older", "share")
    ]
    out = move_actuators(TAPE, s.model, s.state, Arriving(*commands), s.t, s.h)
    wheel_start, linked = link(TAPE, s.model, s.memory, s.state.steer)
    wheel_end, linked = link(TAPE, s.model, linked, out.steer)
    return Piece(
        (*s.state, *s.memory, *chain.from_iterable(commands), s.t),
        (wheel_start, wheel_end, out.steer, out.accel, *linked),
    )


def _trace_linkage(s: _Symbols) -> Piece:
    (end,) = _inputs(s.tape, "steer_end")
    wheel_start, linked = link(TAPE, s.model, s.memory, s.state.steer)
    wheel_end, linked = link(TAPE, s.model, linked, end)
    return Piece((s.state.steer, end, *s.memory), (wheel_start, wheel_end, *linked))


def _trace_rates(s: _Symbols) -> Piece:
    wheel, accel = _inputs(s.tape, "wheel", "accel")
    rolling = s.state._replace(steer=wheel)
    car = car_now(TAPE, s.model, rolling, s.t)
    rates = model_rates(TAPE, s.model, car, s.memory, rolling, wheel, accel)
    return Piece((*s.state[: len(CHASSIS)], wheel, accel, *s.memory, s.t), tuple(rates))


def _trace_remember(s: _Symbols) -> Piece:
    rest = s.tape.constant(0.0)
    slip_angles = s.model.chassis.slip_angles
    before: State[Node] = State(*_inputs(s.tape, *(f"{n}_before" for n in State._fields)))
    after: State[Node] = State(*_inputs(s.tape, *(f"{n}_after" for n in State._fields)))
    car = car_now(TAPE, s.model, before, s.t)
    ends = tuple(slip_angles(TAPE, car, at, at.steer, rest) for at in (before, after))
    later = remember(TAPE, s.model, s.memory, after.speed, ends, s.h)
    return Piece((*before, *after, *s.memory, s.t), later)


def trace(effects: tuple[Effect, ...] = (), chassis: Chassis = SINGLE_TRACK) -> Traced:
    """Record a car with these effects on this chassis; every parameter stays an input."""
    tape = Tape()
    every = _inputs(tape, *parameter_names(effects))
    rest = iter(every[len(Car._fields) :])
    values = tuple(tuple(next(rest) for _ in effect.parameters) for effect in effects)
    model = Model(Car(*every[: len(Car._fields)]), effects, values, chassis)
    state: State[Node] = State(*_inputs(tape, *State._fields))
    memory = _inputs(tape, *(f"memory_{i}" for i in range(memory_size(effects))))
    t, h = _inputs(tape, "t", "h")
    symbols = _Symbols(tape, model, state, memory, t, h)
    return Traced(
        parameters=parameter_names(effects),
        symbols=every,
        memory=len(memory),
        actuators=_trace_actuators(symbols),
        rates=_trace_rates(symbols),
        linkage=_trace_linkage(symbols),
        remember=_trace_remember(symbols),
        remembers=bool(bound_hooks(effects, "remember")),
        observe=Piece(tuple(state), tuple(observe(TAPE, model, state))),
        delays=tuple(delays(model)),
        t=t,
        h=h,
        tape=tape,
    )
