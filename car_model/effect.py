"""What an unmodelled effect is: a value with parameters and functions for the links it touches.

There are four stages, and they are the four places where a gap between simulation and car can lie.
A hook gets the quantity that the base equations computed and returns it changed; at the null of its
parameters it must return it unchanged, bit for bit. An effect may keep memory between steps (the
play of a linkage, the build-up of a tyre force).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, Protocol

from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.single_track import Actuated, Axles, Rates
from steerd.car_model.state import Command, Delays, Observation, State


class Stage(StrEnum):
    """Where in the chain from command to measurement an effect acts."""

    COMMAND = "command"
    ACTUATOR = "actuator"
    FORCES = "forces"
    OBSERVE = "observe"


class EffectParameter(NamedTuple):
    """One number of an effect."""

    name: str
    null: float
    """The value at which the effect changes nothing."""
    low: float
    high: float
    unit: str
    scale: float
    """Prior standard deviation about the null: what is ordinary on a car of this class."""
    meaning: str
    scan: tuple[float, ...] = ()
    """Values worth trying where the gradient at the null says nothing."""


class DelayHook(Protocol):
    """Dead times to add to each channel [s]."""

    def __call__(self, p: Sequence[T]) -> Delays[T]: ...


class CarHook(Protocol):
    """The car's parameters at this moment (`t` seconds into the run)."""

    def __call__(
        self, ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], t: float
    ) -> Car[T]: ...


class ReferenceHook(Protocol):
    """What the actuators aim at."""

    def __call__(self, ops: Ops[T], p: Sequence[T], ref: Command[T], t: float) -> Command[T]: ...


class ActuatedHook(Protocol):
    """Where the actuators get to within a step of `h` seconds."""

    def __call__(
        self,
        ops: Ops[T],
        p: Sequence[T],
        car: Car[T],
        state: State[T],
        ref: Command[T],
        h: float,
        out: Actuated[T],
    ) -> Actuated[T]: ...


class LinkageHook(Protocol):
    """Road-wheel angle for an actuator angle, and the memory after it."""

    def __call__(
        self, ops: Ops[T], p: Sequence[T], memory: Sequence[T], angle: T
    ) -> tuple[T, tuple[T, ...]]: ...


class SlipHook(Protocol):
    """Slip angles that the tyres feel."""

    def __call__(
        self, ops: Ops[T], p: Sequence[T], memory: Sequence[T], slips: Axles[T]
    ) -> Axles[T]: ...


class LoadHook(Protocol):
    """Vertical loads of the axles [N]."""

    def __call__(
        self, ops: Ops[T], p: Sequence[T], car: Car[T], state: State[T], accel: T, loads: Axles[T]
    ) -> Axles[T]: ...


class ForceHook(Protocol):
    """Lateral forces of the axles [N]."""

    def __call__(
        self,
        ops: Ops[T],
        p: Sequence[T],
        car: Car[T],
        slips: Axles[T],
        loads: Axles[T],
        accel: T,
        forces: Axles[T],
    ) -> Axles[T]: ...


class RateHook(Protocol):
    """Time derivatives of the chassis states."""

    def __call__(
        self,
        ops: Ops[T],
        p: Sequence[T],
        car: Car[T],
        state: State[T],
        wheel: T,
        forces: Axles[T],
        rates: Rates[T],
    ) -> Rates[T]: ...


class RememberHook(Protocol):
    """Memory after a step of `h` seconds; `before` and `after` are the slips at its ends."""

    def __call__(
        self,
        ops: Ops[T],
        p: Sequence[T],
        memory: Sequence[T],
        speed: T,
        before: Axles[T],
        after: Axles[T],
        h: float,
    ) -> tuple[T, ...]: ...


class ObserveHook(Protocol):
    """What the instruments read."""

    def __call__(
        self, ops: Ops[T], p: Sequence[T], state: State[T], seen: Observation[T]
    ) -> Observation[T]: ...


@dataclass(frozen=True, eq=False)
class Effect:
    """An unmodelled effect. Only the hooks that it needs are given."""

    name: str
    stage: Stage
    family: str
    """timing, steering, drive, tyre, mass, ground or sensor: what a person would look at."""
    summary: str
    equation: str
    parameters: tuple[EffectParameter, ...]
    memory: int = 0
    """How many numbers it remembers from step to step; all start at zero."""
    delays: DelayHook | None = None
    car: CarHook | None = None
    reference: ReferenceHook | None = None
    actuated: ActuatedHook | None = None
    linkage: LinkageHook | None = None
    slips: SlipHook | None = None
    loads: LoadHook | None = None
    forces: ForceHook | None = None
    rates: RateHook | None = None
    remember: RememberHook | None = None
    observe: ObserveHook | None = None
    smooth: bool = True
    """Whether the gradient at the null says in which direction to go (a limit's does not)."""
    aliases: tuple[str, ...] = ()
    """Other names that people use for it."""

    @property
    def nulls(self) -> tuple[float, ...]:
        """Parameter values at which the effect changes nothing."""
        return tuple(parameter.null for parameter in self.parameters)


HOOKS: tuple[str, ...] = (
    "delays",
    "car",
    "reference",
    "actuated",
    "linkage",
    "slips",
    "loads",
    "forces",
    "rates",
    "remember",
    "observe",
)


class Bound(NamedTuple):
    """One hook of one effect in a model: which values and which memory it gets."""

    hook: Callable[..., Any]
    position: int
    """Which of the model's effects, hence which tuple of values."""
    start: int
    stop: int
