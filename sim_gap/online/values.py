"""The car's numbers as learnt, by how much a change moved it, and what a controller is to follow.

Of a change, what the car was learnt to have before is taken off: a base may have the effect
already, and a lane may not say of it where it lies (a marker's place and the centre of gravity move
along one valley). How far either moved is known far better.

A controller follows changes that were named beyond doubt, and those numbers of the base that a lane
identifies by themselves. Of sets of names only one that means the same to a loop is followed, or
one with a name that has stood alone. Whatever is in doubt is the car file's business.
"""

# Why: docs/decisions/filter-and-controller.md#d86, docs/decisions/filter-and-controller.md#d99
# Why: docs/decisions/filter-and-controller.md#d102, docs/decisions/filter-and-controller.md#d105

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from steerd.car_model.effect import Role
from steerd.car_model.effects import EFFECTS, find_effect
from steerd.car_model.model import Model, believed_car
from steerd.car_model.params import PARAMETERS, Car
from steerd.controller.learnt import Learnt, learnt_of
from steerd.sim_gap.online.learner import SETTLED, Change, Learner, State
from steerd.sim_gap.online.naming import Known
from steerd.sim_gap.verdict.confidence import Cause
from steerd.sysid.inference.augmented_car import AugmentedCar

INFORMED = 0.5  # a drive identifies a number whose standard deviation it halves
SHARP = 0.03  # or that is known to this share of its bounds' half width, from before
Amount = tuple[float, float, str]
UNITS = {p.name: p.unit for p in PARAMETERS}
UNITS |= {f"{e.name}.{p.name}": p.unit for e in EFFECTS.values() for p in e.parameters}


class Value(NamedTuple):
    """One number of the base."""

    name: str  # `name`, or `effect.name` of an effect that the base has
    value: float  # the estimate, with its standard deviation `sd`; SI units
    sd: float
    unit: str  # of both
    identifiable: bool  # whether the drive identifies it


def values_of(known: Known) -> tuple[Value, ...]:
    """Every free number of the base."""
    space, track = known.reference.space, known.track
    n = space.nuisance
    z = space.centre.copy()
    z[:n] += track.mean
    slopes = space.chart.slopes(z)[:, :n]
    parameters = space.chart.parameters(z)
    spread = np.sqrt(np.diag(slopes @ track.covariance @ slopes.T))
    before = np.sqrt(np.diag(slopes @ space.covariance[:n, :n] @ slopes.T))
    found = []
    for name in space.chart.free[:n]:
        place = space.chart.names.index(name)
        sd, width = float(spread[place]), space.chart.high[place] - space.chart.low[place]
        informed = sd < INFORMED * before[place] or sd < SHARP * 0.5 * width
        found.append(Value(name, float(parameters[place]), sd, UNITS[name], bool(informed)))
    return tuple(found)


def amounts_of(change: Change) -> dict[str, Amount]:
    """What the named effect's parameters moved by: (value, standard error, unit) by name.

    Offsets are differences and ratios quotients, to what was before. What says of which form or
    where an effect is, has no amount: it is as it is after the change. Empty without a name.
    """
    cause = change.finding.cause
    if cause is None:
        return {}
    moved: dict[str, Amount] = {}
    for p, before in zip(find_effect(cause.effect).parameters, change.was, strict=True):
        value, sd, unit = cause.parameters[p.name]
        if p.role is Role.SIZE and is_ratio(p.null, before):
            value, sd = value / before, sd / before
        elif p.role is Role.SIZE:
            value -= before
        moved[p.name] = value, sd, unit
    return moved


def is_ratio(null: float, before: float) -> bool:
    """Whether a parameter scales what the car has; its null is then one."""
    return null == 1.0 and before > 0.0


SURE = 0.8  # a name, or a set of which each is lateness, is followed from this confidence on
BY_ITSELF = ("steer_bias", "speed_gain")  # a lane identifies them whatever the model misses
BEYOND_DOUBT = 3.0  # standard deviations by which a number must have moved to be followed
LATENESS = frozenset(("steer_delay", "steer_lag", "mocap_latency"))
"""Effects that a lane barely distinguishes and a lane keeper need not: each is time that passes
between a pose and what the wheels do about it. A set of these is followed as its likeliest."""
_BODY = (("mocap_yaw", "body_yaw"), ("marker_offset", "body_forward", "body_left"))


