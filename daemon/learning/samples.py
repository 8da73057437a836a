"""Messages of a drive as what the learner takes."""

from dataclasses import dataclass
from typing import Any

from steerd.daemon.ipc.pipe_records import LEARNT_FROM
from steerd.sim_gap.online.samples import Ordered, Paused, PoseSeen, Rolled, Sample
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.topics import Topic
from steerd.vesc_link.scaling import F1TENTH, Scaling

NEEDED = (*LEARNT_FROM, topics.WHEEL)
"""Topics that the learner is fed by."""


@dataclass(frozen=True)
class Wiring:
    """How a session's numbers are to be read.

    Attributes:
        epoch_ns: UNIX time minus monotonic time [ns].
        erpm_gain: of the session's scaling; `erpm_offset` too.
    """

    epoch_ns: int
    erpm_gain: float = F1TENTH.erpm_gain
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
