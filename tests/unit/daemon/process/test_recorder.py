"""Readers of the core's pipe: the recorder, whose file holds everything, and the learner."""

import gc
import os
import sys
import threading
from dataclasses import replace
from math import sin
from types import SimpleNamespace

import pytest

from steerd.daemon.assembly.build import RunId, make_plan
from steerd.daemon.ipc.pipe_records import PipeReader, PipeRecord, pack_record
from steerd.daemon.loop.core import make_core
from steerd.daemon.loop.findings import Flag
from steerd.daemon.process import recorder
from steerd.daemon.process.core_process import latch_stray_exceptions, status_sink
from steerd.daemon.process.learner import LearnerLoop
from steerd.daemon.process.recorder import Recording, check_space, record_pipe
from steerd.daemon.settings.run_options import RunOptions
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode
from steerd.steer_bus.session_read import SessionError, open_session

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


def fed(loop, numbers):
    """The reports that numbered poses complete."""
    return [report for n in numbers if (report := loop.take(pose_record(n))) is not None]


def test_a_report_comes_once_a_second(loop):
    reports = [decode(m.Model, record.data) for record in fed(loop, range(350))]
    assert [report.mono_ns // 1_000_000_000 for report in reports] == [1, 2, 3]
    assert {report.verdict for report in reports} == {"learning"}
    assert {report.dropped for report in reports} == {0}
    assert m.stamp_ns(reports[0].header) == EPOCH + reports[0].mono_ns


def test_what_was_dropped_on_the_way_is_counted(loop):
    last = fed(loop, [*range(50), *range(80, 250)])[-1]
    assert decode(m.Model, last.data).dropped == 30


def test_bytes_that_are_no_message_are_passed_over(loop):
    broken = replace(pose_record(60), data=b"\0\1\0\0 nonsense")
    assert loop.take(pose_record(0)) is loop.take(broken) is None
    numbers = (61, 62, 62, *range(63, 250))  # one twice: nothing is missing
    assert [report.sequence for report in fed(loop, numbers)] == [0, 1]
    assert loop.feed.dropped == 59


def test_reports_are_read_until_the_learner_ends(loop, pipe):
    reader = PipeReader(pipe[0])
    os.write(pipe[1], pack_record(fed(loop, range(150))[0]))
    os.close(pipe[1])
    assert len(list(reader.rest(0))) == 1
    for ended in (reader, PipeReader(None)):
        assert ended.fd is None
        assert list(ended.take()) == list(ended.rest(0)) == []
