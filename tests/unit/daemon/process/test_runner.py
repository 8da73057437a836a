"""The runner: what it watches itself (W8, W16, W26 to W29), deadlines, order of work, proposals."""

import os
import resource
import socket
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.ipc.pipe_records import PipeWriter, make_pipe, read_message
from steerd.daemon.ipc.requests import pack_request
from steerd.daemon.loop.adapting import DESIGN_BYTES
from steerd.daemon.loop.core import make_core
from steerd.daemon.loop.findings import CAUSES, Flag, Severity
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process import guard as guard_module
from steerd.daemon.process.bus_operator import Operator
from steerd.daemon.process.guard import ProcessGuard, make_page_fd
from steerd.daemon.process.heartbeat import HeartbeatPage
from steerd.daemon.process.pacing import MARGIN
from steerd.daemon.process.runner import CoreLinks, Runner
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import topics
from steerd.steer_bus.codec import encode
from steerd.steer_bus.messages import RequestKind, Tick
from steerd.steer_bus.quick_values import changed
from steerd.vesc_link.transport import LinkDown

SECOND, MS = 1_000_000_000, 1_000_000
MOCAP = 4  # a descriptor


@pytest.fixture(scope="module")
def plan():
    options = RunOptions(car_file="", path="line", speed=1.0)
    return make_plan(options, real=RunId(1, 0, leased=True))


def make_runner(plan, sinks=(), requests=(), **record):
    """A runner with an open port, which keeps what is written, and a guardian that is alive.

    A test sets their answers; `notes` keeps what the core posts.
    """
    port = Mock(fd=5, sent=[])
    port.write.side_effect, port.out_queue.return_value = port.sent.append, 0
    guard = Mock(spec=ProcessGuard, page=HeartbeatPage(make_page_fd()))
    guard.is_silent.return_value = guard.has_tripped.return_value = False
    settings, notes = replace(plan.settings, record=replace(plan.settings.record, **record)), []
    core = make_core(
        replace(plan, settings=settings), (lambda records, _t_ns: notes.extend(records), *sinks)
    )
    pipes = PipeWriter(-1), PipeWriter(-1)
    clock = SimpleNamespace(now_ns=lambda: 0, realtime_ns=lambda: 0)
    links = CoreLinks(*pipes, tuple(requests), -1)
    made = Runner(core, clock, lambda: port, World(10 * MS), links, guard)
    made._try_open(0)
    assert core.flags == Flag.LINKED
    return SimpleNamespace(
        it=made, core=core, pipes=pipes, guard=guard, port=port, clock=clock, notes=notes
    )


r = pytest.fixture(lambda plan: make_runner(plan))


def engage(r):
    """The core has just decided a tick of an armed car."""
    r.core.last = Mock(supervisor=Mock(state=SupervisorState.ARMED), order=Mock(command=None))


def test_w8_a_write_that_is_still_on_its_way_is_none(r):
    """The kernel's USB serial driver counts a whole buffer for it; a tick later it has left."""
    engage(r)
    r.port.write.side_effect = lambda _: setattr(r.port.out_queue, "return_value", 1280)
    for _ in range(9):
        r.it._write(b"x", 0)
        r.port.out_queue.return_value = 0
    assert r.core.flags == Flag.LINKED


def test_w8_three_ticks_with_unsent_bytes_are_a_lost_link(r):
    r.port.out_queue.return_value = 257
    for _ in range(9):
        r.it._write(b"x", 0)
    assert r.core.flags == Flag.LINKED, "a disarmed car is not checked"
    engage(r)
    for waiting in (257, 257, 256, 257, 257, 257):
        assert r.core.flags == Flag.LINKED, "a tick that found room: counting begins anew"
        r.port.out_queue.return_value = waiting
        r.it._write(b"x", 0)
    assert r.core.flags == Flag.SERIAL_FAULT
    assert r.port.close.called


