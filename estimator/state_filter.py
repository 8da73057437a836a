"""The car's state, filtered: measurements fused where they belong in time, however late they come.

A `FilterState` holds the measurements of the last `history_s` in order of validity, each with the
belief after it. A new one is put in its place and the later ones are fused again. The belief at any
instant therefore depends on which measurements arrived, never on the order in which they did.

Each also carries running totals up to itself, what watchdogs W5 (innovations) and W6 (covariance)
need to know: they follow the measurements when a late one changes the decisions after it.
"""

# Why: docs/decisions/filter-and-controller.md#d9

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from steerd.car_model.actuators import references
from steerd.car_model.chassis import Chassis
from steerd.car_model.ops import FLOAT
from steerd.car_model.params import Car
from steerd.car_model.single_track import SINGLE_TRACK
from steerd.car_model.state import Command, State
from steerd.estimator.compiled import Kernel
from steerd.estimator.config import FilterConfig
from steerd.estimator.history import (
    NO_HISTORY,
    NS,
    History,
    add_command,
    command_at,
    dead_times,
    drop_older,
)
from steerd.estimator.initial import LONGEST_S, Belief, initial_belief
from steerd.estimator.sensors import ABSURD, Kind, Measurement, make_sensors
from steerd.steer_bus.quick_values import changed, quick_value

if TYPE_CHECKING:
    from steerd.estimator.reference import Reference

FUTURE_NS = 2_000_000  # a measurement from further ahead than this has a broken clock behind it


@quick_value
class Count:
    """Running totals of one instrument."""

    seen: int = 0
    refused: int = 0
    nis: float = math.nan  # normalised innovation squared of the last one, believed or not
    believed_ns: int = 0  # time of validity of the last one believed [ns]

    def age_s(self, t_ns: int) -> float:
        """Time for which the filter has coasted without a reading that it believed [s]."""
        return (t_ns - self.believed_ns) * 1e-9 if self.believed_ns > 0 else math.inf


Tally = tuple[Count, ...]  # running totals of all instruments, in the order of `Kind`
NO_TALLY: Tally = (Count(),) * len(Kind)


@quick_value
class FilterHealth:
    """The filter's own view of itself at one instant."""

    sound: bool  # mean and covariance are finite, the covariance positive definite
    position_sd: float  # along the worst direction [m]; NaN when not sound
    yaw_sd: float  # [rad]; NaN when not sound
    wheel_speed: Count
    gyro: Count
    pose: Count


def count_measurement(tally: Tally, kind: Kind, t_ns: int, nis: float, believed: bool) -> Tally:
    """The totals after one more measurement."""
    old = tally[kind]
    last_ns = t_ns if believed else old.believed_ns
    new = Count(old.seen + 1, old.refused + (not believed), nis, last_ns)
    return (*tally[:kind], new, *tally[kind + 1 :])


@quick_value
class Node:
    """A measurement in its place, and the belief after it."""

    measurement: Measurement
    belief: Belief
    nis: float  # normalised innovation squared; NaN for the first node
    believed: bool
    tally: Tally


@quick_value
class FilterState:
    """All that the filter knows. A value: every function returns a new one."""

    nodes: tuple[Node, ...] = ()  # in order of validity; empty until the first belief
    history: History = NO_HISTORY
    first_poses: tuple[Measurement, ...] = ()


@dataclass(frozen=True)
class StateFilter:
    """What does not change while it runs."""

    car: Car[float]
    config: FilterConfig
    kernel: "Kernel | Reference"  # what computes

    @cached_property
    def dead_times_ns(self) -> list[int]:
        """The car's two dead times [ns], the shorter first."""
        return sorted(dead_times(self.car))


@quick_value
class StateEstimate:
    """The car at one instant."""

    t_ns: int
    state: State[float]  # yaw is continuous, not wrapped
    sd: State[float]  # standard deviation of each state
    belief: Belief
    health: FilterHealth


STEER_LAG_MIN, SPEED_LAG_MIN = 0.002, 0.02
"""Shortest lags of servo and motor that the filter believes [s].

Without a lag the angle is the order's at once and its covariance is none, which no Cholesky factor
has; a speed that is the order's at once leaves no room for a wheel that slips. Noise is unmodelled
motion over a time, and a lag of zero leaves it none.
"""


def make_state_filter(
    car: Car[float],
    config: FilterConfig | None = None,
    *,
    chassis: Chassis = SINGLE_TRACK,
    reference: bool = False,
) -> StateFilter:
    """A filter for a car; shorter lags than it can believe are taken for the shortest.

    Args:
        car: the car's parameters.
        config: noise and gates.
        chassis: the equations that the parameters belong to.
        reference: compute in Python, number by number: what the library is held against.

    Raises:
        LibraryError: the library was not built.
    """
    config = config or FilterConfig()
    car = car._replace(
        steer_lag=max(car.steer_lag, STEER_LAG_MIN), speed_lag=max(car.speed_lag, SPEED_LAG_MIN)
    )
    sensors = make_sensors(car, config)
    if reference:
        from steerd.estimator.reference import Reference

        return StateFilter(car, config, Reference(car, chassis, config, sensors))
    return StateFilter(car, config, Kernel(car, chassis, config, sensors))


