"""Leases: one operator and one external controller at a time, only while alive. Pure."""

# Why: docs/decisions/safety.md#d14

from dataclasses import dataclass
from math import inf

from steerd.daemon.loop.transitions import Fact
from steerd.steer_bus.messages import DriveCommand, OperatorRequest, ParameterRequest, RequestKind

VALID_MS, VALID_MAX_MS = 100, 300
"""How long an external command may be applied, and the longest that is accepted [ms]."""
HANDOVER_S = 1.0  # silence after which another controller may take over [s]; the car has stopped
FORMER_MAX = 256  # number of former holders whose last numbers are remembered
Numbers = tuple[tuple[int, int], ...]
"""Pairs of lease id and last accepted sequence number, the latest holder last."""

_ASKS = {
    RequestKind.ARM: Fact.ARM,
    RequestKind.START: Fact.START,
    RequestKind.STOP: Fact.STOP,
    RequestKind.DISARM: Fact.DISARM,
    RequestKind.CLEAR: Fact.CLEAR | Fact.RESET,
    RequestKind.ESTOP: Fact.CALL_ESTOP,
    RequestKind.KEEPALIVE: 0,  # renews the lease (W25), changes no state
}
_FROM_ANYBODY = (RequestKind.STOP, RequestKind.ESTOP)


@dataclass(frozen=True)
class Lease:
    """Who may command: the operator who arms and starts, or the external controller."""

    boot_id: int  # of this run; requests with another are old or meant for another run
    holder: int = 0  # lease id of the operator, 0 for nobody
    seq: int = -1  # of the last accepted request
    renewed_ns: int = 0  # time of the holder's last request
    former: Numbers = ()  # last sequence numbers of former holders: no request is accepted twice


def _remember(former: Numbers, who: int, seq: int) -> Numbers:
    """Add the holder who loses the lease; 0 stands for nobody."""
    rest = tuple(pair for pair in former if pair[0] != who)
    return (*rest, (who, seq))[-FORMER_MAX:] if who else former


def accept_request(
    lease: Lease, request: OperatorRequest, t_ns: int, idle: bool
) -> tuple[Lease, int]:
    """Accept a request or refuse it; the facts that it asks for.

    A stop is accepted from anybody. All else needs this run's boot id, the lease (free for others
    while it is `idle`: its holder is silent) and a rising sequence number, also from a former
    holder.
    """
    try:
        kind = RequestKind(request.kind)
    except ValueError:
        return lease, Fact.UNKNOWN
    lease, admitted = admit(lease, request, t_ns, idle)
    return lease, _ASKS[kind] if admitted or kind in _FROM_ANYBODY else 0


def admit(
    lease: Lease, request: OperatorRequest | ParameterRequest | DriveCommand, t_ns: int, idle: bool
) -> tuple[Lease, bool]:
    """Whether the sender of a request holds the lease, or takes one that is free now."""
    who, seq = request.lease_id, request.seq
    own = who == lease.holder != 0 and seq > lease.seq
    # A former holder's number must be later than all that it has sent.
    takes = idle and who not in (0, lease.holder) and seq > dict(lease.former).get(who, seq - 1)
    if request.boot_id != lease.boot_id or not (own or takes):
        return lease, False
    former = _remember(lease.former, lease.holder, lease.seq) if takes else lease.former
    return Lease(lease.boot_id, who, seq, t_ns, former), True


def lease_age(lease: Lease, t_ns: int) -> float:
    """Seconds since the holder's last request; infinite without a holder."""
    return (t_ns - lease.renewed_ns) * 1e-9 if lease.holder else inf


@dataclass(frozen=True)
class Remote:
    """The external controller, who holds a lease of its own by its commands."""

    lease: Lease
    command: DriveCommand | None = None  # the newest, or None


def take_command(remote: Remote, command: DriveCommand, t_ns: int) -> Remote:
    """Accept a command of this run's controller if it is newer than its last one."""
    if not 0 < command.valid_ms <= VALID_MAX_MS:
        return remote
    idle = lease_age(remote.lease, t_ns) > HANDOVER_S
    lease, admitted = admit(remote.lease, command, t_ns, idle)
    return Remote(lease, command if admitted else remote.command)


def valid_command(remote: Remote, t_ns: int) -> DriveCommand | None:
    """The newest command while it is valid."""
    command = remote.command
    if command is None or t_ns - remote.lease.renewed_ns > command.valid_ms * 1_000_000:
        return None
    return command
