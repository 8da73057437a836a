"""Processes of a run: their jobs, ends and codes; the recorder, whose file holds everything."""

import gc
import os
import socket
import subprocess
import sys
import threading
from contextlib import closing
from dataclasses import replace
from math import sin
from types import SimpleNamespace

import pytest

from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.common.errors import ExitCode, SteerdError
from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord, pack_record
from steerd.daemon.loop.core import make_core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.process import recorder
from steerd.daemon.process.child import Child
from steerd.daemon.process.children import Ends, RunProcesses
from steerd.daemon.process.core_process import latch_stray_exceptions, status_sink
from steerd.daemon.process.learner import LearnerLoop
from steerd.daemon.process.recorder import Recording, check_space, record_pipe
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.session_read import SessionError, open_session

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


def test_without_a_job_it_ends_by_itself_and_whoever_hands_none_over_leaves_no_process(waiter):
    waiting = Child(waiter)
    waiting.end.close()
    assert waiting.process.wait() == 0
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
@pytest.mark.parametrize(
    ("core", "recorder", "viewer", "code"), [(0, 0, 0, 0), (0, 5, 0, 5), (3, 5, 0, 3), (0, 0, 9, 0)]
)
def test_the_exit_code_is_the_cores_or_the_recorders(core, recorder, viewer, code, capsys):
    ours, theirs = socket.socketpair()
    codes = {"core": core, "recorder": recorder, "gateway": 0, "viewer": viewer}
    began = {name: subprocess.Popen(["sh", "-c", f"exit {each}"]) for name, each in codes.items()}
    children = {name: SimpleNamespace(process=process) for name, process in began.items()}
    run = RunProcesses(children, {"requests": ours.detach()}, {})
    assert not run.requests.getblocking(), "a core that is frozen does not freeze its terminal"
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


# Readers of the core's pipe: the recorder, whose file holds everything, and the learner.
META = {
    "car": "car1", "metadata": {"steerd.session": {"car": "car1"}},
    "attachments": {"car.toml": "x = 1"}, "start_ns": 0,
}  # fmt: skip


def make_packed(count):
    request = m.OperatorRequest(m.make_header(5, m.BODY), 1, 2, 3, int(m.RequestKind.STOP), "desk")
    data = encode(request)
    return [pack_record(PipeRecord(topics.OPERATOR, k, k + 1, k + 1, data)) for k in range(count)]


def record(tmp_path, chunks, disk_free_min=0):
    """Record chunks from a pipe that is then closed; the reason and the session."""
    recording = Recording({**META, "path": tmp_path / "drive.mcap"})
    read_fd, write_fd = os.pipe()
    for chunk in chunks:
        os.write(write_fd, chunk)
    os.close(write_fd)
    reason = record_pipe(recording, PipeReader(read_fd), disk_free_min, PipeReader(None))
    recording.writer.finish({"reason": reason, "written": str(recording.written)})
    return reason, open_session(tmp_path / "drive.mcap")


def test_every_whole_record_before_the_end_of_the_pipe_is_written(tmp_path):
    *whole, last = make_packed(5)
    reason, session = record(tmp_path, [*whole, last[:-3]])
    assert reason == "end of the run"
    assert [message.log_ns for message in session.messages()] == [1, 2, 3, 4]
    assert session.attachment("car.toml") == b"x = 1"


def test_a_nearly_full_disk_ends_the_recording_with_a_complete_file(tmp_path, monkeypatch):
    usage = SimpleNamespace(free=99)
    monkeypatch.setattr(recorder.shutil, "disk_usage", lambda _path: usage)
    reason, session = record(tmp_path, make_packed(2), disk_free_min=100)
    assert reason == "disk nearly full"
    assert len(list(session.messages())) == 2


def test_a_recording_that_would_end_at_once_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder.shutil, "disk_usage", lambda _path: SimpleNamespace(free=100))
    check_space(tmp_path / "drive.mcap", 100)
    with pytest.raises(SessionError, match="0 MB left, less than") as caught:
        check_space(tmp_path / "drive.mcap", 101)
    assert "free some space" in caught.value.hint
    monkeypatch.undo()
    with pytest.raises(SessionError, match="No such file"):
        check_space(tmp_path / "none" / "drive.mcap", 0)


class Broken:
    """Raises when it is collected."""

    def __del__(self):
        raise LookupError("nobody catches this")


@pytest.mark.parametrize("where", ["thread", "destructor"])
def test_w29_an_exception_without_a_caller_stops_the_car_for_good(monkeypatch, where):
    core = make_core(make_plan(RunOptions(car_file="", path="line")), ())
    for place, hook in ((sys, "unraisablehook"), (threading, "excepthook")):
        monkeypatch.setattr(place, hook, getattr(place, hook))
    latch_stray_exceptions(core)
    if where == "thread":
        thread = threading.Thread(target=lambda: [][1])
        thread.start()
        thread.join()
    else:
        Broken()
        gc.collect()
    assert isinstance(core.error, LookupError)
    assert core.flags == Flag.EXCEPTION


def test_the_terminal_gets_changes_at_once_and_the_rest_ten_times_a_second():
    written = []
    pipe = SimpleNamespace(write=lambda packed, t_ns: written.append((t_ns, len(packed))))
    sink, told = status_sink(pipe), (topics.STATE, topics.TRANSITION, topics.IMU)
    records = [PipeRecord(topic, 0, 0, 0, b"") for topic in told]
    for t_ns in (0, 50_000_000, 100_000_000):
        sink(records, t_ns)
    assert written == [(0, 2), (50_000_000, 1), (100_000_000, 2)]


# The learner's process: records in, reports out, and readers that lose it.
EPOCH = 1_700_000_000_000_000_000
TICK_NS = 10_000_000


def pose_record(number):
    """Poses of a car at 100 Hz."""
    t = number * TICK_NS
    at = (0.01 * number, sin(number), 0.1, 0.1, 0.0)
    header = m.make_header(EPOCH + t, m.WORLD)
    pose = m.MocapPose(header, t, t, 0, number, 0, 1, *(0.0,) * 8, *at, "")
    return PipeRecord(topics.MOCAP, number, EPOCH + t, EPOCH + t, encode(pose))


@pytest.fixture
def loop():
    real = RunId(1, EPOCH, leased=False)
    plan = make_plan(RunOptions(car_file="", path="line", learn=True), design=False, real=real)
    return LearnerLoop(plan, lambda data, t_ns: None)


def test_bytes_that_are_no_message_are_passed_over_and_what_was_dropped_is_counted(loop):
    broken = replace(pose_record(60), data=b"\0\1\0\0 nonsense")
    assert loop.take(pose_record(0)) is loop.take(broken) is None
    numbers = (61, 62, 62, *range(63, 250))  # one twice: nothing is missing
    reports = [report for n in numbers if (report := loop.take(pose_record(n))) is not None]
    assert [report.sequence for report in reports] == [0, 1]
    said = [decode(m.Model, report.data) for report in reports]
    assert [report.mono_ns // 1_000_000_000 for report in said] == [1, 2], "once a second"
    assert {report.verdict for report in said} == {"learning"}
    assert m.stamp_ns(said[0].header) == EPOCH + said[0].mono_ns
    assert said[-1].dropped == loop.feed.dropped == 59


def test_reports_are_read_until_the_learner_ends(pipe):
    reader = PipeReader(pipe[0])
    os.write(pipe[1], make_packed(1)[0])
    os.close(pipe[1])
    assert len(list(reader.rest(0))) == 1
    for ended in (reader, PipeReader(None)):
        assert ended.fd is None
        assert list(ended.take()) == list(ended.rest(0)) == []
