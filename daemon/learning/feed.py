"""The learner fed by encoded records, as recorder and session hold them."""

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from steerd.car_model.car_file import CarFile
from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.daemon.learning.report import make_model
from steerd.daemon.learning.reported import NS
from steerd.daemon.learning.samples import NEEDED, Wiring, make_sample
from steerd.sim_gap.online.learner import Learner, State, fold, make_learner
from steerd.sim_gap.online.tracking import Memory
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import Topic
from steerd.sysid.data.dataset import RAMP_ERPM


@dataclass
class Feed:
    """A learner and where it stands.

    Attributes:
        learner: the car.
        wiring: how the session's numbers are read.
        state: what is known so far.
        dropped: records that were lost on the way here.
    """

    learner: Learner
    wiring: Wiring
    state: State
    dropped: int = 0

    def take(self, topic: Topic, message: Any) -> m.Model | None:
        """Take in one message; the report, if one is due."""
        if topic not in NEEDED:
            return None
        sample = make_sample(self.wiring, topic, message)
        if sample is None:
            return None
        self.state, due = fold(self.learner, self.state, sample)
        if not due:
            return None
        newest = round(self.state.recent.newest * NS)
        remembered = self.learner.remembered
        return make_model(self.state, newest, self.wiring.epoch_ns, self.dropped, remembered)


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


def learn_all(feed: Feed, messages: Iterable[tuple[Topic, Any]]) -> Iterator[m.Model]:
    """The reports of a whole drive."""
    for topic, message in messages:
        report = feed.take(topic, message)
        if report is not None:
            yield report
