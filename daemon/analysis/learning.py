"""`steerd learn`: what the learner would have said of a recorded drive, and whether it did."""

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from steerd.daemon.analysis.diagnosis import find_base
from steerd.daemon.common.errors import SteerdError, reading
from steerd.daemon.common.screen import watched
from steerd.daemon.learning.feed import NEEDED, Wiring, make_feed, read_memory
from steerd.daemon.learning.kept import METADATA
from steerd.daemon.sessions.info import load_session
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.session_read import Record, Session
from steerd.steer_bus.topics import Topic, find_topic
from steerd.sysid.data.dataset import read_erpm
from steerd.vesc_link.scaling import Scaling


@dataclass(frozen=True)
class Learnt:
    """What the learner makes of a recorded drive."""

    base: str  # where the car came from, as text
    remark: str  # why what identify knew of the car is not used; empty where it is
    reports: Sequence[m.Model]  # one or more
    digest: str  # SHA-256 of their bytes
    recorded: int  # how many the session itself holds
    same: int  # how many of those are equal to the byte


def learn_session(
    path: Path, car: Path | None = None, share: Callable[[float], None] = lambda done: None
) -> Learnt:
    """Feed a recorded drive to the learner, about a car file or that inside the session.

    `share` hears the share of the session that was read. A SteerdError where session or car file
    cannot be used, or too little was driven for a report.
    """
    session = load_session(path)
    base, source, _ = find_base(car, (session,))
    with reading(path, "steerd identify writes it anew"):
        # What was learnt in an earlier drive is of the session's own car.
        memory = session.info().metadata.get(METADATA, {}).get("memory", "") if car is None else ""
        feed = make_feed(base, wiring_of_session(session), read_memory(memory))
    recorded: list[bytes] = []
    reports: list[m.Model] = []
    count = max(session.info().count, 1)
    records = watched(session.messages(), lambda done: share(done / count))
    for topic, message in _messages(records, recorded, path):
        if (report := feed.take(topic, message)) is not None:
            reports.append(report)
    if not reports:
        what = f"{path.name}: no second of driving with poses and commands"
        raise SteerdError(what, "record mocap and actuation of a drive")
    made = [encode(report) for report in reports]
    digest = hashlib.sha256(b"".join(made)).hexdigest()
    same = sum(one == other for one, other in zip(made, recorded, strict=False))
    return Learnt(source, base.remark, reports, digest, len(recorded), same)


def wiring_of_session(session: Session) -> Wiring:
    """How a session's numbers are read: its own scaling, and its clocks."""
    scaling = Scaling(*read_erpm(session))
    epoch = session.info().metadata.get("steerd.session", {}).get("epoch_ns")
    if epoch is not None:
        return Wiring(int(epoch), scaling)
    for record in session.messages():
        if find_topic(record.topic) is topics.MOCAP:
            pose = record.decode()
            return Wiring(m.stamp_ns(pose.header) - pose.t_valid_ns, scaling)
    return Wiring(0, scaling)


def _messages(
    records: Iterable[Record], recorded: list[bytes], path: Path
) -> Iterator[tuple[Topic, Any]]:
    """What the learner needs, in recorded order; reports of the drive itself go aside."""
    with reading(path.name):
        for record in records:
            topic = find_topic(record.topic)
            if topic is topics.MODEL:
                recorded.append(record.data)
            elif topic in NEEDED:
                yield topic, record.decode()
