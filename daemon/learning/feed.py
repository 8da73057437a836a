"""The learner fed by the messages of a drive, as recorder and session hold them; its reports.

With `--adapt` it proposes each second a design one step closer to the learnt car, or none. It hears
from the core what was taken, and steps on from there.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, fields
from math import nan
from typing import Any

from steerd.car_model.car_file import CarFile
from steerd.controller.acceptance import Acceptance
from steerd.controller.design import DesignRefused
from steerd.controller.gains import design_table
from steerd.controller.learnt import (
    Design,
    Learnt,
    approach_learnt,
    learnt_car,
    learnt_of,
    learnt_timing,
)
from steerd.daemon.ipc.pipe_records import LEARNT_FROM, PipeRecord
from steerd.daemon.learning.reported import NS, ReportedChange, ReportedValue, pack
from steerd.daemon.loop.adapting import REFUSED, make_design, make_no_design, read_design
from steerd.sim_gap.online.learner import Change, Learner, State, fold, make_learner
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled, Sample
from steerd.sim_gap.online.tracking import Memory, Remembered
from steerd.sim_gap.online.values import UNITS, Value, amounts_of, find_aim, values_of
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import Topic
from steerd.vesc_link.scaling import Scaling, erpm_to_speed

NEEDED = (*LEARNT_FROM, topics.WHEEL)  # topics that the learner is fed by
STILL = 0.1  # a step smaller than this share of the largest is none: the design stays
PAUSE_NS = 15_000_000_000  # after a refusal nothing is proposed for so long


@dataclass(frozen=True)
class Wiring:
    """How a session's numbers are to be read."""

    epoch_ns: int  # UNIX time minus monotonic time [ns]
    scaling: Scaling  # of speed and ERPM


def make_sample(wiring: Wiring, topic: Topic, message: Any) -> Sample | None:
    """A message as a sample, with monotonic time [s]; None where it says nothing of the car."""
    if topic is topics.MOCAP:
        seen = PoseSeen(message.t_valid_ns * 1e-9, message.x, message.y, message.yaw)
        return None if message.reject else seen
    if topic is topics.ACTUATION:
        t = (m.stamp_ns(message.header) - wiring.epoch_ns) * 1e-9
        driven = message.mode == m.ActuationMode.SPEED
        return Ordered(t, message.steer, message.speed) if driven else Paused(t)
    if topic is topics.VESC:
        middle = (message.t_sent_ns + message.t_received_ns) // 2
        return Rolled(middle * 1e-9, erpm_to_speed(wiring.scaling, message.erpm))
    if topic is topics.WHEEL:
        return Rolled(message.t_ns * 1e-9, message.speed)
    return None


class Proposals:
    """Proposes from the file's design on, by what the core holds designs against.

    `send` takes each proposal as bytes, and when it was made [ns].
    """

    def __init__(self, held: Acceptance, send: Callable[[bytes, int], object]) -> None:
        self._held, self._send = held, send
        self._file = learnt_of(held.file.car)
        self._at = self._file  # the numbers in force, as the core said
        self._design: Design | None = None  # the last proposal
        self._refused_ns = -PAUSE_NS  # when the core refused one last

    def hear(self, taken: m.Design) -> None:
        """The core took a design, or the file's."""
        design = read_design(taken)
        if design is not None:
            self._at = design.car
            return
        self._at, self._design = self._file, None
        if taken.text.startswith(REFUSED):
            self._refused_ns = taken.mono_ns

    def propose(self, learner: Learner, state: State, mono_ns: int, epoch_ns: int) -> None:
        """Propose at a report of a state; times of the newest pose, UNIX minus monotonic [ns]."""
        design = self._next_design(find_aim(learner, state), mono_ns)
        self._design = None if isinstance(design, str) else design
        if not isinstance(design, str) and design.car == self._file:
            design = "the car is as in the car file"
        if isinstance(design, str):
            proposal = make_no_design(mono_ns, epoch_ns, design)
        else:
            proposal = make_design(mono_ns, epoch_ns, 1, design)
        self._send(encode(proposal), mono_ns)

    def _next_design(self, aim: Learnt | str, mono_ns: int) -> Design | str:
        """One step towards an aim; why there is none."""
        if isinstance(aim, str):
            return aim
        if mono_ns - self._refused_ns < PAUSE_NS:
            return "a design was refused"
        file, steps = self._held.file, self._held.steps
        car = approach_learnt(self._at, aim, self._held.bounds, steps)
        if self._design is not None and all(
            abs(a - b) <= STILL * most
            for a, b, most in zip(car, self._design.car, steps, strict=True)
        ):
            return self._design
        own, timing = learnt_car(file, car), learnt_timing(file, car)
        try:
            return Design(car, design_table(own, file.config, timing, file.profile.fastest))
        except DesignRefused as error:
            return str(error)