def test_w8_a_write_that_fails_is_a_lost_link_at_once(r):
    engage(r)
    r.port.write.side_effect = LinkDown("/dev/x", "short write")
    r.it._write(b"x", 0)
    assert r.core.flags == Flag.SERIAL_FAULT


def test_w16_a_silent_guardian_and_one_that_took_over(r):
    """Disarmed, it may come up late."""
    given = ((False, False, 0), (True, False, Flag.GUARDIAN_LOST), (False, False, 0),
             (False, True, Flag.GUARDIAN_TRIPPED))  # fmt: skip
    for r.guard.is_silent.return_value, r.guard.has_tripped.return_value, flag in given:
        r.it._watch_processes(0)
        assert r.core.flags == Flag.LINKED | flag


@pytest.fixture
def piped(plan):
    """Makes a runner with real pipes to a recorder and a gateway; `read_fds` are their readers'."""
    fds = []

    def make(**given):
        r = make_runner(plan, **given)
        for pipe in r.pipes:
            read_fd, pipe.fd = make_pipe()
            fds.append(read_fd)
        r.read_fds = fds
        return r

    yield make
    for fd in fds:
        os.close(fd)


def write_until_lost(r, which, size, most_s=60):
    """Write a batch every 10 ms: when nothing was taken any more, and when a flag was set [ns]."""
    pipe, full_ns, r.it._is_cut_off = r.pipes[which], None, lambda _t_ns: False
    for t_ns in range(0, most_s * SECOND, 10 * MS):
        if pipe.dropped and full_ns is None:
            full_ns = t_ns - 10 * MS
        r.it._watch_processes(t_ns)
        if r.core.flags != Flag.LINKED:
            return full_ns, t_ns
        pipe.write([bytes(size)], t_ns)
    raise AssertionError("a reader that reads nothing is not missed")


@pytest.mark.parametrize(("which", "flag"), [(0, Flag.RECORDER_LOST), (1, Flag.GATEWAY_LOST)])
@pytest.mark.parametrize("size", [600, 1400, 4000, 4200, 9000])
def test_w26_w27_a_reader_that_takes_nothing_for_a_second(piped, which, flag, size):
    r = piped()
    full_ns, lost_ns = write_until_lost(r, which, size)
    assert r.core.flags == Flag.LINKED | flag
    assert SECOND < lost_ns - full_ns <= SECOND + 20 * MS


@pytest.mark.parametrize(("which", "flag"), [(0, Flag.RECORDER_LOST), (1, Flag.GATEWAY_LOST)])
def test_w26_w27_a_reader_that_is_gone(piped, which, flag):
    r = piped()
    os.close(r.read_fds.pop(which))
    assert write_until_lost(r, which, 600)[1] == 10 * MS
    assert r.core.flags == Flag.LINKED | flag


def test_w26_a_car_file_may_do_without_the_recorder(piped):
    r = piped(required=False)
    os.close(r.read_fds.pop(0))
    with pytest.raises(AssertionError, match="is not missed"):
        write_until_lost(r, 0, 600, most_s=2)


@pytest.mark.parametrize(("slept_ns", "flag"), [(50_000_000, 0), (50_000_001, Flag.SUSPENDED)])
def test_w28_a_machine_that_slept(plan, monkeypatch, slept_ns, flag):
    boot = [0]
    clocks = Mock(clock_gettime_ns=lambda _clock: boot[0], monotonic_ns=lambda: 0)
    monkeypatch.setattr(guard_module, "time", clocks)
    r = make_runner(plan)
    boot[0] = slept_ns
    r.it._set_flags()
    assert r.core.flags == Flag.LINKED | flag
    r.core.flags &= ~Flag.SUSPENDED
    r.it._set_flags()
    assert r.core.flags == Flag.LINKED, "reported once"


def test_w29_the_kernel_gives_no_descriptor_for_a_guardian(r):
    """The limit of open files is lowered from outside before the port is opened anew."""
    r.it._lose_port()
    r.core.flags, r.it._guard = 0, ProcessGuard(realtime=False)
    limits = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, limits[1]))
    try:
        r.it._housekeeping(SECOND)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, limits)
    assert isinstance(r.core.error, OSError)
    assert r.core.flags & Flag.EXCEPTION
    assert not r.core.flags & Flag.LINKED, "a port without a guardian arms no car"


