"""The gateway between a core's pipe and a bus, and the heartbeats that go through both and back."""

import os
import socket
from contextlib import suppress
from dataclasses import replace

import pytest

from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord, pack_record
from steerd.daemon.ipc.requests import REQUEST_MAX, make_badge, unpack_request
from steerd.daemon.process.gateway import Gateway, run_gateway
from steerd.daemon.process.guard import BEAT_NS, RemotePath
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.topics import make_key
from tests.local_bus import LocalBus, LocalHub

POSE_KEY = "lab/pose"
TICK = encode(m.Tick(m.make_header(1, m.BODY), 1, 2, 3, 4, 0))

hub = pytest.fixture(lambda: LocalHub())


@pytest.fixture
def gateway(hub, request):
    """It listens for poses where the test says."""
    return Gateway(LocalBus(hub), "car1", getattr(request, "param", None))


@pytest.fixture
def other(hub):
    """Somebody else on the bus."""
    return LocalBus(hub)


def packets(core):
    """What has arrived at the core."""
    found = []
    with suppress(BlockingIOError):
        while True:
            found.append(unpack_request(core.recv(2 * REQUEST_MAX)))
    return found


@pytest.fixture
def arriving(gateway, ends):
    """Forwards what the bus holds; gives what arrives at the core."""

    def forward():
        gateway.forward_requests(ends[0])
        return packets(ends[1])

    return forward


def requests(arrived):
    return [decode(m.OperatorRequest, data) for _, data in arrived]


@pytest.mark.usefixtures("gateway")
def test_it_is_alive_and_gives_the_schemas(other):
    assert other.alive("**") == {"steerd/car1/alive"}
    (text,) = other.query(make_key("car1", "schema/steerd_msgs/msg/Tick")).values()
    assert b"due_ns" in text


def test_whole_records_are_published_and_the_rest_waits(gateway, hub, pipe):
    heard = LocalBus(hub).subscribe(make_key("car1", topics.TICK), 8)
    record = pack_record(PipeRecord(topics.TICK, 0, 0, 0, TICK))
    read_fd, write_fd = pipe
    reader = PipeReader(read_fd)
    os.write(write_fd, record + record[:-1])
    gateway.publish(reader.take())
    assert [sample.data for sample in heard.poll()] == [TICK]
    os.write(write_fd, record[-1:])
    gateway.publish(reader.take())
    assert [sample.data for sample in heard.poll()] == [TICK]


def test_what_comes_from_the_bus_is_not_sent_back_to_it(gateway, hub):
    heard = LocalBus(hub).subscribe(make_key("car1", topics.OPERATOR), 8)
    gateway.publish([PipeRecord(topics.OPERATOR, 0, 0, 0, ask(ARM))])
    assert heard.poll() == []


def ask(kind, seq=1, lease_id=7, operator="ada"):
    """An operator's request, encoded."""
    header = m.make_header(1, m.BODY)
    return encode(m.OperatorRequest(header, 5, lease_id, seq, int(kind), operator))


ARM, STOP, ESTOP, ALIVE = (m.RequestKind[k] for k in ("ARM", "STOP", "ESTOP", "KEEPALIVE"))


@pytest.mark.parametrize("gateway", [POSE_KEY], indirect=True)
def test_requests_and_poses_go_to_the_core_stops_first(other, arriving):
    drive = encode(m.DriveCommand(m.make_header(1, m.BODY), 5, 0, 1, 2, 100, 0.1, 1.0))
    other.publish(make_key("car1", topics.OPERATOR), ask(ARM, lease_id=0))
    other.publish(make_key("car1", topics.DRIVE), drive)
    other.publish(make_key("car2", topics.DRIVE), drive)
    other.publish(make_key("car1", topics.STOP), ask(ESTOP, lease_id=0))
    other.publish(POSE_KEY, b"pose")
    assert arriving() == [
        (topics.OPERATOR.name, ask(ESTOP, lease_id=0)),
        (topics.OPERATOR.name, ask(ARM, lease_id=0)),
        (topics.DRIVE.name, drive),
        (topics.EXTERNAL_POSE.name, b"pose"),
    ]


@pytest.mark.parametrize("topic", [topics.STOP, topics.OPERATOR])
def test_what_does_not_decode_displaces_no_request(other, arriving, topic):
    other.publish(make_key("car1", topic), ask(STOP))
    for size in (0, 1, 40, 200, REQUEST_MAX + 1) * 200:
        other.publish(make_key("car1", topic), bytes([size % 251]) * size)
    assert [request.kind for request in requests(arriving())] == [STOP]


def test_no_other_request_displaces_a_stop(other, arriving):
    other.publish(make_key("car1", topics.STOP), ask(ESTOP))
    for seq in range(1000):
        other.publish(make_key("car1", topics.OPERATOR), ask(ALIVE, seq))
        other.publish(make_key("car1", topics.STOP), ask(ALIVE, seq))
    assert requests(arriving())[0].kind == ESTOP
    assert arriving() == []


