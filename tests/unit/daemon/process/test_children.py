"""Processes of a run: whose exit code counts in the end, and whose descriptors are whose."""

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from steerd.daemon.process.child import Child
from steerd.daemon.process.children import Ends, RunProcesses
from steerd.daemon.settings.run_options import RunOptions


def ended(code):
    """A child that has ended with a code."""
    done = subprocess.Popen([sys.executable, "-c", f"raise SystemExit({code})"])
    return Child(done, -1)


@pytest.mark.parametrize(
    ("core", "recorder", "viewer", "code"), [(0, 0, 0, 0), (0, 5, 0, 5), (3, 5, 0, 3), (0, 0, 9, 0)]
)
def test_the_cores_code_counts_then_the_recorders_never_the_viewers(
    core, recorder, viewer, code, capsys
):
    ours, theirs = socket.socketpair()
    codes = {"core": core, "recorder": recorder, "gateway": 0, "viewer": viewer}
    children = {name: ended(each) for name, each in codes.items()}
    run = RunProcesses(children, {"requests": ours.detach()}, Path("x.mcap"), {})
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
    ends.close(keep="terminal")
    kept = set(ends.of["terminal"].values())
    for fd in every:
        if fd in kept:
            os.close(fd)
        else:
            with pytest.raises(OSError, match="Bad file descriptor"):
                os.fstat(fd)
