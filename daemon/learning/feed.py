"""The learner fed by the messages of a drive, as recorder and session hold them."""

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from steerd.car_model.car_file import CarFile
from steerd.daemon.ipc.pipe_records import LEARNT_FROM, PipeRecord
from steerd.daemon.learning.report import make_model
from steerd.daemon.learning.reported import NS
from steerd.sim_gap.online.learner import Learner, State, fold, make_learner
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled, Sample
from steerd.sim_gap.online.tracking import Memory
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import Topic
from steerd.sysid.data.dataset import RAMP_ERPM
from steerd.vesc_link.scaling import F1TENTH, Scaling

if TYPE_CHECKING:
    from steerd.daemon.learning.proposing import Proposals

NEEDED = (*LEARNT_FROM, topics.WHEEL)
"""Topics that the learner is fed by."""


@dataclass(frozen=True)
class Wiring:
    """How a session's numbers are to be read."""

    epoch_ns: int  # UNIX time minus monotonic time [ns]
    erpm_gain: float = F1TENTH.erpm_gain  # of the session's scaling; `erpm_offset` too
    erpm_offset: float = F1TENTH.erpm_offset


def wiring_of(epoch_ns: int, scaling: Scaling) -> Wiring:
    """The wiring of a run that is being driven."""
    return Wiring(epoch_ns, scaling.erpm_gain, scaling.erpm_offset)


def make_sample(wiring: Wiring, topic: Topic, message: Any) -> Sample | None:
    """A message as a sample, with monotonic time [s]; None where it says nothing.

    Args:
        wiring: of the session.
        topic: one of `NEEDED`.
        message: of that topic.
    """
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
        return Rolled(middle * 1e-9, (message.erpm - wiring.erpm_offset) / wiring.erpm_gain)
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
    """A feed at its start.

    Args:
        car: the car file.
        wiring: how the session's numbers are read.
        memory: of an earlier drive of this car.

    Raises:
        ValueError: what identify wrote into the car file is not what it writes.
    """
    ramp = RAMP_ERPM / abs(wiring.erpm_gain)
    return Feed(make_learner(car, ramp, memory), wiring, State())