def step(
    flt: StateFilter,
    state: FilterState,
    now_ns: int,
    measurements: Sequence[Measurement] = (),
    commands: Sequence[tuple[int, Command[float] | None]] = (),
) -> FilterState:
    """Take in what arrived until `now_ns`: measurements of any age, commands with their times.

    One call with all that a tick brought costs one pass over the recent past; several calls give
    the same state for more work. Measurements older than the buffer or from the future are not
    fused.

    Raises:
        ValueError: if a command is not finite.
    """
    history = state.history
    shortest_ns, dead_time_ns = flt.dead_times_ns
    redo_ns = now_ns + FUTURE_NS
    for sent_ns, command in commands:
        history = add_command(history, sent_ns, command)
        redo_ns = min(redo_ns, sent_ns + shortest_ns)
    oldest_ns = now_ns - round(flt.config.history_s * NS)
    if flt.car.pose_delay:
        measurements = [_correct_latency(flt.car, m) for m in measurements]
    latest_ns = now_ns + FUTURE_NS
    nodes = state.nodes
    earliest_ns = max(oldest_ns, nodes[0].measurement.t_ns) if nodes else oldest_ns
    timely = sorted([m for m in measurements if earliest_ns <= m.t_ns <= latest_ns])
    if not nodes:
        recent = drop_older(history, oldest_ns - dead_time_ns)
        return _start_filter(flt, FilterState((), recent, state.first_poses), timely)
    nodes = _fuse(flt, history, nodes, timely, redo_ns)
    first, last = 0, len(nodes) - 1
    while first < last and nodes[first + 1].measurement.t_ns <= oldest_ns:
        first += 1
    recent = drop_older(history, nodes[first].measurement.t_ns - dead_time_ns)
    return FilterState(nodes[first:], recent)


def restart_filter(state: FilterState) -> FilterState:
    """Forget where the car is and begin again from the next poses.

    For the caller to allow, with the car at rest: a swapped body looks exactly like a filter that
    went astray, and only one of the two should be followed.
    """
    return FilterState(history=state.history)


def predict_to(flt: StateFilter, state: FilterState, t_ns: int) -> StateEstimate | None:
    """The estimate at `t_ns` from the measurements valid until then; None before the first belief.

    Nothing is kept: a look ahead is not a measurement.
    """
    last = len(state.nodes)
    while last and state.nodes[last - 1].measurement.t_ns > t_ns:
        last -= 1
    if not last:
        return None
    node = state.nodes[last - 1]
    now = flt.kernel.predict(state.history, node.belief, node.measurement.t_ns, t_ns)
    sds = (now.position_sd, now.sd.yaw) if now.sound else (math.nan, math.nan)
    wheel_speed, gyro, pose = node.tally
    health = FilterHealth(now.sound, *sds, wheel_speed, gyro, pose)
    return StateEstimate(t_ns, now.state, now.sd, now.belief, health)


def _correct_latency(car: Car[float], measurement: Measurement) -> Measurement:
    """A pose moved back by the latency that its stamp does not hold."""
    if measurement.kind is not Kind.POSE or not car.pose_delay:
        return measurement
    return measurement._replace(t_ns=measurement.t_ns - round(car.pose_delay * NS))


def _fuse(
    flt: StateFilter,
    history: History,
    nodes: tuple[Node, ...],
    fresh: list[Measurement],
    redo_ns: int,
) -> tuple[Node, ...]:
    """The nodes with fresh measurements in their places, fused again from the first change on.

    That is a fresh measurement, or an order that acts from `redo_ns` on. A measurement that is
    there already is not fused twice.
    """
    keep, first = len(nodes), fresh[0] if fresh else None
    while keep > 1:
        last = nodes[keep - 1].measurement
        if last.t_ns <= redo_ns and (first is None or last < first):
            break
        keep -= 1
    root, later = nodes[keep - 1], sorted([*fresh, *[node.measurement for node in nodes[keep:]]])
    before = [root.measurement, *later]
    chain = [m for m, last in zip(later, before, strict=False) if m != last]
    fused, tally = list(nodes[:keep]), root.tally
    found = flt.kernel.fuse(history, root.belief, root.measurement.t_ns, chain)
    for m, link in zip(chain, found, strict=True):
        tally = count_measurement(tally, m.kind, m.t_ns, link.nis, link.believed)
        fused.append(Node(m, link.belief, link.nis, link.believed, tally))
    return tuple(fused)


def _plausible(measurement: Measurement) -> bool:
    """Finite, and small enough that squares of it stay numbers. Comparisons with NaN are false."""
    for value in measurement.values:  # noqa: SIM110 - thrice as fast as a generator
        if not abs(value) < ABSURD:
            return False
    return True


def _start_filter(flt: StateFilter, state: FilterState, fresh: list[Measurement]) -> FilterState:
    """Gather poses until they give a first belief; what is later than it is fused at once."""
    poses = [m for m in fresh if m.kind is Kind.POSE and _plausible(m)]
    gathered = sorted([*state.first_poses, *poses])
    count = flt.config.initial_poses
    for stop in range(count, len(gathered) + 1):
        some = gathered[stop - count : stop]
        t_ns = some[-1].t_ns
        belief = initial_belief(flt.config, some, _commanded_steer(flt.car, state.history, t_ns))
        if belief is not None:
            tally = (*NO_TALLY[: Kind.POSE], Count(seen=count, believed_ns=t_ns))
            root = Node(some[-1], belief, math.nan, True, tally)
            later = [m for m in fresh if m > some[-1]]
            nodes = _fuse(flt, state.history, (root,), later, t_ns)
            return FilterState(nodes, state.history)
    since = gathered[-1].t_ns - round(LONGEST_S * NS) if gathered else 0
    recent = tuple(m for m in gathered[1 - count :] if m.t_ns >= since)
    return changed(state, first_poses=recent)


def _commanded_steer(car: Car[float], history: History, t_ns: int) -> float | None:
    """Where the steering was last sent [rad]."""
    command = command_at(history, t_ns - dead_times(car)[0])
    return references(FLOAT, car, command).steer if command else None