@dataclass
class Feed:
    """A learner and where it stands."""

    learner: Learner  # the car
    wiring: Wiring  # how the session's numbers are read
    state: State  # what is known so far
    dropped: int = 0  # records that were lost on the way here
    # Of designs for what is learnt, each after its report; None without `--adapt`
    proposals: Proposals | None = None

    def take(self, topic: Topic, message: Any) -> m.Model | None:
        """Take in one message; the report, if one is due."""
        if topic is topics.DESIGN and self.proposals is not None:
            self.proposals.hear(message)
        sample = make_sample(self.wiring, topic, message)
        if sample is None:
            return None
        self.state, due = fold(self.learner, self.state, sample)
        if not due:
            return None
        newest, epoch_ns = round(self.state.recent.newest * NS), self.wiring.epoch_ns
        if self.proposals is not None:
            self.proposals.propose(self.learner, self.state, newest, epoch_ns)
        return make_model(self.state, newest, epoch_ns, self.dropped, self.learner.remembered)


_SD = "_sd"
_LEARNT = tuple(f.name.removesuffix(_SD) for f in fields(m.Model) if f.name.endswith(_SD))
"""The car's numbers that the message has fields for."""
_NO_CHANGE = ReportedChange(-1, -1, "none")


def make_model(
    state: State, mono_ns: int, epoch_ns: int, dropped: int, remembered: Remembered
) -> m.Model:
    """The report of a state, at the newest pose [ns, monotonic]; `dropped` records were lost.

    What was learnt on an earlier drive is reported until this one knows the car.
    """
    early = (Value(name, *each, UNITS[name], True) for name, each in remembered.items())
    values = values_of(state.known) if state.known else tuple(early)
    known = {value.name: (value.value, value.sd) for value in values}
    current = () if state.change is None else (state.change,)
    changes = [_reported_change(change) for change in (*state.past, *current)]
    newest = changes[-1] if changes else _NO_CHANGE
    numbers: dict[str, float] = {}
    for name in _LEARNT:
        numbers[name], numbers[name + _SD] = known.get(name, (nan, nan))
    return m.Model(
        header=m.make_header(mono_ns + epoch_ns, m.BODY),
        mono_ns=mono_ns,
        since_ns=newest.since_ns,
        noticed_ns=newest.noticed_ns,
        windows=state.seen,
        dropped=dropped,
        confidence=newest.confidence,
        **numbers,
        verdict="learning" if state.known is None else newest.verdict,
        effect=newest.effect,
        alternatives=",".join(newest.alternatives),
        identifiable=",".join(value.name for value in values if value.identifiable),
        details=pack(values, changes),
    )


def _reported_change(change: Change) -> ReportedChange:
    verdict, cause = change.finding.verdict, change.finding.cause
    since, noticed = round(change.since * NS), round(change.noticed * NS)
    if cause is None:
        return ReportedChange(since, noticed, verdict)
    moved = [ReportedValue(name, *amount) for name, amount in amounts_of(change).items()]
    named = cause.effect, cause.confidence, cause.ambiguous_with
    return ReportedChange(since, noticed, verdict, *named, moved)


def make_record(report: m.Model, number: int, log_time_ns: int) -> PipeRecord:
    """A report as recorder and gateway take it; `number` counts from 0."""
    published, data = m.stamp_ns(report.header), encode(report)
    return PipeRecord(topics.MODEL, number, log_time_ns, published, data, report)


def read_memory(text: str) -> Memory | None:
    """What was learnt in an earlier drive, as `kept.recall` writes it; None for an empty text.

    Raises:
        ValueError: it is something else.
    """
    if not text:
        return None
    try:
        data = json.loads(text)
        values = {name: (float(value), float(sd)) for name, (value, sd) in data["values"].items()}
        return Memory(values, float(data["days"]))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"what was learnt in an earlier drive is unreadable: {error}") from error


def make_feed(car: CarFile, wiring: Wiring, memory: Memory | None = None) -> Feed:
    """A feed at its start; `memory` is of an earlier drive of this car.

    Raises:
        ValueError: what identify wrote into the car file is not what it writes.
    """
    return Feed(make_learner(car, memory), wiring, State())
