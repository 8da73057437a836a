"""Proposals of the learner in real time: a few a tick, and a learner that ends is no fault."""

import socket
from types import SimpleNamespace

import pytest

from steerd.daemon.loop.adapting import DESIGN_BYTES
from steerd.daemon.process.runner import CoreLinks, Runner


class Reader:
    """A runner that only reads proposals, and what its core was offered."""

    def __init__(self, end):
        self.offered = []
        core = SimpleNamespace(
            loop=SimpleNamespace(
                plan=SimpleNamespace(period_ns=10_000_000, run=SimpleNamespace(boot_id=1))
            ),
            on_proposal=lambda data, t_ns: self.offered.append((data, t_ns)),
        )
        links = CoreLinks(None, None, (), -1, end)
        self.runner = Runner(core, None, None, None, links, SimpleNamespace())

    def read(self, t_ns):
        self.runner._read_designs(t_ns)


def flood(end, most=100_000):
    """Send until nothing fits any more; how many went out."""
    for sent in range(most):
        try:
            end.send(b"%06d" % sent)
        except BlockingIOError:
            return sent
    raise AssertionError("a socket that takes everything")


def test_the_newest_of_a_few_goes_to_the_core(ends):
    reader = Reader(ends[1])
    reader.read(5)
    assert reader.offered == []
    for data in (b"one", b"two", b"three"):
        ends[0].send(data)
    reader.read(6)
    assert reader.offered == [(b"three", 6)]


def test_a_flood_costs_a_tick_a_few_packets_only(ends):
    reader = Reader(ends[1])
    sent = flood(ends[0])
    assert sent > 50
    for tick in range(10):
        reader.read(tick)
    assert len(reader.offered) == 10
    assert int(reader.offered[-1][0]) < 50, "the rest waits where it is"
    assert flood(ends[0]) < sent, "and the sender finds no room"


def test_a_packet_that_is_too_long_is_cut_and_left_to_the_desk(ends):
    reader = Reader(ends[1])
    ends[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * DESIGN_BYTES)
    ends[0].send(b"x" * (DESIGN_BYTES + 500))
    reader.read(1)
    assert len(reader.offered[0][0]) == DESIGN_BYTES + 1


@pytest.mark.parametrize("unread", [b"", b"last words"])
def test_a_learner_that_ends_is_no_fault(ends, unread):
    reader = Reader(ends[1])
    if unread:
        ends[1].send(b"never read by the learner")
        ends[0].send(unread)
    ends[0].close()
    for tick in range(3):
        reader.read(tick)
    assert reader.runner._designs is None
