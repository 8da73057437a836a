"""What an unmodelled effect is: a value with parameters and functions for the links it touches.

There are four stages, and they are the four places where a gap between simulation and car can lie.
A hook gets the quantity that the base equations computed and returns it changed; at the null of its
parameters it must return it unchanged, bit for bit. An effect may keep memory between steps (the
play of a linkage, the build-up of a tyre force).
"""

# Why: docs/decisions/vehicle-model.md#d6

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Generic, NamedTuple

from steerd.car_model.chassis import Axles, Rates
from steerd.car_model.ops import Ops, T
from steerd.car_model.params import Car
from steerd.car_model.state import Command, Delays, Observation, State

_EDGE = 1e-6  # a value so near a bound is at it [share of the range]


class Stage(StrEnum):
    """Where in the chain from command to measurement an effect acts."""

    COMMAND = "command"
    ACTUATOR = "actuator"
    FORCES = "forces"
    OBSERVE = "observe"


class Channel(StrEnum):
    """A channel of the command."""

    STEER = "steer"
    SPEED = "speed"


class Role(StrEnum):
    """What a parameter says of its effect."""

    SIZE = "size"  # how large the effect is: its distance from the null counts in the effect's size
    FORM = "form"  # of what form it is: it changes nothing while the others are at their nulls
    PLACE = "place"
    """Where it acts: no part of its size, but a value at a bound means another cause."""


class Confounding(NamedTuple):
    """Other effects whose data look the same, exactly or nearly."""

    effects: tuple[str, ...]  # their names
    note: str = ""
    """Which effect it looks like under which condition; a report prints it beside the name."""
    alike: bool = False
    """Whether no drive distinguishes them, or only an equation's form: then all are named."""


class EffectParameter(NamedTuple):
    """One number of an effect."""

    name: str
    null: float  # the value at which the effect changes nothing
    low: float
    high: float
    unit: str
    scale: float  # prior standard deviation about the null: what is ordinary on a car of this class
    meaning: str
    scan: tuple[float, ...] = ()  # values worth trying where the gradient at the null is zero
    role: Role = Role.SIZE


class Contact(NamedTuple, Generic[T]):
    """The car on its tyres at one instant."""

    car: Car[T]
    state: State[T]
    wheel: T  # road-wheel angle [rad]
    accel: T  # longitudinal acceleration [m/s^2]
    slips: Axles[T]  # slip angles that the tyres feel [rad]
    loads: Axles[T]  # vertical [N]
    forces: Axles[T]  # lateral [N]


Values = Sequence[T]  # the numbers of an effect: its parameters `p`, or what it remembers

ScanHook = Callable[[Sequence[tuple[float, float, float]]], Sequence[tuple[float, ...]]]
"""(discs): values of all parameters worth trying; errors are larger in discs (x, y, radius) [m]."""
DelayHook = Callable[[Values[T]], Delays[T]]  # (p): dead times to add to each channel [s]
CarHook = Callable[[Ops[T], Values[T], Car[T], State[T], float], Car[T]]
"""(ops, p, car, state, t): the car's parameters `t` seconds into the run."""
ReferenceHook = Callable[[Ops[T], Values[T], Command[T], float], Command[T]]
"""(ops, p, ref, t): what the actuators aim at."""
LinkageHook = Callable[[Ops[T], Values[T], Values[T], T], tuple[T, tuple[T, ...]]]
"""(ops, p, memory, angle): road-wheel angle for an actuator angle, and the memory after it."""
SlipHook = Callable[[Ops[T], Values[T], Values[T], Axles[T]], Axles[T]]
"""(ops, p, memory, slips): slip angles that the tyres feel."""
ForceHook = Callable[[Ops[T], Values[T], Contact[T]], Axles[T]]
"""(ops, p, at): lateral forces of the axles [N], changed from `at.forces`."""
RateHook = Callable[[Ops[T], Values[T], Contact[T], Rates[T]], Rates[T]]
"""(ops, p, at, rates): time derivatives of the chassis states."""
RememberHook = Callable[[Ops[T], Values[T], Values[T], T, Axles[T], Axles[T], float], tuple[T, ...]]
"""(ops, p, memory, speed, before, after, h): memory after `h` seconds; slips at both ends."""
ObserveHook = Callable[[Ops[T], Values[T], State[T], Observation[T]], Observation[T]]
"""(ops, p, state, seen): what the instruments read."""