def test_a_lease_is_known_by_a_badge_that_opens_nothing(other, arriving):
    """Whoever sends under the name that the car publishes is another."""
    for lease_id in (7, 7, 8, 0):
        other.publish(make_key("car1", topics.OPERATOR), ask(ALIVE, lease_id=lease_id))
    known = [request.lease_id for request in requests(arriving())]
    assert known[0] == known[1] == make_badge("", 7)
    assert len({*known, 7, 8}) == 5
    assert known[3] == 0, "nobody stays nobody"
    other.publish(make_key("car1", topics.OPERATOR), ask(ALIVE, lease_id=known[0]))
    (request,) = requests(arriving())
    assert request.lease_id not in known


def test_in_a_lab_the_certificate_names_the_operator_and_the_lease(hub, arriving):
    desk, tablet = (LocalBus(hub, who=name) for name in ("desk", "tablet"))
    for bus in (desk, tablet):
        bus.publish(make_key("car1", topics.OPERATOR, bus.who), ask(ALIVE, operator="desk"))
    got = requests(arriving())
    assert [request.operator for request in got] == ["desk", "tablet"]
    assert got[0].lease_id != got[1].lease_id, "one secret, two people"


def test_a_core_that_does_not_read_costs_requests_and_never_blocks(gateway, other, ends):
    ours, core = ends
    ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1)
    sent = 64
    for seq in range(sent):
        request = ask(ALIVE, seq, operator="x" * (REQUEST_MAX - 100))
        other.publish(make_key("car1", topics.OPERATOR), request)
        gateway.forward_requests(ours)
    assert 0 < len(packets(core)) < sent


def test_it_ends_when_the_pipe_closes_after_all_is_published(gateway, hub, ends, pipe):
    heard = LocalBus(hub).subscribe(make_key("car1", topics.TICK), 8)
    read_fd, write_fd = pipe
    os.write(write_fd, pack_record(PipeRecord(topics.TICK, 0, 0, 0, TICK)))
    os.close(write_fd)
    run_gateway(gateway, PipeReader(read_fd), ends[0], PipeReader(None))
    assert len(heard.poll()) == 1


# Heartbeats to the bus and back: who must answer, how soon, and what does not count.
BOOT_ID, HOLDER, MS = 815, 42, 1_000_000
LIMIT_S = 1.0


def make_path(holder: int = 0) -> RemotePath:
    """A path whose first heartbeat has come back from the gateway at time 0."""
    path = RemotePath(BOOT_ID, holder)
    beat = path.make_beat(0, 0)
    path.take(encode(replace(beat, mono_ns=1)), 1)
    return path


def beat_at(path: RemotePath, t_ns: int, lease_id: int = 0):
    return replace(path.make_beat(t_ns, 0), lease_id=lease_id)


def test_heartbeats_leave_twenty_times_a_second():
    path = RemotePath(BOOT_ID)
    sent = [t for t in range(0, 1000 * MS, 10 * MS) if path.make_beat(t, 0) is not None]
    assert sent == list(range(0, 1000 * MS, BEAT_NS))


def test_a_gateway_that_has_answered_and_falls_silent_is_found():
    assert not RemotePath(BOOT_ID).is_silent(False, LIMIT_S, 60_000 * MS), "it is still starting"
    for t_ms, silent in ((1000, False), (1001, True)):
        assert make_path().is_silent(False, LIMIT_S, t_ms * MS + 1) is silent


def test_the_newest_heartbeat_counts_from_when_it_left():
    path = make_path()
    for t_ms in range(50, 2000, 50):
        beat = beat_at(path, t_ms * MS)
        path.take(encode(beat), (t_ms + 30) * MS)
        path.take(encode(replace(beat, mono_ns=5)), (t_ms + 31) * MS)
        assert not path.is_silent(False, LIMIT_S, (t_ms + 40) * MS)
    assert not path.is_silent(False, LIMIT_S, 2950 * MS)
    assert path.is_silent(False, LIMIT_S, 2951 * MS)


def test_whoever_takes_the_lease_over_the_bus_has_to_answer_and_has_time_for_it():
    path = make_path(HOLDER)
    assert not path.is_silent(True, LIMIT_S, 5000 * MS)
    for t_ms in range(5050, 6050, 50):
        path.take(encode(beat_at(path, t_ms * MS)), t_ms * MS)  # the gateway's answers
        assert not path.is_silent(True, LIMIT_S, t_ms * MS)
    assert path.is_silent(True, LIMIT_S, 6001 * MS)
    path.take(encode(beat_at(path, 6050 * MS, HOLDER)), 6080 * MS)
    assert not path.is_silent(True, LIMIT_S, 7050 * MS)
    assert path.is_silent(True, LIMIT_S, 7051 * MS)
    assert not path.is_silent(False, LIMIT_S, 7052 * MS), "a lease that has run out is W25's"


@pytest.mark.parametrize("wrong", [
    {"boot_id": 1}, {"lease_id": 7}, {"mono_ns": 500 * MS + 1}, {"mono_ns": -5},
    b"", b"\0" * 7, b"\xff" * 300,
])  # fmt: skip
def test_garbage_another_runs_heartbeat_or_one_from_the_future_is_none(wrong):
    path = make_path()
    beat = beat_at(path, 500 * MS)
    path.take(wrong if isinstance(wrong, bytes) else encode(replace(beat, **wrong)), 500 * MS)
    assert path.is_silent(False, LIMIT_S, 1002 * MS)
