"""Who may command: tables of requests, and every boundary of time and number."""

from math import inf

import pytest

from steerd.daemon.loop import lease as leases
from steerd.daemon.loop.lease import FORMER_MAX, Lease, Remote, accept_request, take_command
from steerd.daemon.loop.transitions import Fact
from steerd.steer_bus.messages import BODY, DriveCommand, OperatorRequest, RequestKind, make_header

BOOT, ANN, BOB = 77, 5, 9
T0 = 1_000_000_000
HELD = Lease(BOOT, ANN, 10, T0)


def ask(kind=RequestKind.ARM, boot=BOOT, who=ANN, seq=11):
    return OperatorRequest(make_header(0, BODY), boot, who, seq, int(kind), "somebody")


def command(seq=1, boot=BOOT, who=ANN, valid_ms=100, steer=0.1):
    return DriveCommand(make_header(0, BODY), boot, who, 0, seq, valid_ms, steer, 1.0)


@pytest.mark.parametrize(("kind", "request_"), [
    (RequestKind.ARM, Fact.ARM), (RequestKind.START, Fact.START),
    (RequestKind.STOP, Fact.STOP), (RequestKind.DISARM, Fact.DISARM),
    (RequestKind.CLEAR, Fact.CLEAR | Fact.RESET), (RequestKind.ESTOP, Fact.CALL_ESTOP),
    (RequestKind.KEEPALIVE, 0),
])  # fmt: skip
def test_the_holder_s_requests_pass_and_renew(kind, request_):
    lease, got = accept_request(HELD, ask(kind), T0 + 5, idle=False)
    assert got == request_
    assert lease == Lease(BOOT, ANN, 11, T0 + 5)


@pytest.mark.parametrize(("lease", "request_", "got"), [
    *((HELD, other, 0) for other in (
        ask(seq=10), ask(seq=9), ask(boot=BOOT + 1), ask(who=BOB), ask(who=0),
        ask(who=BOB, boot=BOOT + 1))),
    *((Lease(BOOT), ask(kind, who=0), 0) for kind in (
        RequestKind.ARM, RequestKind.CLEAR, RequestKind.KEEPALIVE)),
    *((HELD, ask(kind, **other), asked) for kind, asked in (
        (RequestKind.STOP, Fact.STOP), (RequestKind.ESTOP, Fact.CALL_ESTOP))
      for other in ({"who": BOB}, {"seq": 1}, {"boot": 0}, {"who": 0})),
    *((HELD, ask(kind), Fact.UNKNOWN) for kind in (99, 255, -1)),
])  # fmt: skip
def test_whoever_does_not_hold_the_car_changes_nothing_but_may_stop_it(lease, request_, got):
    assert accept_request(lease, request_, T0 + 5, idle=False) == (lease, got)


def test_an_idle_lease_is_free_for_another_and_not_for_nobody():
    lease, got = accept_request(HELD, ask(who=BOB, seq=0), T0 + 5, idle=True)
    assert got == Fact.ARM
    assert lease == Lease(BOOT, BOB, 0, T0 + 5, former=((ANN, 10),))
    assert accept_request(HELD, ask(who=0), T0, idle=True)[1] == 0
    assert accept_request(HELD, ask(who=BOB, boot=1), T0, idle=True)[1] == 0
    assert accept_request(HELD, ask(seq=10), T0, idle=True)[1] == 0, "its own old number"


def take(lease, *changes):
    """Requests while the holder is silent; what came of the last."""
    for who, seq in changes:
        lease, got = accept_request(lease, ask(who=who, seq=seq), T0, idle=True)
    return lease, got


def test_no_request_of_a_former_holder_is_taken_twice():
    lease, _ = take(HELD, (BOB, 3))
    for seq in (10, 9):
        assert take(lease, (ANN, seq)) == (lease, 0)
    lease, got = take(lease, (ANN, 11))
    assert (got, lease.holder, lease.former) == (Fact.ARM, ANN, ((ANN, 10), (BOB, 3)))
    assert take(lease, (BOB, 3))[1] == 0
    lease, _ = take(lease, (BOB, 4))
    assert lease.former == ((BOB, 3), (ANN, 11)), "one number for each"
    assert take(lease, (ANN, 11))[1] == 0


def test_so_many_former_holders_are_remembered():
    lease, _ = take(Lease(BOOT), *((who, 1) for who in range(1, FORMER_MAX + 2)))
    assert [who for who, _ in lease.former] == [*range(1, FORMER_MAX + 1)], "nobody is none"
    assert take(lease, (1, 1))[1] == 0
    lease, _ = take(lease, (FORMER_MAX + 2, 1))
    assert len(lease.former) == FORMER_MAX
    assert take(lease, (2, 1))[1] == 0


def test_its_age_is_seconds_since_the_holder_was_heard():
    assert leases.lease_age(HELD, T0 + 250_000_000) == pytest.approx(0.25)
    assert leases.lease_age(HELD, T0) == 0.0
    assert leases.lease_age(Lease(BOOT), T0) == inf, "nobody has been"


def driven(who=0, seq=-1, t_ns=0, former=(), last=None):
    """An external controller."""
    return Remote(Lease(BOOT, who, seq, t_ns, former), last)


TAKEN = driven(ANN, 7, T0, last=command(7))


def test_the_first_command_brings_its_holder_who_is_somebody():
    assert take_command(driven(), command(1, who=0), T0) == driven()
    assert take_command(driven(), command(7), T0) == TAKEN


@pytest.mark.parametrize("bad", [
    command(7), command(6), command(8, boot=1), command(8, who=BOB), command(8, who=0),
    command(8, valid_ms=0), command(8, valid_ms=301),
], ids=["again", "older", "another run", "another", "nobody", "no time", "too long"])  # fmt: skip
def test_commands_that_are_refused_leave_the_last(bad):
    assert take_command(TAKEN, bad, T0 + 1) == TAKEN


@pytest.mark.parametrize("valid_ms", [1, 300])
def test_the_longest_and_shortest_validity(valid_ms):
    new = command(8, valid_ms=valid_ms)
    assert take_command(TAKEN, new, T0 + 1) == driven(ANN, 8, T0 + 1, last=new)


def test_another_controller_may_take_over_only_after_a_second_of_silence():
    other, late_ns = command(1, who=BOB), T0 + 1_000_000_001
    assert take_command(TAKEN, other, late_ns - 1).lease.holder == ANN
    assert take_command(TAKEN, other, late_ns) == driven(BOB, 1, late_ns, ((ANN, 7),), other)


def test_no_command_of_a_former_controller_is_taken_twice():
    late = 2_000_000_000
    bob = take_command(TAKEN, command(1, who=BOB), T0 + late)
    for seq in (7, 6):
        assert take_command(bob, command(seq), T0 + 2 * late) == bob
    back = take_command(bob, command(8), T0 + 2 * late).lease
    assert (back.holder, back.former) == (ANN, ((ANN, 7), (BOB, 1)))


def test_a_command_is_valid_to_the_last_nanosecond_and_no_longer():
    assert leases.valid_command(TAKEN, T0 + 100_000_000) == command(7)
    assert leases.valid_command(TAKEN, T0 + 100_000_001) is None
    assert leases.valid_command(driven(), T0) is None
