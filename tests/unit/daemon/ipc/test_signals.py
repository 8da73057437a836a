"""Stop signals as bytes on a pipe, in a process of their own."""

import os
import select
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from steerd.daemon.ipc.signals import make_notify

TAKE = """
import os, select, signal
from steerd.daemon.ipc.signals import make_stop_signal_pipe
fd = make_stop_signal_pipe()
for number in (15, 2, 1, 2, 2):
    os.kill(os.getpid(), number)
    select.select([fd], [], [], 20)
    print(os.read(fd, 8)[0])
"""
IGNORE = """
import os, signal
from steerd.daemon.ipc.signals import ignore_terminal_signals
ignore_terminal_signals()
for number in (signal.SIGINT, signal.SIGHUP):
    os.kill(os.getpid(), number)
print("alive", flush=True)
os.kill(os.getpid(), signal.SIGTERM)
"""


def python(text):
    argv = [sys.executable, "-c", text]
    return subprocess.run(argv, capture_output=True, text=True, timeout=60, check=False)


def test_each_stop_signal_is_one_byte_its_number():
    done = python(TAKE)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["15", "2", "1", "2", "2"]


def test_a_child_lives_through_what_the_terminal_sends_to_its_group_but_can_be_ended():
    done = python(IGNORE)
    assert (done.stdout, done.returncode) == ("alive\n", -signal.SIGTERM)


CHILD = """
import os, signal, sys
from steerd.daemon.ipc.signals import ignore_terminal_signals
ignore_terminal_signals()
print(os.getpid(), flush=True)
os.kill(os.getpid(), signal.SIGSTOP)
os.read(0, 1)
"""
PARENT = """
import subprocess, sys
subprocess.Popen([sys.executable, "-c", sys.argv[1]], stdin=subprocess.PIPE).wait()
"""


def test_a_frozen_child_ends_when_its_parent_is_killed():
    argv = [sys.executable, "-c", PARENT, CHILD]
    parent = subprocess.Popen(argv, stdout=subprocess.PIPE, text=True)
    child = os.pidfd_open(pid := int(parent.stdout.readline()))
    while "State:\tT" not in Path(f"/proc/{pid}/status").read_text():
        select.select([child], [], [], 0.01)
    parent.kill()
    parent.communicate()
    ended, _, _ = select.select([child], [], [], 20.0)
    os.close(child)
    if not ended:
        os.kill(pid, signal.SIGKILL)
    assert ended


HOLDER = """
import sys, time
from steerd.daemon.ipc.signals import raise_on_stop_signals
try:
    raise_on_stop_signals()
    print("holding", flush=True)
    sys.stdin.read()
except KeyboardInterrupt:
    print("let go", flush=True)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_holder_started_in_the_background_can_be_interrupted(number):
    """A shell without job control starts it with SIGINT ignored."""
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDER], text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
    )  # fmt: skip
    assert holder.stdout.readline() == "holding\n"
    holder.send_signal(number)
    out, _ = holder.communicate(timeout=60)
    assert (out, holder.returncode) == ("let go\n", 0)


# Notices to a service manager: they arrive, never block, and need no manager.
@pytest.mark.parametrize("abstract", [False, True])
def test_notifications_arrive_and_never_block(tmp_path, abstract):
    name = f"@steerd-test-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + name[1:] if abstract else name)
        manager.settimeout(2.0)
        notify = make_notify({"NOTIFY_SOCKET": name})
        notify("READY=1")
        assert manager.recv(64) == b"READY=1"
        for _ in range(2000):  # more than the queue holds
            notify("WATCHDOG=1")
    notify("WATCHDOG=1")  # the manager is gone
    make_notify({})("READY=1")
    make_notify({"NOTIFY_SOCKET": "elsewhere"})("READY=1")
