"""The learner fed by the messages of a drive, as recorder and session hold them; its reports."""

import json
from dataclasses import dataclass, fields
from math import nan
from typing import TYPE_CHECKING, Any

from steerd.car_model.car_file import CarFile
from steerd.daemon.ipc.pipe_records import LEARNT_FROM, PipeRecord
from steerd.daemon.learning.reported import NS, ReportedChange, ReportedValue, pack
from steerd.sim_gap.online.learner import Change, Learner, State, fold, make_learner
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled, Sample
from steerd.sim_gap.online.tracking import Memory, Remembered
from steerd.sim_gap.online.values import Value, amounts_of, unit_of, values_of
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import Topic
from steerd.sysid.data.dataset import RAMP_ERPM
from steerd.vesc_link.scaling import F1TENTH, Scaling, erpm_to_speed

if TYPE_CHECKING:
    from steerd.daemon.learning.proposing import Proposals

NEEDED = (*LEARNT_FROM, topics.WHEEL)
"""Topics that the learner is fed by."""


@dataclass(frozen=True)
class Wiring:
    """How a session's numbers are to be read."""

    epoch_ns: int  # UNIX time minus monotonic time [ns]
    scaling: Scaling = F1TENTH  # of speed and ERPM


def make_sample(wiring: Wiring, topic: Topic, message: Any) -> Sample | None:
    """A message of `NEEDED` as a sample, with monotonic time [s]; None where it says nothing."""
    if topic is topics.MOCAP:
        if message.reject:
            return None
        return PoseSeen(message.t_valid_ns * 1e-9, message.x, message.y, message.yaw)
    if topic is topics.ACTUATION:
        t = (m.stamp_ns(message.header) - wiring.epoch_ns) * 1e-9
        if message.mode != m.ActuationMode.SPEED:
            return Paused(t)
        return Ordered(t, message.steer, message.speed)
    if topic is topics.VESC:
        middle = (message.t_sent_ns + message.t_received_ns) // 2
        return Rolled(middle * 1e-9, erpm_to_speed(wiring.scaling, message.erpm))
    if topic is topics.WHEEL:
        return Rolled(message.t_ns * 1e-9, message.speed)
    return None


@dataclass
class Feed:
    """A learner and where it stands."""

    learner: Learner  # the car
    wiring: Wiring  # how the session's numbers are read
    state: State  # what is known so far
    dropped: int = 0  # records that were lost on the way here
    # Of designs for what is learnt, each after its report; None without `--adapt`
    proposals: "Proposals | None" = None

    def take(self, topic: Topic, message: Any) -> m.Model | None:
        """Take in one message; the report, if one is due."""
        if topic is topics.DESIGN and self.proposals is not None:
            self.proposals.hear(message)
        if topic not in NEEDED:
            return None
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
_LEARNT = tuple(
    field.name.removesuffix(_SD) for field in fields(m.Model) if field.name.endswith(_SD)
)
"""The car's numbers that the message has fields for."""


def make_model(
    state: State, mono_ns: int, epoch_ns: int, dropped: int, remembered: Remembered
) -> m.Model:
    """The report of a state.

    Args:
        state: of the learner.
        mono_ns: of the newest pose [ns, monotonic].
        epoch_ns: UNIX time minus monotonic time [ns].
        dropped: records that were lost so far.
        remembered: what was learnt on an earlier drive: reported until this one knows the car.
    """
    early = (Value(name, *each, unit_of(name), True) for name, each in remembered.items())
    values = values_of(state.known) if state.known else tuple(early)
    by_name = {value.name: value for value in values}
    current = () if state.change is None else (state.change,)
    changes = [_reported_change(change) for change in (*state.past, *current)]
    newest = changes[-1] if changes else None
    verdict = newest.verdict if newest else "none"
    numbers: dict[str, float] = {}
    for name in _LEARNT:
        value = by_name.get(name)
        numbers |= {name: value.value if value else nan, name + _SD: value.sd if value else nan}
    return m.Model(
        header=m.make_header(mono_ns + epoch_ns, m.BODY),
        mono_ns=mono_ns,
        since_ns=newest.since_ns if newest else -1,
        noticed_ns=newest.noticed_ns if newest else -1,
        windows=state.seen,
        dropped=dropped,
        confidence=newest.confidence if newest else nan,
        **numbers,
        verdict="learning" if state.known is None else verdict,
        effect=newest.effect if newest else "",
        alternatives=",".join(newest.alternatives) if newest else "",
        identifiable=",".join(value.name for value in values if value.identifiable),
        details=pack(values, changes),
    )


def _reported_change(change: Change) -> ReportedChange:
    verdict, cause = change.finding.verdict, change.finding.cause
    since, noticed = round(change.since * NS), round(change.noticed * NS)
    if cause is None:
        return ReportedChange(since, noticed, verdict, "", nan, (), ())
    moved = tuple(ReportedValue(name, *amount) for name, amount in amounts_of(change).items())
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
    ramp = RAMP_ERPM / abs(wiring.scaling.erpm_gain)
    return Feed(make_learner(car, ramp, memory), wiring, State())
