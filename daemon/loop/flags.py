"""What the runner observes; recorded in `Tick.flags`, so that a replay has it too.

Plain integers: an IntFlag "or" takes a microsecond, and these are tested thirty times a tick.
"""

from collections.abc import Iterator

from steerd.daemon.loop.findings import ALL_LATE, ALONE, STALLED, Finding, blame, make_finding
from steerd.daemon.loop.transitions import Request, SupervisorState


class Flag:
    """Bits of `Tick.flags`."""

    LINKED = 1  # serial port open
    SERIAL_FAULT = 2  # W8
    GUARDIAN_LOST = 4  # W16
    RECORDER_LOST = 8  # W26
    GATEWAY_LOST = 16  # W27
    EXCEPTION = 32  # W29
    SUSPENDED = 64  # W28; for one tick
    REBOOTED = 128  # W12; for one tick
    MOCAP_REFUSED = 256  # the mocap source is not the configured one
    QUIT = 512  # a first stop signal
    ABORT = 1024  # a second stop signal
    GUARDIAN_TRIPPED = 2048  # W15
    UNBOUNDED = 4096  # the VESC did not take the session's limits
    STALLED = 8192  # the host took the processor away; for one tick
    ALL_LATE = 16384  # every process stood still at once; for one tick
    ALONE_LATE = 32768  # the tick was late, the other processes were not; for one tick


def merge_requests(pending: int, flags: int, state: SupervisorState, *, starts: bool) -> int:
    """Requests of this tick: the operators', of stop signals, and of a run that starts by itself.

    Args:
        pending: bits of `Request` that have arrived.
        flags: of the runner.
        state: the supervisor's.
        starts: the run arms and starts once without an operator, and has not yet.
    """
    requests = pending
    if flags & Flag.QUIT:
        requests |= int(Request.DISARM)
    if flags & Flag.ABORT:
        requests |= int(Request.ABORT)
    if starts and not flags & (Flag.QUIT | Flag.ABORT):
        if state is SupervisorState.READY:
            requests |= int(Request.ARM)
        elif state is SupervisorState.ARMED:
            requests |= int(Request.START)
    return requests


CAUSES = Flag.STALLED | Flag.ALL_LATE | Flag.ALONE_LATE
"""Who made this one tick late."""


_REPORTS = (
    (Flag.SERIAL_FAULT, "W8", "a write failed"),
    (Flag.GUARDIAN_LOST, "W16", "its heartbeat stopped"),
    (Flag.GUARDIAN_TRIPPED, "W15", "the guardian braked the car: a tick was too late"),
    (Flag.RECORDER_LOST, "W26", "it is gone, hangs or is out of disk"),
    (Flag.GATEWAY_LOST, "W27", "it is gone or hangs, or no heartbeat comes back from the bus"),
    (Flag.EXCEPTION, "W29", "in the control core"),
    (Flag.SUSPENDED, "W28", "the machine slept"),
    (Flag.REBOOTED, "W12", "its uptime went back"),
)


def make_reported_findings(flags: int) -> Iterator[Finding]:
    """Findings of the watchdogs that the runner implements."""
    if flags != Flag.LINKED:
        for flag, name, text in _REPORTS:
            if flags & flag:
                yield make_finding(name, text)


def blame_late(late: Finding, flags: int) -> Finding:
    """The finding of a late tick with who made it late, as far as the runner knows."""
    why = next((why for flag, why in _BLAMES if flags & flag), None)
    return late if why is None else blame(late, why)


_BLAMES = ((Flag.STALLED, STALLED), (Flag.ALL_LATE, ALL_LATE), (Flag.ALONE_LATE, ALONE))
