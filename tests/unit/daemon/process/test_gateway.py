"""The gateway between a core's pipe and a bus inside the process."""

import os
import socket

import pytest

from steerd.daemon.ipc.gateway_wire import REQUEST_MAX, unpack_request
from steerd.daemon.ipc.pipe_records import PipeRecord, pack_record
from steerd.daemon.process.gateway import Gateway, run_gateway
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.topics import alive_key, make_key
from tests.local_bus import LocalBus, LocalHub

POSE_KEY = "lab/pose"
TICK = encode(m.Tick(m.make_header(1, m.BODY), 1, 2, 3, 4, 0))


@pytest.fixture
def hub():
    return LocalHub()


@pytest.fixture
def ends():
    """The gateway's and the core's end of the socket for requests."""
    pair = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in pair:
        end.setblocking(False)
    yield pair
    for end in pair:
        end.close()


def packets(core):
    """What has arrived at the core."""
    found = []
    while True:
        try:
            found.append(unpack_request(core.recv(2 * REQUEST_MAX)))
        except BlockingIOError:
            return found


def test_it_is_alive_and_gives_the_schemas(hub):
    gateway = Gateway(LocalBus(hub), "car1", None)
    other = LocalBus(hub)
    assert other.alive("**") == {alive_key("car1")}
    (text,) = other.query(make_key("car1", "schema/steerd_msgs/msg/Tick")).values()
    assert b"due_ns" in text
    assert gateway is not None


def test_whole_records_are_published_and_the_rest_waits(hub):
    gateway = Gateway(LocalBus(hub), "car1", None)
    heard = LocalBus(hub).subscribe(make_key("car1", topics.TICK), 8)
    record = pack_record(PipeRecord(topics.TICK, 0, 0, 0, TICK))
    buffer = bytearray(record + record[:-1])
    gateway.publish(buffer)
    assert [sample.data for sample in heard.poll()] == [TICK]
    assert buffer == record[:-1]


def test_what_comes_from_the_bus_is_not_sent_back_to_it(hub):
    gateway = Gateway(LocalBus(hub), "car1", None)
    heard = LocalBus(hub).subscribe(make_key("car1", topics.OPERATOR), 8)
    request = m.OperatorRequest(m.make_header(1, m.BODY), 1, 2, 3, int(m.RequestKind.ARM), "me")
    gateway.publish(bytearray(pack_record(PipeRecord(topics.OPERATOR, 0, 0, 0, encode(request)))))
    assert heard.poll() == []


def test_requests_and_poses_go_to_the_core_and_oversized_ones_do_not(hub, ends):
    ours, core = ends
    gateway = Gateway(LocalBus(hub), "car1", POSE_KEY)
    other = LocalBus(hub)
    other.publish(make_key("car1", topics.OPERATOR), b"arm")
    other.publish(make_key("car1", topics.DRIVE), bytes(REQUEST_MAX + 1))
    other.publish(make_key("car1", topics.DRIVE), bytes(REQUEST_MAX))
    other.publish(make_key("car2", topics.DRIVE), b"another car's")
    other.publish(POSE_KEY, b"pose")
    gateway.forward_requests(ours)
    assert packets(core) == [
        (topics.OPERATOR.name, b"arm"),
        (topics.DRIVE.name, bytes(REQUEST_MAX)),
        (topics.EXTERNAL_POSE.name, b"pose"),
    ]


def test_a_core_that_does_not_read_costs_requests_and_never_blocks(hub, ends):
    ours, core = ends
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    gateway, other = Gateway(LocalBus(hub), "car1", None), LocalBus(hub)
    sent = 64
    for _ in range(sent):
        other.publish(make_key("car1", topics.OPERATOR), bytes(REQUEST_MAX))
        gateway.forward_requests(ours)
    assert 0 < len(packets(core)) < sent


def test_it_ends_when_the_pipe_closes_after_all_is_published(hub, ends):
    heard = LocalBus(hub).subscribe(make_key("car1", topics.TICK), 8)
    read_fd, write_fd = os.pipe()
    os.write(write_fd, pack_record(PipeRecord(topics.TICK, 0, 0, 0, TICK)))
    os.close(write_fd)
    run_gateway(Gateway(LocalBus(hub), "car1", None), read_fd, ends[0])
    os.close(read_fd)
    assert len(heard.poll()) == 1