LOCAL, REMOTE = 0, 1  # whose socket: the parent's, the gateway's


@pytest.mark.parametrize(("who", "answers", "found"), [
    (REMOTE, (0, 42), False), (REMOTE, (0,), True), (REMOTE, (0, 7), True),
    (LOCAL, (0,), False), (LOCAL, (), True),
])  # fmt: skip
def test_w27_the_holder_on_the_bus_hears_no_heartbeat(piped, make_ends, who, answers, found):
    """An operator keeps the lease; the gateway (lease 0) and others send heartbeats back."""
    cores, others = zip(make_ends(), make_ends(), strict=True)
    r, operator, now = piped(requests=cores), Operator(1, 42, "test"), [0]
    r.clock.now_ns = r.clock.realtime_ns = lambda: now[0]
    for now[0] in range(0, 3 * SECOND, 50 * MS):
        alive = operator.make_request(RequestKind.KEEPALIVE, 0)
        others[who].send(pack_request(topics.OPERATOR.name, alive))
        beats = [read_message(each) for each in r.notes if each.topic is topics.HEARTBEAT]
        for lease_id in answers if beats else ():
            beat = encode(replace(beats[-1], lease_id=lease_id))
            others[REMOTE].send(pack_request(topics.HEARTBEAT_BACK.name, beat))
        for end in cores:
            r.it._read_requests(end)
        r.it._housekeeping(now[0])
        if r.core.flags & Flag.GATEWAY_LOST:
            break
        r.core.outbox.flush(now[0])
    assert bool(r.core.flags & Flag.GATEWAY_LOST) is found
    assert not found or 1000 < now[0] // MS <= 1150


def test_w29_an_exception_during_a_reply_is_logged_once(r):
    r.core.link.on_bytes = lambda *_: [][1]
    r.core.on_serial(0, b"x")
    assert r.core.flags == Flag.LINKED | Flag.EXCEPTION
    for t_ns in (0, 10_000_000):
        r.core.tick(t_ns, t_ns)
        r.core.post_tick(b"")
    logs = [read_message(record).msg for record in r.notes if record.topic is topics.LOG]
    (said,) = [text for text in logs if "W29" in text]
    assert said.startswith("W29 IndexError at <lambda>:")


def test_w29_what_no_reader_expects_stops_the_car_and_the_core_lives(r):
    r.it._take = lambda fd: [][fd]
    r.it._try(r.it._take, 3)
    assert isinstance(r.core.error, IndexError)
    assert r.core.flags == Flag.LINKED | Flag.EXCEPTION


@pytest.mark.parametrize("lost", [False, True])
@pytest.mark.parametrize("state", ["RUNNING", "ESTOP", "READY", "DISARMED"])
def test_the_guardian_keeps_what_still_moves(r, state, lost):
    """A third signal leaves at once, or a port is lost: the guardian brakes a moving car."""
    clean = state in ("READY", "DISARMED")
    r.core.loop.supervisor = changed(r.core.loop.supervisor, state=SupervisorState[state])
    (r.it._lose_port if lost else r.it._leave)()
    assert r.guard.mark_clean.called is clean
    assert lost or (bool(r.port.sent) is clean and r.port.close.called)


@pytest.mark.parametrize(("state", "opened"), [
    ("ESTOP", True), ("FAULT_STOP", True), ("ARMED", False), ("RUNNING", False),
])  # fmt: skip
def test_a_port_comes_back_while_a_car_is_braked_but_not_while_it_is_driven(r, state, opened):
    r.it._lose_port()
    r.core.loop.supervisor = changed(r.core.loop.supervisor, state=SupervisorState[state])
    r.it._try_open(0)
    assert bool(r.core.flags & Flag.LINKED) is opened