@dataclass(frozen=True, eq=False)
class Effect:
    """An unmodelled effect: all that simulation, identification and diagnosis know of it.

    Only the hooks that it needs are given.
    """

    name: str
    stage: Stage
    family: str
    """timing, steering, drive, tyre, mass, ground or sensor: what a person would look at."""
    summary: str
    equation: str
    parameters: tuple[EffectParameter, ...]
    least_size: float
    """Least size that matters in practice: smaller changes are no gap (see `size`).

    About half of what shows at five standard errors in eight drives of 12 s; 0 where the distance
    from the null says nothing, as for a limit, which matters as soon as something meets it.
    Source: docs/reference/diagnosis.md#g1.2.
    """
    confounded_with: Confounding | None = None
    """What it looks like exactly, or nearly under a condition; None: nothing known."""
    needs_commands: Channel | None = None
    """The command without which drives cannot show it; None: the motion alone shows it."""
    in_base: bool = True
    """Whether it may be part of a healthy car; False: a matter of a place or a day, or not
    identifiable from poses, hence always a gap."""
    at_once: bool = True
    """Whether a few seconds of driving show it; False: it depends on the place, or grows slowly."""
    same_as: tuple[str, ...] = ()
    """Parameters of the base that are the same physical quantity: while the effect is free in a
    hypothesis they are not, for nothing is free twice."""
    changes: bool = True
    """Whether it may differ from one drive to the next; False: it is a property of the car."""
    on_every_car: bool = False
    """Whether no car is without it: the base learnt from healthy drives then always has it."""
    follows_acceleration: bool = False
    """Whether it follows the acceleration, which is mostly noise where the measured speed stands in
    for the command: a base then goes without it."""
    built_into: tuple[str, ...] = ()
    """Chassis whose own equations contain it: on those it is no effect."""
    scan: ScanHook | None = None
    """Values worth trying where they depend on the drives; else each parameter's own scan."""
    memory: int = 0  # how many numbers it remembers from step to step; all start at zero
    delays: DelayHook[Any] | None = None
    car: CarHook[Any] | None = None
    reference: ReferenceHook[Any] | None = None
    linkage: LinkageHook[Any] | None = None
    slips: SlipHook[Any] | None = None
    forces: ForceHook[Any] | None = None
    rates: RateHook[Any] | None = None
    remember: RememberHook[Any] | None = None
    observe: ObserveHook[Any] | None = None
    aliases: tuple[str, ...] = ()  # other names that people use for it

    @property
    def nulls(self) -> tuple[float, ...]:
        """Parameter values at which the effect changes nothing."""
        return tuple(parameter.null for parameter in self.parameters)

    @property
    def zero_gradient(self) -> bool:
        """Whether the gradient at the null is zero (a limit, play), so that it is scanned."""
        return self.scan is not None or any(p.scan for p in self.parameters)

    @property
    def remembers_commands(self) -> bool:
        """Whether what it remembers comes from commands that may lie far back (play)."""
        return self.linkage is not None and self.memory > 0

    def size(self, values: Sequence[float], nulls: Sequence[float]) -> float:
        """Euclidean distance of the size parameters from their nulls, in their units."""
        numbers = zip(self.parameters, values, nulls, strict=True)
        return math.hypot(*(v - null for p, v, null in numbers if p.role is Role.SIZE))

    def is_at_bound(self, values: Sequence[float]) -> bool:
        """Whether a parameter that is not of form only is at a bound other than its null."""
        return any(
            abs(value - bound) <= _EDGE * (p.high - p.low)
            for p, value in zip(self.parameters, values, strict=True)
            for bound in (p.low, p.high)
            if p.role is not Role.FORM and bound != p.null
        )


HOOKS = (
    "delays", "car", "reference", "linkage", "slips", "forces", "rates", "remember", "observe",
)  # fmt: skip


def delay(channel: str, p: Values[T]) -> Delays[T]:
    """One channel alone comes later: a `DelayHook`, once its channel is chosen."""
    none = 0.0 * p[0]
    return Delays(none, none, none)._replace(**{channel: p[0]})


def shift(
    names: Sequence[str], ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float
) -> Car[T]:
    """These of the car's parameters, larger by the value: a `CarHook`, once they are chosen."""
    return car._replace(**{name: getattr(car, name) + p[0] for name in names})


def scale(
    names: Sequence[str], ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float
) -> Car[T]:
    """The same, multiplied by the value."""
    return car._replace(**{name: getattr(car, name) * p[0] for name in names})


def cap(
    names: Sequence[str], ops: Ops[T], p: Values[T], car: Car[T], state: State[T], t: float
) -> Car[T]:
    """The same, at most the value."""
    return car._replace(**{name: ops.minimum(getattr(car, name), p[0]) for name in names})


class BoundHook(NamedTuple):
    """One hook of one effect in a model: which values and which memory it gets."""

    hook: Callable[..., Any]
    position: int  # which of the model's effects, hence which tuple of values
    start: int
    stop: int
