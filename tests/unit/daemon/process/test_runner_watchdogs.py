"""What the runner watches by itself: W8, W16, W26, W27, W28, W29, each under its threshold."""

import gc
import sys
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest

from steerd.daemon.assembly.build import make_core, make_plan
from steerd.daemon.common.errors import SteerdError
from steerd.daemon.ipc.pipe_records import PipeWriter, read_message
from steerd.daemon.loop.flags import Flag
from steerd.daemon.loop.supervisor import NEVER
from steerd.daemon.loop.transitions import SupervisorState
from steerd.daemon.process import runner as runner_module
from steerd.daemon.process.core_process import latch_stray_exceptions
from steerd.daemon.process.runner import CoreLinks, Runner
from steerd.daemon.settings.config import make_settings
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import topics
from steerd.vesc_link.transport import LinkDown

SECOND = 1_000_000_000


class FakePort:
    """A serial port that notes what it is given."""

    fd = 5

    def __init__(self):
        self.queue, self.sent, self.gone = 0, [], False

    def write(self, data):
        if self.gone:
            raise LinkDown("/dev/x", "short write", "look at the cable")
        self.sent.append(data)

    def out_queue(self):
        return self.queue

    def close(self):
        self.gone = True


class FakeGuard:
    """A guardian that says what it is told to say."""

    def __init__(self):
        self.quiet = self.took_over = self.clean = False

    def watch(self, *_):
        self.clean = False

    def write_heartbeat(self, *_):
        pass

    def may_write(self, *_):
        return not self.took_over

    def is_silent(self, _):
        return self.quiet

    def has_tripped(self):
        return self.took_over

    def mark_clean(self):
        self.clean = True


@pytest.fixture(scope="module")
def plan():
    return make_plan(RunOptions(car_file="", path="line", speed=1.0))


def make_runner(plan, sinks=(), **record):
    settings = replace(plan.settings, record=replace(plan.settings.record, **record))
    core = make_core(replace(plan, settings=settings), 1, 0, sinks, leased=True)
    pipes = [PipeWriter(-1), PipeWriter(-1)]
    clock = SimpleNamespace(now_ns=lambda: 0, realtime_ns=lambda: 0)
    guard, port = FakeGuard(), FakePort()
    made = Runner(core, clock, lambda: port, None, CoreLinks(*pipes, (), -1), guard)
    made._try_open(0)
    assert core.flags == Flag.LINKED
    return SimpleNamespace(it=made, core=core, pipes=pipes, guard=guard, port=port)


def engage(r):
    """The core has just decided a tick of an armed car."""
    supervisor = SimpleNamespace(state=SupervisorState.ARMED)
    r.core.last = SimpleNamespace(supervisor=supervisor, order=SimpleNamespace(command=None))


def test_w8_three_ticks_with_unsent_bytes_are_a_lost_link(plan):
    r = make_runner(plan)
    engage(r)
    r.port.queue = 257
    for _ in range(2):
        r.it._write(b"x", 0)
    r.port.queue = 256
    r.it._write(b"x", 0)
    assert r.core.flags == Flag.LINKED, "the third tick found room: counting begins anew"
    r.port.queue = 257
    for k in range(3):
        assert r.core.flags == Flag.LINKED, k
        r.it._write(b"x", 0)
    assert r.core.flags == Flag.SERIAL_FAULT
    assert r.port.gone


def test_w8_a_disarmed_car_may_take_its_time(plan):
    r = make_runner(plan)
    r.port.queue = 520
    for _ in range(9):
        r.it._write(b"x", 0)
    assert r.core.flags == Flag.LINKED


def test_w8_a_write_that_fails_is_a_lost_link_at_once(plan):
    r = make_runner(plan)
    engage(r)
    r.port.gone = True
    r.it._write(b"x", 0)
    assert r.core.flags == Flag.SERIAL_FAULT


def test_w16_a_silent_guardian(plan):
    r = make_runner(plan)
    r.it._watch_processes(0)
    assert r.core.flags == Flag.LINKED
    r.guard.quiet = True
    r.it._watch_processes(0)
    assert r.core.flags == Flag.LINKED | Flag.GUARDIAN_LOST
    r.guard.quiet = False
    r.it._watch_processes(0)
    assert r.core.flags == Flag.LINKED, "disarmed, it may come up late"
    r.guard.took_over = True
    r.it._watch_processes(0)
    assert r.core.flags == Flag.LINKED | Flag.GUARDIAN_TRIPPED


@pytest.mark.parametrize(("which", "flag"), [(0, Flag.RECORDER_LOST), (1, Flag.GATEWAY_LOST)])
def test_w26_w27_a_reader_that_is_dead_or_takes_nothing_for_a_second(plan, which, flag):
    r = make_runner(plan)
    r.pipes[which].full_since_ns = 0
    r.it._watch_processes(SECOND)
    assert r.core.flags == Flag.LINKED
    r.it._watch_processes(SECOND + 1)
    assert r.core.flags == Flag.LINKED | flag
    r = make_runner(plan)
    r.pipes[which].dead = True
    r.it._watch_processes(0)
    assert r.core.flags == Flag.LINKED | flag


def test_w26_a_car_file_may_do_without_the_recorder(plan):
    r = make_runner(plan, required=False)
    r.pipes[0].dead = True
    r.it._watch_processes(0)
    assert r.core.flags == Flag.LINKED


