"""The core's side of the guardian."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from steerd.daemon.process import heartbeat
from steerd.daemon.process.guard import START_NS, ProcessGuard, make_page_fd
from steerd.daemon.process.heartbeat import HeartbeatPage, Lifeline

BRAKE = b"\x02\x01\x00\x00\x00\x03"


def test_before_a_port_is_open_nothing_may_move_and_nothing_is_missed():
    guard = ProcessGuard(realtime=True)
    now = time.monotonic_ns()
    guard.mark_clean()
    assert not any((guard.may_write(now, now), guard.is_silent(now), guard.has_tripped()))


@pytest.mark.parametrize(("realtime", "simulated", "stale_ms"), [
    (True, False, 30), (False, False, 60), (True, True, 300),
])  # fmt: skip
def test_how_late_a_heartbeat_may_be(realtime, simulated, stale_ms):
    guard = ProcessGuard(realtime, simulated=simulated)
    guard.page = HeartbeatPage(make_page_fd())
    now, stale_ns = time.monotonic_ns(), stale_ms * 1_000_000
    guard.page.write_heartbeat(now, engaged=True)
    assert guard.may_write(now, now + stale_ns - 1)
    assert not guard.may_write(now, now + stale_ns)


def test_a_guardian_shows_itself_brakes_a_silent_core_and_is_missed_when_killed(pipe):
    read, write = pipe
    guard = ProcessGuard(realtime=False, simulated=True)
    start = time.monotonic_ns()
    guard.watch(write, BRAKE, start)
    assert not guard.is_silent(start + START_NS - 1), "it has a second to come up"
    assert guard.is_silent(start + START_NS), "and no longer"
    end = time.monotonic() + 20.0
    while not guard.page.words.guardian_ns and time.monotonic() < end:
        guard.page.write_heartbeat(time.monotonic_ns(), engaged=False)
        select.select([], [], [], 0.005)
    shown = guard.page.words.guardian_ns
    assert shown
    assert not guard.is_silent(shown + 300_000_000)
    assert guard.is_silent(shown + 300_000_001)
    now = time.monotonic_ns()
    guard.page.write_heartbeat(now, engaged=True)
    assert guard.may_write(now, now)
    assert not guard.may_write(now, now + 300_000_000), "a tick of before a stop is not sent after"
    assert select.select([read], [], [], 20.0)[0], "no heartbeat any more: the guardian brakes"
    assert os.read(read, 1000).startswith(BRAKE)
    assert guard.has_tripped()
    assert not guard.may_write(time.monotonic_ns(), time.monotonic_ns())
    guard._process.kill()
    guard._process.wait()
    assert guard.is_silent(time.monotonic_ns())


def test_a_plug_that_flaps_leaves_nothing_behind(pipe):
    read, write = pipe
    guard = ProcessGuard(realtime=False, simulated=True)
    counts = []
    for _ in range(4):
        guard.watch(write, BRAKE, time.monotonic_ns())
        counts.append(len(list(Path("/proc/self/fd").iterdir())))
        guard.mark_clean()
        assert guard._process.wait(20.0) == 0, "let go of, and the car is not armed"
    assert len(set(counts[1:])) == 1
    assert not select.select([read], [], [], 0.0)[0], "nobody braked"


# Who holds the lifeline, and what the other end hears of its death.
HOLDER = """
import sys, select
from steerd.daemon.process.heartbeat import HeartbeatPage, Lifeline
line = Lifeline(int(sys.argv[1]))
line.hold()
memory = bytearray(int(sys.argv[2]))
memory[::4096] = b"x" * len(memory[::4096])
print("held", flush=True)
select.poll().poll(60_000)
"""
ROOT = Path(__file__).parents[4]


@pytest.fixture
def held(request):
    """A process that holds a lifeline, its page, and this end of the line."""
    page_fd = make_page_fd()
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(page_fd), str(getattr(request, "param", 1) << 20)],
        pass_fds=(page_fd,), stdout=subprocess.PIPE, cwd=ROOT,
    )  # fmt: skip
    assert holder.stdout.readline() == b"held\n"
    holder.stdout.close()
    yield holder, page_fd, Lifeline(page_fd, os.pidfd_open(holder.pid))
    holder.kill()
    holder.wait()


def test_a_holder_that_unmapped_its_page_before_it_left_is_heard_of():
    """The kernel cannot hand on a mutex that is not in memory any more: Python's own tidy end."""
    page_fd = make_page_fd()
    code = (
        "import os, sys; from steerd.daemon.process.heartbeat import Lifeline; "
        "line = Lifeline(int(sys.argv[1])); line.hold(); del line; os._exit(0)"
    )
    command = [sys.executable, "-c", code, str(page_fd)]
    holder = subprocess.Popen(command, pass_fds=(page_fd,), cwd=ROOT)
    pidfd = os.pidfd_open(holder.pid)
    assert holder.wait() == 0
    line = Lifeline(page_fd, pidfd)
    assert line.poll(5)
    assert line.poll(5)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGABRT, signal.SIGTERM])
def test_every_kind_of_death_is_heard_of_and_a_stopped_holder_is_not_dead(held, how):
    holder, _, line = held
    holder.send_signal(signal.SIGSTOP)
    assert not line.poll(30)
    holder.send_signal(signal.SIGCONT)
    holder.send_signal(how)
    assert line.poll(5_000)
    assert holder.wait() == -how


@pytest.mark.parametrize("held", [512], indirect=True)
def test_the_lifeline_does_not_wait_for_the_memory_to_be_taken_apart(held):
    holder, _, line = held
    gone = select.poll()
    gone.register(os.pidfd_open(holder.pid), select.POLLIN)
    holder.kill()
    assert line.poll(5_000)
    heard_ns = time.monotonic_ns()
    assert gone.poll(5_000)
    assert time.monotonic_ns() >= heard_ns


@pytest.mark.parametrize("mutex", ["there is none", "nobody holds it"])
def test_without_a_mutex_the_pidfd_has_to_do(held, monkeypatch, mutex):
    holder, page_fd, _ = held
    if mutex == "there is none":
        monkeypatch.setattr(heartbeat, "_library", lambda: None)
        Lifeline(page_fd).hold()
    else:
        page_fd = make_page_fd()
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    assert not line.poll(5)
    holder.kill()
    assert line.poll(5_000)