def test_the_end_of_the_gateway_is_no_second_signal(r, ends):
    r.it._parent = ends[0]
    for end in ends:  # the parent's, and the gateway's
        r.it._close_requests(end)
    assert r.it.signals == 1
    assert r.core.flags & Flag.GATEWAY_LOST


def test_what_the_guardian_forbade_is_not_reported_as_written(r):
    r.core.tick(0, 0)
    engage(r)
    r.core.last.order.command = object()
    for r.guard.may_write.return_value, written in ((False, b""), (True, b"go")):
        assert r.it._write(b"go", 0) == written
        assert b"".join(r.port.sent) == written
    r.guard.page.trip(1, b"no")
    assert r.port.sent == [b"no"], "motion leaves from where the guardian can change it"
    r.core.last.order.command = None
    r.it._write(b"brake", 0)
    assert r.port.sent[1:] == [b"brake"]


def test_w29_a_message_that_cannot_be_posted_stops_the_car_and_the_core_lives(plan):
    def refuse(_records, _t_ns):
        raise LookupError("no such sink")

    r = make_runner(plan, (refuse,))
    r.core.tick(0, 0)
    r.core.post_tick(b"")
    assert isinstance(r.core.error, LookupError)
    assert r.core.flags & Flag.EXCEPTION


class World:
    """Time passes only in `select`; a frame comes every `every_ns`, each tick takes 0.4 ms.

    After 300 frames some are lost, and stamps may be wrong from then on.
    """

    def __init__(self, every_ns: int, lost: int = 0, ahead_ns: int = 0) -> None:
        self.t_ns, self.every_ns, self.next_ns = 0, every_ns, 3 * MS
        self.lost, self.sent, self.ahead_ns = lost, 0, ahead_ns
        self.ingest = SimpleNamespace(wheel_speed=None, stationary=False)
        self.on_timer = self.close = lambda *_: None

    def now_ns(self):
        return self.t_ns

    realtime_ns = now_ns

    def select(self, fds, _w, _x, timeout):
        end = self.t_ns + round(timeout * 1e9)
        if self.next_ns <= end:
            self.t_ns = max(self.t_ns, self.next_ns)
            return [MOCAP], [], []
        self.t_ns = end
        return [], [], []

    def fds(self):
        return [MOCAP]

    def read_ready(self, _fd):
        arrival = self.next_ns
        self.sent += 1
        missing = self.lost if self.sent == 300 else 0
        self.next_ns += self.every_ns * (1 + missing)
        wrong = self.ahead_ns if self.sent > 300 else 0
        return [SimpleNamespace(t_arrival_ns=arrival + wrong)]

    def status(self):
        return SimpleNamespace(refused=False, state="", detail="", rate_hz=0.0)


@pytest.fixture
def ticks_of(monkeypatch, plan):
    """Gives the ticks of a run, the frames' arrivals, and the period."""

    def drive(every_ns: int, count: int = 400, **wrong: int):
        ticks: list[Tick] = []
        arrivals: list[int] = []

        def sink(records, _t_ns):
            ticks.extend(r.message for r in records if r.topic is topics.TICK)
            world.t_ns += 4 * MS // 10

        world, r = World(every_ns, **wrong), make_runner(plan, (sink,))
        r.it._clock = r.it._mocap = world
        r.core.on_poses = lambda samples: arrivals.extend(s.t_arrival_ns for s in samples)
        monkeypatch.setattr("select.select", world.select)
        r.it._is_done = lambda: len(ticks) >= count
        r.it.run()
        return ticks, np.array(arrivals), plan.period_ns

    return drive


def woke(ticks: list[Tick]) -> np.ndarray:
    return np.array([tick.woke_ns for tick in ticks])


