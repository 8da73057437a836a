"""The car with effects: the base equations with every active effect's hooks in their places."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Generic, NamedTuple

from steerd.car_model.actuators import references
from steerd.car_model.chassis import Axles, Chassis, Rates, lateral_forces
from steerd.car_model.effect import HOOKS, BoundHook, Contact, Effect
from steerd.car_model.effects import EFFECTS
from steerd.car_model.ops import FLOAT, Ops, T
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import ORIGIN, Command, Delays, Observation, State

_RANK = {name: place for place, name in enumerate(EFFECTS)}


class Model(NamedTuple, Generic[T]):
    """A car, the effects switched on, their parameter values (one tuple per effect), a chassis."""

    car: Car[T]
    effects: tuple[Effect, ...] = ()
    values: tuple[tuple[T, ...], ...] = ()
    chassis: Chassis = SINGLE_TRACK


class Moment(NamedTuple, Generic[T]):
    """The car at one instant: its state and what the effects remember."""

    state: State[T]
    memory: tuple[T, ...] = ()


@lru_cache(maxsize=4096)
def bound_hooks(effects: tuple[Effect, ...], name: str) -> tuple[BoundHook, ...]:
    """The hooks called `name` of all effects, each with its slice of the memory.

    They act in the order of `EFFECTS`, in whatever order a car names them: it is one car.
    """
    bound: list[BoundHook] = []
    start = 0
    for index, effect in enumerate(effects):
        stop = start + effect.memory
        hook = getattr(effect, name)
        if hook is not None:
            bound.append(BoundHook(hook, index, start, stop))
        start = stop
    return tuple(sorted(bound, key=lambda b: _RANK.get(effects[b.position].name, len(_RANK))))


def memory_size(effects: tuple[Effect, ...]) -> int:
    """How many numbers the effects remember between steps."""
    return sum(effect.memory for effect in effects)


def hooked(effects: tuple[Effect, ...]) -> frozenset[str]:
    """Names of the hooks that at least one of the effects uses."""
    return frozenset(name for name in HOOKS if bound_hooks(effects, name))


def delays(model: Model[T]) -> Delays[T]:
    """Dead time of each channel [s]: the car's own and what effects add."""
    total = Delays(model.car.steer_delay, model.car.drive_delay, model.car.pose_delay)
    for b in bound_hooks(model.effects, "delays"):
        extra = b.hook(model.values[b.position])
        total = Delays(*(a + b for a, b in zip(total, extra, strict=True)))
    return total


def car_now(ops: Ops[T], model: Model[T], state: State[T], t: float) -> Car[T]:
    """The car's parameters at this place and time (`t` seconds into the run)."""
    car = model.car
    for b in bound_hooks(model.effects, "car"):
        car = b.hook(ops, model.values[b.position], car, state, t)
    return car


def aim(ops: Ops[T], model: Model[T], car: Car[T], command: Command[T], t: float) -> Command[T]:
    """What the actuators aim at for an (already delayed) command."""
    ref = references(ops, car, command)
    for b in bound_hooks(model.effects, "reference"):
        ref = b.hook(ops, model.values[b.position], ref, t)
    return ref


def link(ops: Ops[T], model: Model[T], memory: tuple[T, ...], angle: T) -> tuple[T, tuple[T, ...]]:
    """Road-wheel angle [rad] for an actuator angle [rad], and the memory after it."""
    wheel = angle
    for b in bound_hooks(model.effects, "linkage"):
        wheel, own = b.hook(ops, model.values[b.position], memory[b.start : b.stop], wheel)
        memory = (*memory[: b.start], *own, *memory[b.stop :])
    return wheel, memory


def model_rates(
    ops: Ops[T],
    model: Model[T],
    car: Car[T],
    memory: tuple[T, ...],
    state: State[T],
    wheel: T,
    accel: T,
) -> Rates[T]:
    """Rates of the chassis states with every effect in its place."""
    slips = model.chassis.slip_angles(ops, car, state, wheel, accel)
    for b in bound_hooks(model.effects, "slips"):
        slips = b.hook(ops, model.values[b.position], memory[b.start : b.stop], slips)
    loads = model.chassis.axle_loads(ops, car, state, accel)
    at = Contact(car, state, wheel, accel, slips, loads, lateral_forces(car, slips, loads))
    for b in bound_hooks(model.effects, "forces"):
        at = at._replace(forces=b.hook(ops, model.values[b.position], at))
    rates = model.chassis.rates(ops, car, state, wheel, accel, loads, at.forces)
    for b in bound_hooks(model.effects, "rates"):
        rates = b.hook(ops, model.values[b.position], at, rates)
    return rates


def remember(
    ops: Ops[T],
    model: Model[T],
    memory: tuple[T, ...],
    speed: T,
    ends: Sequence[Axles[T]],
    h: float,
) -> tuple[T, ...]:
    """Memory after a step; `ends` holds the steady slip angles before and after it."""
    for b in bound_hooks(model.effects, "remember"):
        own = b.hook(
            ops, model.values[b.position], memory[b.start : b.stop], speed, ends[0], ends[1], h
        )
        memory = (*memory[: b.start], *own, *memory[b.stop :])
    return memory


def observe(ops: Ops[T], model: Model[T], state: State[T]) -> Observation[T]:
    """What pose, wheel speed and gyro would read at this instant, without noise or latency."""
    wheel_speed = state.speed / model.car.speed_gain
    seen = Observation(state.x, state.y, state.yaw, wheel_speed, state.yaw_rate)
    for b in bound_hooks(model.effects, "observe"):
        seen = b.hook(ops, model.values[b.position], state, seen)
    return seen


_FAR = 1e6  # a place outside every patch of floor [m]


def believed_car(model: Model[float]) -> Car[float]:
    """The car's parameters with those effects folded in that are changes of parameters.

    Dead times add up; gains, lags, limits, stiffnesses, masses and lengths are as the effects make
    them at the start of a drive and away from special places. What has no counterpart among the
    parameters (backlash, a saturating tyre, a slope) is left out. Without effects nothing changes.
    """
    car = car_now(FLOAT, model, ORIGIN._replace(x=_FAR, y=_FAR, speed=1.0), 0.0)
    late = delays(model)
    return car._replace(steer_delay=late.steer, drive_delay=late.drive, pose_delay=late.pose)
