"""What the learner's process is sent."""

from steerd.daemon.ipc.pipe_records import PipeRecord
from steerd.steer_bus import topics

LEARNT_FROM = (topics.MOCAP, topics.ACTUATION, topics.VESC)
"""Topics that a drive is learnt from."""
_WANTED = frozenset(topic.name for topic in (*LEARNT_FROM, topics.DESIGN))


def is_learnt_from(record: PipeRecord) -> bool:
    """Whether the learner wants a record: of the drive, or what became of its proposals."""
    return record.topic.name in _WANTED
