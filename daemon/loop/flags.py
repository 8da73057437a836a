"""What the runner sees by itself; travels in `Tick.flags`, so that a replay sees it too.

Plain integers: an IntFlag "or" costs a microsecond, and these are asked thirty times a tick.
"""

from collections.abc import Iterator

from steerd.daemon.loop.findings import Finding, make_finding


class Flag:
    """Bits of `Tick.flags`."""

    LINKED = 1
    SERIAL_FAULT = 2
    GUARDIAN_LOST = 4
    RECORDER_LOST = 8
    GATEWAY_LOST = 16
    EXCEPTION = 32
    SUSPENDED = 64
    REBOOTED = 128
    MOCAP_REFUSED = 256
    QUIT = 512
    ABORT = 1024
    GUARDIAN_TRIPPED = 2048
    UNBOUNDED = 4096


_REPORTS = (
    (Flag.SERIAL_FAULT, "W8", "a write failed"),
    (Flag.GUARDIAN_LOST, "W16", "its heartbeat stopped"),
    (Flag.GUARDIAN_TRIPPED, "W15", "the guardian braked the car: a tick was too late"),
    (Flag.RECORDER_LOST, "W26", "it is gone, full or out of disk"),
    (Flag.GATEWAY_LOST, "W27", "it is gone"),
    (Flag.EXCEPTION, "W29", "in the control core"),
    (Flag.SUSPENDED, "W28", "the machine slept"),
    (Flag.REBOOTED, "W12", "its uptime went back"),
)


def make_reported_findings(flags: int) -> Iterator[Finding]:
    """The watchdogs that the runner watches itself."""
    if flags != Flag.LINKED:
        for flag, name, words in _REPORTS:
            if flags & flag:
                yield make_finding(name, words)
