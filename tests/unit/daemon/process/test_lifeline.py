"""Who holds the lifeline, and what the other end hears of its death."""

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from steerd.daemon.process import lifeline
from steerd.daemon.process.guard import make_page_fd
from steerd.daemon.process.lifeline import Lifeline

HOLDER = """
import sys, select
from steerd.daemon.process.lifeline import Lifeline
line = Lifeline(int(sys.argv[1]))
line.hold()
memory = bytearray(int(sys.argv[2]))
memory[::4096] = b"x" * len(memory[::4096])
print("held", flush=True)
select.poll().poll(60_000)
"""
ROOT = Path(__file__).parents[4]


def start_holder(page_fd, megabytes=1):
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(page_fd), str(megabytes << 20)],
        pass_fds=(page_fd,),
        stdout=subprocess.PIPE,
        cwd=ROOT,
    )
    assert holder.stdout.readline() == b"held\n"
    holder.stdout.close()
    return holder


def test_a_living_holder_is_waited_for_and_a_killed_one_heard_of():
    page_fd = make_page_fd()
    holder = start_holder(page_fd)
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    assert not line.poll(5)
    holder.kill()
    assert line.poll(5_000)
    holder.wait()


def test_a_holder_that_unmapped_its_page_before_it_left_is_heard_of():
    """The kernel cannot hand on a mutex that is not in memory any more: Python's own tidy end."""
    page_fd = make_page_fd()
    leaver = (
        "import os, sys; from steerd.daemon.process.lifeline import Lifeline; "
        "line = Lifeline(int(sys.argv[1]))"
    )
    code = f"{leaver}; line.hold(); del line; os._exit(0)"
    holder = subprocess.Popen(
        [sys.executable, "-c", code, str(page_fd)], pass_fds=(page_fd,), cwd=ROOT
    )
    pidfd = os.pidfd_open(holder.pid)
    assert holder.wait() == 0
    line = Lifeline(page_fd, pidfd)
    assert line.poll(5)
    assert line.poll(5)


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGABRT, signal.SIGTERM])
def test_every_kind_of_death_is_heard_of(how):
    page_fd = make_page_fd()
    holder = start_holder(page_fd)
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    holder.send_signal(how)
    assert line.poll(5_000)
    assert holder.wait() == -how


def test_a_stopped_holder_is_not_dead():
    page_fd = make_page_fd()
    holder = start_holder(page_fd)
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    holder.send_signal(signal.SIGSTOP)
    assert not line.poll(30)
    holder.kill()
    assert line.poll(5_000)
    holder.wait()


def test_the_lifeline_does_not_wait_for_the_memory_to_be_taken_apart():
    page_fd = make_page_fd()
    holder = start_holder(page_fd, megabytes=512)
    pidfd = os.pidfd_open(holder.pid)
    line = Lifeline(page_fd, pidfd)
    gone = select.poll()
    gone.register(pidfd, select.POLLIN)
    holder.kill()
    assert line.poll(5_000)
    heard_ns = time.monotonic_ns()
    assert gone.poll(5_000)
    assert time.monotonic_ns() >= heard_ns
    holder.wait()


def test_without_a_mutex_the_pidfd_has_to_do(monkeypatch):
    monkeypatch.setattr(lifeline, "_library", lambda: None)
    page_fd = make_page_fd()
    holder = start_holder(page_fd)
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    Lifeline(page_fd).hold()
    assert not line.poll(5)
    holder.kill()
    assert line.poll(5_000)
    holder.wait()


def test_a_mutex_that_nobody_holds_leaves_it_to_the_pidfd():
    page_fd = make_page_fd()
    holder = subprocess.Popen([sys.executable, "-c", "import select; select.poll().poll(60_000)"])
    line = Lifeline(page_fd, os.pidfd_open(holder.pid))
    assert not line.poll(5)
    holder.kill()
    assert line.poll(5_000)
    holder.wait()
