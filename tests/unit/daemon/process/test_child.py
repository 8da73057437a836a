"""A process and its job, and the processes of a run: descriptors, ends, exit codes."""

import os
import socket
import subprocess
from contextlib import closing
from types import SimpleNamespace

import pytest

from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.process.child import Child
from steerd.daemon.process.children import Ends, RunProcesses
from steerd.daemon.settings.run_options import RunOptions

WAITER = """
import os
from steerd.daemon.process.child import receive_job
job = receive_job()
if job is not None:
    job.say_ready(word=job.about["word"], leads=os.getpgid(0) == os.getpid())
    os.write(job.fds["answer"], b"done")
"""


@pytest.fixture
def waiter(tmp_path, monkeypatch):
    """A module that writes its job's word into the descriptor that it is given."""
    (tmp_path / "waiting_job.py").write_text(WAITER)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    return "waiting_job"


def test_a_job_comes_with_its_descriptors_by_name_and_may_be_long(waiter):
    word = "long" * 100_000
    read_fd, write_fd = os.pipe()
    with closing(Child(waiter)) as child, os.fdopen(read_fd) as answer:
        child.hand_over({"other": read_fd, "answer": write_fd}, {"word": word})
        os.close(write_fd)
        assert child.wait_ready("waiter") == {"word": word, "leads": True}
        assert answer.read() == "done"
        assert child.process.wait() == 0
        os.close(child.ready_fd)


def test_a_process_that_ends_before_it_is_ready_is_named_with_its_code(tmp_path, waiter):
    (tmp_path / "ending.py").write_text("raise SystemExit(7)")
    with pytest.raises(SteerdError, match="the recorder ended with code 7") as caught:
        Child("ending").hand_over({}, {}).wait_ready("recorder")
    assert caught.value.code is ExitCode.INTERNAL


def test_without_a_job_it_ends_by_itself_and_says_nothing(waiter):
    waiting = Child(waiter)
    waiting.end.close()
    assert waiting.process.wait() == 0


def test_whoever_leaves_without_handing_over_leaves_no_process(waiter):
    with pytest.raises(ValueError, match="no such path"), closing(Child(waiter)) as waiting:
        raise ValueError("no such path")
    assert waiting.process.returncode is not None


def test_a_process_that_has_ended_takes_no_job_and_its_descriptors_are_closed(waiter):
    read_fd, write_fd = os.pipe()
    waiting = Child(waiter)
    waiting.process.kill()
    waiting.process.wait()
    waiting.hand_over({"answer": write_fd}, {"word": "late"})
    os.close(write_fd)
    for fd in (read_fd, waiting.ready_fd):
        assert os.read(fd, 1) == b"", "nobody holds the other end"
        os.close(fd)


# Processes of a run: whose exit code counts in the end, and whose descriptors are whose.
def ended(code):
    """A child that has ended with a code."""
    return SimpleNamespace(process=subprocess.Popen(["sh", "-c", f"exit {code}"]))


@pytest.mark.parametrize(
    ("core", "recorder", "viewer", "code"), [(0, 0, 0, 0), (0, 5, 0, 5), (3, 5, 0, 3), (0, 0, 9, 0)]
)
def test_the_cores_code_counts_then_the_recorders_never_the_viewers(
    core, recorder, viewer, code, capsys
):
    ours, theirs = socket.socketpair()
    codes = {"core": core, "recorder": recorder, "gateway": 0, "viewer": viewer}
    children = {name: ended(each) for name, each in codes.items()}
    run = RunProcesses(children, {"requests": ours.detach()}, {})
    assert run.end() == code
    assert theirs.recv(1) == b""  # the core's end of the requests sees that nobody asks any more
    theirs.close()
    assert ("the viewer ended with code 9" in capsys.readouterr().err) is (viewer == 9)


@pytest.mark.parametrize("asked", [False, True])
def test_every_end_belongs_to_one_process_and_the_terminal_keeps_its_own(asked):
    options = {"learn": asked, "adapt": asked, "view": "1" * asked, "view_sets": asked}
    ends = Ends(RunOptions(car_file="", **options))
    every = [fd for fds in ends.of.values() for fd in fds.values()]
    assert len(set(every)) == len(every)
    always = {"core", "recorder", "gateway", "terminal"}
    assert set(ends.of) == always | ({"learner", "view"} if asked else set())
    told = {name for name, fds in ends.of.items() if "reports" in fds}
    assert told == ({"recorder", "gateway", "terminal", "view"} if asked else set())
    ends.close(keep="terminal")
    kept = set(ends.of["terminal"].values())
    for fd in every:
        if fd in kept:
            os.close(fd)
        else:
            with pytest.raises(OSError, match="Bad file descriptor"):
                os.fstat(fd)