def test_a_pose_is_acted_on_as_it_comes(ticks_of):
    ticks, arrivals, period = ticks_of(10 * MS)
    assert set(woke(ticks[250:])) <= set(arrivals)
    assert np.diff(woke(ticks)).mean() == pytest.approx(period, rel=2e-3)
    assert all(0 < t.due_ns - t.woke_ns < MARGIN * period + MS // 5 for t in ticks[250:])


def test_a_pose_that_does_not_come_is_not_waited_for(ticks_of):
    ticks, arrivals, _ = ticks_of(10 * MS, lost=10)
    gap = int(np.argmax(np.diff(arrivals)))
    blind = [t for t in ticks if arrivals[gap] < t.woke_ns < arrivals[gap + 1]]
    assert len(blind) == 10
    assert all(t.woke_ns == t.due_ns for t in blind)
    assert set(woke(ticks[-50:])) <= set(arrivals)


@pytest.mark.parametrize("ahead_ns", [3 * MS, 1_000 * MS, -3 * MS, -1_000 * MS])
def test_stamps_that_are_wrong_bring_no_tick_without_waiting(ticks_of, ahead_ns):
    ticks, _, period = ticks_of(10 * MS, ahead_ns=ahead_ns)
    assert np.diff(woke(ticks)).min() >= period // 2
    assert all(abs(t.due_ns - t.woke_ns) <= period // 2 for t in ticks)


@pytest.mark.parametrize("hz", [50, 95, 102, 120, 200, 250, 333.3, 400, 500, 600, 960, 1000])
def test_no_rate_of_mocap_makes_ticks_uneven(ticks_of, hz):
    ticks, _, period = ticks_of(round(1e9 / hz), count=900)
    spans = np.diff(woke(ticks[400:])) / period
    assert 0.8 < spans.min() <= spans.max() < 1.2


@pytest.fixture
def it(monkeypatch, r):
    """A runner whose core only notes its calls, and who keeps its `notes`."""
    it, core, world, notes = r.it, r.core, World(10 * MS), []
    it._clock, it._mocap, it.notes = world, world, notes
    core.tick = lambda *_: notes.append("decided") or b"order"
    core.post_tick = lambda written: notes.append(f"posted {written.decode()}")
    core.on_poses = lambda _samples: None
    monkeypatch.setattr("select.select", world.select)
    it._write = lambda wire, _t_ns: notes.append(wire.decode()) or wire
    it._set_flags, it._leave = lambda late_ns: None, lambda: None
    it._housekeeping = lambda _t_ns: notes.append("tidied")
    return it


def test_the_bytes_leave_before_messages_are_posted(it):
    it._is_done = lambda: len(it.notes) >= 8
    it.run()
    assert it.notes == ["decided", "order", "posted order", "tidied"] * 2


def test_a_pose_makes_one_tick_only(it):
    """A tick so late that it has seen the pose of the next one, again and again."""
    early = []

    def wait_too_long(due_ns: int, early_ns: int) -> None:
        early.append(early_ns > it._pose_ns)
        it._clock.t_ns = due_ns + 8 * MS
        it._on_poses([SimpleNamespace(t_arrival_ns=due_ns + 7 * MS)])

    it._wait = wait_too_long
    it._is_done = lambda: len(early) >= 400
    it.run()
    assert all(early)


@pytest.mark.parametrize(("work_ms", "late"), [(9, False), (12, True), (28, True), (59, True)])
def test_w15_a_tick_that_takes_too_long_makes_the_next_one_late(it, work_ms, late):
    """A loop that cannot keep its rate is no loop that skips what it missed and is in time."""
    world, seen = it._clock, []
    it._write = lambda wire, _t_ns: setattr(world, "t_ns", world.t_ns + work_ms * MS) or wire
    it._set_flags, it._is_done = seen.append, lambda: len(seen) >= 60
    it.run()
    assert all(late_ns > 10 * MS for late_ns in seen[-30:]) is late


@pytest.mark.parametrize("flag", [Flag.RECORDER_LOST, Flag.GATEWAY_LOST])
def test_a_drive_by_itself_does_not_wait_for_a_process_that_is_gone(plan, flag):
    alone = make_runner(replace(plan, options=replace(plan.options, auto_arm=True)))
    watched = make_runner(plan)
    assert not alone.it._is_done()
    for r in (alone, watched):
        r.core.flags |= flag
    assert alone.it._is_done(), "nobody is there to start it anew"
    assert not watched.it._is_done(), "an operator reads what is wrong"
    alone.core.loop.supervisor = changed(alone.core.loop.supervisor, state=SupervisorState.STOPPING)
    assert not alone.it._is_done(), "first the car comes to rest"


@pytest.mark.parametrize(("stood", "stolen_ms", "flag", "said"), [
    ((-5, 45), 0, Flag.ALL_LATE, "all processes stood still at once: this machine stalled"),
    ((0, 0), 0, Flag.ALONE_LATE, "this program alone was late; run steerd rtcheck"),
    (None, 0, 0, "late; run steerd rtcheck"),
    (None, 40, Flag.STALLED, "the host of this virtual machine"),
    (None, 10, 0, "late; run steerd rtcheck"),
])  # fmt: skip
def test_a_late_tick_says_whether_host_or_guardian_stood_still_too(
    plan, monkeypatch, stood, stolen_ms, flag, said
):
    monkeypatch.setattr(guard_module, "read_steal_ns", lambda: 5 * SECOND)
    r = make_runner(plan)
    monkeypatch.setattr(guard_module, "read_steal_ns", lambda: 5 * SECOND + stolen_ms * MS)
    start = r.it._clock.now_ns() - 41 * MS
    pause = stood and (start + stood[0] * MS, start + stood[1] * MS)
    monkeypatch.setattr(guard_module, "find_pause", lambda *_: pause)
    r.it._set_flags(9 * MS)
    assert not r.core.flags & CAUSES, "a tick in time blames nobody"
    r.it._set_flags(41 * MS)
    assert r.core.flags & CAUSES == flag
    r.core.tick(0, 41 * MS)
    assert not r.core.flags & CAUSES, "it is one tick's"
    late = [finding for finding in r.core.last.findings if finding.id == "W15"]
    assert {finding.severity for finding in late} == {Severity.HARD}
    texts = [finding.text for finding in late]
    assert any(said in text for text in texts)
    assert sum("stood still" in text or "alone" in text for text in texts) == (stood is not None)


@pytest.fixture
def reader(r, ends):
    """A runner that reads proposals, and what its core was offered."""
    r.it._designs, r.read, r.offered = ends[1], r.it._read_designs, []
    r.core.on_proposal = lambda *given: r.offered.append(given)
    return r


def flood(end, most=100_000):
    """Send until nothing fits any more; how many went out."""
    for sent in range(most):
        try:
            end.send(b"%06d" % sent)
        except BlockingIOError:
            return sent
    raise AssertionError("a socket that takes everything")


def test_the_newest_of_a_few_goes_to_the_core(ends, reader):
    reader.read(5)
    assert reader.offered == []
    for data in (b"one", b"two", b"three"):
        ends[0].send(data)
    reader.read(6)
    assert reader.offered == [(b"three", 6)]


def test_a_flood_costs_a_tick_a_few_packets_only(ends, reader):
    sent = flood(ends[0])
    assert sent > 50
    for tick in range(10):
        reader.read(tick)
    assert len(reader.offered) == 10
    assert int(reader.offered[-1][0]) < 50, "the rest waits where it is"
    assert flood(ends[0]) < sent, "and the sender finds no room"


def test_a_packet_that_is_too_long_is_cut_and_left_to_the_desk(ends, reader):
    ends[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * DESIGN_BYTES)
    ends[0].send(b"x" * (DESIGN_BYTES + 500))
    reader.read(1)
    assert len(reader.offered[0][0]) == DESIGN_BYTES + 1


@pytest.mark.parametrize("unread", [b"", b"last words"])
def test_a_learner_that_ends_is_no_fault(ends, reader, unread):
    if unread:
        ends[1].send(b"never read by the learner")
        ends[0].send(unread)
    ends[0].close()
    for tick in range(3):
        reader.read(tick)
    assert reader.it._designs is None
