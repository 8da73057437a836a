"""What the learner's process is sent, and how it knows what it missed."""

from dataclasses import dataclass, field

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.steer_bus import topics

LEARNT_FROM = (topics.MOCAP, topics.ACTUATION, topics.VESC)
"""Topics that a drive is learnt from."""
_WANTED = frozenset(topic.name for topic in (*LEARNT_FROM, topics.DESIGN))


def is_learnt_from(record: PipeRecord) -> bool:
    """Whether the learner wants a record: of the drive, or what became of its proposals."""
    return record.topic.name in _WANTED


@dataclass
class Gaps:
    """Records that were dropped on the way, by their numbers.

    Attributes:
        missed: how many so far.
    """

    missed: int = 0
    _next: dict[str, int] = field(default_factory=dict)

    def take(self, record: PipeRecord) -> None:
        """Count what is missing before a record; the first of a topic misses nothing."""
        due = self._next.get(record.topic.name, record.sequence)
        self.missed += max(record.sequence - due, 0)
        self._next[record.topic.name] = record.sequence + 1