@pytest.mark.parametrize(("slept_ns", "flag"), [(50_000_000, 0), (50_000_001, Flag.SUSPENDED)])
def test_w28_a_machine_that_slept(plan, monkeypatch, slept_ns, flag):
    monkeypatch.setattr(runner_module, "sleep_lag_ns", lambda: 0)
    r = make_runner(plan)
    monkeypatch.setattr(runner_module, "sleep_lag_ns", lambda: slept_ns)
    r.it._raise_flags()
    assert r.core.flags == Flag.LINKED | flag
    r.core.flags &= ~Flag.SUSPENDED
    r.it._raise_flags()
    assert r.core.flags == Flag.LINKED, "told once"


class Broken:
    """Raises when it is thrown away."""

    def __del__(self):
        raise LookupError("nobody catches this")


@pytest.mark.parametrize("where", ["thread", "destructor"])
def test_w29_an_exception_without_a_caller_stops_the_car_for_good(plan, monkeypatch, where):
    core = make_runner(plan).core
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(threading, "excepthook", threading.excepthook)
    latch_stray_exceptions(core)
    if where == "thread":
        thread = threading.Thread(target=lambda: [][1])
        thread.start()
        thread.join()
    else:
        Broken()
        gc.collect()
    assert isinstance(core.error, LookupError)
    assert core.flags == Flag.LINKED | Flag.EXCEPTION


def test_w29_what_was_raised_while_a_reply_came_in_is_told_once(plan):
    told = []
    r = make_runner(plan, (lambda records, _: told.extend(records),))
    r.core.link.on_bytes = lambda *_: [][1]
    r.core.on_serial(0, b"x")
    assert r.core.flags == Flag.LINKED | Flag.EXCEPTION
    for t_ns in (0, 10_000_000):
        r.core.tick(t_ns, t_ns)
        r.core.post_tick(b"")
    logs = [read_message(record).msg for record in told if record.topic is topics.LOG]
    (said,) = [text for text in logs if "W29" in text]
    assert said.startswith("W29 IndexError at <lambda>:")


def test_w29_what_no_reader_expects_stops_the_car_and_the_core_lives(plan):
    r = make_runner(plan)
    r.it._take = lambda fd: [][fd]
    r.it._try(r.it._take, 3)
    assert isinstance(r.core.error, IndexError)
    assert r.core.flags == Flag.LINKED | Flag.EXCEPTION


@pytest.mark.parametrize(
    ("state", "clean"), [(SupervisorState.RUNNING, False), (SupervisorState.DISARMED, True)]
)
def test_only_a_car_at_rest_is_left_in_good_order(plan, state, clean):
    """A third signal leaves at once: what still moves is the guardian's to brake."""
    r = make_runner(plan)
    r.core.loop.supervisor = r.core.loop.supervisor._replace(state=state)
    r.it._mocap = SimpleNamespace(close=lambda: None)
    r.it._leave()
    assert r.guard.clean is clean
    assert bool(r.port.sent) is clean
    assert r.port.gone


@pytest.mark.parametrize(
    ("state", "freed"), [(SupervisorState.RUNNING, False), (SupervisorState.READY, True)]
)
def test_the_guardian_frees_a_lost_port_unless_the_car_is_armed(plan, state, freed):
    r = make_runner(plan)
    r.core.loop.supervisor = r.core.loop.supervisor._replace(state=state)
    r.it._lose_port()
    assert r.guard.clean is freed


@pytest.mark.parametrize(
    ("state", "still_ns", "opened"),
    [
        (SupervisorState.ESTOP, 5, True),
        (SupervisorState.ESTOP, NEVER, False),
        (SupervisorState.RUNNING, 5, False),
    ],
)
def test_a_port_comes_back_after_an_emergency_stop_at_rest(plan, state, still_ns, opened):
    r = make_runner(plan)
    r.it._lose_port()
    supervisor = r.core.loop.supervisor._replace(state=state, still_ns=still_ns)
    r.core.loop.supervisor = supervisor
    r.it._try_open(0)
    assert bool(r.core.flags & Flag.LINKED) is opened


def test_the_end_of_the_gateway_is_no_second_signal(plan):
    r = make_runner(plan)
    parent, gateway = SimpleNamespace(close=lambda: None), SimpleNamespace(close=lambda: None)
    r.it._ends, r.it._parent = replace(r.it._ends, requests=(parent, gateway)), parent
    r.it._hang_up(parent)
    r.it._hang_up(gateway)
    assert r.it.signals == 1
    assert r.core.flags & Flag.GATEWAY_LOST


def test_what_the_guardian_forbade_is_not_told_as_written(plan):
    told = []
    r = make_runner(plan, (lambda records, _: told.extend(records),))
    r.core.tick(0, 0)
    engage(r)
    r.core.last.order.command = object()
    r.guard.took_over = True
    assert r.it._write(b"go", 0) == b""
    assert r.port.sent == []
    r.guard.took_over = False
    assert r.it._write(b"go", 0) == b"go"


def test_w29_what_cannot_be_told_stops_the_car_and_the_core_lives(plan):
    def refuse(_records, _t_ns):
        raise LookupError("no such sink")

    r = make_runner(plan, (refuse,))
    r.core.tick(0, 0)
    r.core.post_tick(b"")
    assert isinstance(r.core.error, LookupError)
    assert r.core.flags & Flag.EXCEPTION


@pytest.mark.parametrize(
    "table", [{"flush_ms": 251}, {"flush_ms": 9}, {"disk_free_min_mb": 99}, {"requires": True}]
)
def test_the_record_section_has_ceilings_too(plan, table):
    sections = {**plan.settings.file.sections, "record": table}
    with pytest.raises(SteerdError, match=r"\[record\]"):
        make_settings(replace(plan.settings.file, sections=sections))