def find_aim(learner: Learner, state: State) -> Learnt | str:
    """The numbers to follow, or why none are."""
    if state.known is None:
        return "the car is being learnt"
    current = () if state.change is None else (state.change,)
    named = [_named(change) for change in (*state.past, *current)]
    problem = next((each for each in named if isinstance(each, str)), "")
    if problem:
        return problem
    if state.change is not None and len(state.change.windows) < SETTLED:
        return "a change is being looked into"
    file = _numbers(learner.augmented, ())
    now = _numbers(learner.augmented, [each for each in named if not isinstance(each, str)])
    # A base that was learnt anew is held near the file's: a change that was named knows better.
    own = _by_itself(learner, state)
    same = [name for name in own if getattr(now, name) == getattr(file, name)]
    return now._replace(**{name: own[name] for name in same})


def _named(change: Change) -> tuple[Cause, tuple[float, ...]] | str:
    """What a change is followed as and what the effect's parameters were before, or why it is not.

    Its name, or that which stood alone before others came beside it.
    """
    cause, was = change.finding.cause, change.was
    if cause is None:
        unexplained = change.finding.verdict == "unexplained"
        return "a change is unexplained" if unexplained else "a change is being looked into"
    sure, others = cause.confidence, cause.ambiguous_with
    if others and change.proven is not None:
        proven, before = change.proven
        if cause.effect == proven.effect:
            cause, was, others = replace(cause, ambiguous_with=()), before, ()
        elif proven.effect in others:
            (cause, was), others = change.proven, ()
    if others and not LATENESS.issuperset((cause.effect, *others)):
        return f"a change is {cause.effect} or {' or '.join(others)}"
    if others:
        sure = change.finding.sure
    return (cause, was) if sure >= SURE else "the name of a change is not sure"


def _by_itself(learner: Learner, state: State) -> dict[str, float]:
    """Numbers of the base that the drive identifies and that are not the file's."""
    if state.known is None:
        return {}
    file, names = learner.augmented.base, learner.augmented.kernels.names
    shown = [v for v in values_of(state.known) if v.name in BY_ITSELF and v.identifiable]
    away = [abs(v.value - float(file[names.index(v.name)])) for v in shown]
    return {
        v.name: v.value for v, off in zip(shown, away, strict=True) if off > BEYOND_DOUBT * v.sd
    }


def _numbers(augmented: AugmentedCar, changes: Sequence[tuple[Cause, tuple[float, ...]]]) -> Learnt:
    """The file's car with these changes (see `_named`), as the numbers of a controller."""
    now = {e.name: augmented.values(e.name) for e in augmented.effects}
    for cause, was in changes:
        now[cause.effect] = tuple(_shifted(cause, was, now[cause.effect]))
    own = Car(*(float(value) for value in augmented.base[: len(Car._fields)]))
    values = tuple(now[e.name] for e in augmented.effects)
    car = believed_car(Model(own, augmented.effects, values, augmented.kernels.chassis))
    found = learnt_of(
        car._replace(c_sf=car.c_sf * car.mu / own.mu, c_sr=car.c_sr * car.mu / own.mu)
    )
    moved = {cause.effect for cause, _ in changes}
    for effect, *names in _BODY:
        if effect in moved:
            found = found._replace(**dict(zip(names, now[effect], strict=True)))
    return found


def _shifted(cause: Cause, was: tuple[float, ...], values: tuple[float, ...]) -> Iterator[float]:
    """An effect's parameters after a change: offsets add up, ratios multiply.

    One that moved by no more than chance stays as it was: of a marker that was pushed forwards a
    lane shows to a millimetre or two that it is still in the middle, which is what it keeps to.
    """
    nulls = find_effect(cause.effect).nulls
    rows = zip(values, cause.parameters.values(), was, nulls, strict=True)
    for value, (after, sd, _), before, null in rows:
        if abs(after - before) <= BEYOND_DOUBT * sd:
            yield value
        else:
            yield value * after / before if is_ratio(null, before) else value + after - before
