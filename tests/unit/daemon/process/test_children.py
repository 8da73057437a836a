"""Processes of a run: their job, their first line, and whose exit code counts in the end."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.process.children import Child, RunProcesses, spawn
from steerd.daemon.process.prepared import hand_over, prepare, prepared

ECHO = """
import json, os, sys
job = json.load(sys.stdin)
ready = int(sys.argv[-1])
os.write(ready, f"{job['word']} {sys.argv[1:-1]} {os.getpgid(0) == os.getpid()}\\n".encode())
"""


@pytest.fixture
def echo(tmp_path, monkeypatch):
    """A module that reports its job and its arguments on its ready descriptor."""
    (tmp_path / "echo_job.py").write_text(ECHO)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return "echo_job"


def ended(code):
    """A child that has ended with a code, and whose ready descriptor is at its end."""
    read_fd, write_fd = os.pipe()
    os.close(write_fd)
    done = subprocess.Popen([sys.executable, "-c", f"raise SystemExit({code})"])
    return Child(done, read_fd)


def test_a_process_gets_its_job_its_descriptors_and_a_group_of_its_own(echo):
    read_fd, write_fd = os.pipe()
    child = spawn(echo, {"pipe": write_fd}, {"word": "hello"})
    assert child.wait_ready("echo") == f"hello ['{write_fd}'] True"
    assert child.process.wait() == 0
    for fd in (read_fd, write_fd, child.ready_fd):
        os.close(fd)


def test_a_process_that_ends_before_it_is_ready_is_named_with_its_code():
    with pytest.raises(SteerdError, match="the recorder ended with code 7") as caught:
        ended(7).wait_ready("recorder")
    assert caught.value.code is ExitCode.INTERNAL


@pytest.mark.parametrize(
    ("core", "recorder", "viewer", "code"), [(0, 0, 0, 0), (0, 5, 0, 5), (3, 5, 0, 3), (0, 0, 9, 0)]
)
def test_the_cores_code_counts_then_the_recorders_never_the_viewers(
    core, recorder, viewer, code, capsys
):
    ours, theirs = socket.socketpair()
    run = RunProcesses(
        ended(core), ended(recorder), ended(0), ended(viewer), ours, -1, Path("x.mcap"), {}
    )
    assert run.end() == code
    assert theirs.recv(1) == b""  # the core's end of the requests sees that nobody asks any more
    theirs.close()
    assert ("the viewer ended with code 9" in capsys.readouterr().err) is (viewer == 9)


# A process that waits for its job: given one, given none, ended before it came.

WAITER = """
import os
from steerd.daemon.process.prepared import receive_job
job = receive_job()
if job is not None:
    os.write(job.fds["answer"], f"{job.about['word']} {os.getpgid(0) == os.getpid()}".encode())
"""


@pytest.fixture
def waiter(tmp_path, monkeypatch):
    """A module that writes its job's word into the descriptor that it is given."""
    (tmp_path / "waiting_job.py").write_text(WAITER)
    paths = (str(tmp_path), os.environ.get("PYTHONPATH", ""))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(filter(None, paths)))
    return "waiting_job"


def test_a_job_comes_with_its_descriptors_by_name_and_may_be_long(waiter):
    word = "long" * 100_000
    read_fd, write_fd = os.pipe()
    with prepared(waiter) as waiting, os.fdopen(read_fd) as answer:
        hand_over(waiting, {"other": read_fd, "answer": write_fd}, {"word": word})
        os.close(write_fd)
        assert answer.read() == f"{word} True"
        assert waiting.process.wait() == 0


def test_without_a_job_it_ends_by_itself_and_says_nothing(waiter):
    waiting = prepare(waiter)
    waiting.end.close()
    assert waiting.process.wait() == 0


def test_whoever_leaves_without_handing_over_leaves_no_process(waiter):
    with pytest.raises(ValueError, match="no such path"), prepared(waiter) as waiting:
        raise ValueError("no such path")
    assert waiting.process.returncode is not None


def test_a_process_that_has_ended_takes_no_job_and_its_descriptors_are_closed(waiter):
    read_fd, write_fd = os.pipe()
    waiting = prepare(waiter)
    waiting.process.kill()
    waiting.process.wait()
    hand_over(waiting, {"answer": write_fd}, {"word": "late"})
    os.close(write_fd)
    assert os.read(read_fd, 1) == b"", "nobody holds the other end"
    os.close(read_fd)
