"""The learner's process: records in, reports out, and readers that lose it."""

import os
from dataclasses import replace
from math import sin

import pytest

from steerd.car_model.car_file import default_car_path, load_car
from steerd.daemon.ipc import pipe_records as pipes
from steerd.daemon.learning.feed import Wiring, make_feed, make_record
from steerd.daemon.process.learner import LearnerLoop
from steerd.steer_bus import messages as m
from steerd.steer_bus import topics
from steerd.steer_bus.codec import decode, encode

EPOCH = 1_700_000_000_000_000_000
TICK_NS = 10_000_000


def pose_record(number):
    """Poses of a car at 100 Hz."""
    t = number * TICK_NS
    header = m.make_header(EPOCH + t, m.WORLD)
    pose = m.MocapPose(
        header, t, t, 0, number, 0, 1, *(0.0,) * 8, 0.01 * number, sin(number), 0.1, 0.1, 0.0, ""
    )
    return pipes.PipeRecord(topics.MOCAP, number, EPOCH + t, EPOCH + t, encode(pose))


@pytest.fixture
def pipe():
    read_fd, write_fd = pipes.make_pipe()
    yield read_fd, write_fd
    for fd in (read_fd, write_fd):
        try:
            os.close(fd)
        except OSError:
            continue  # the test closed it


@pytest.fixture
def loop(pipe):
    feed = make_feed(load_car(default_car_path()), Wiring(EPOCH))
    return LearnerLoop(feed, [pipes.PipeWriter(pipe[1])])


def fed(loop, numbers):
    loop.take(map(pose_record, numbers))


def test_a_report_comes_once_a_second(loop, pipe):
    fed(loop, range(350))
    reports = [decode(m.Model, record.data) for record in pipes.PipeReader(pipe[0]).take()]
    assert [report.mono_ns // 1_000_000_000 for report in reports] == [1, 2, 3]
    assert {report.verdict for report in reports} == {"learning"}
    assert {report.dropped for report in reports} == {0}
    assert m.stamp_ns(reports[0].header) == EPOCH + reports[0].mono_ns


def test_what_was_dropped_on_the_way_is_counted(loop, pipe):
    fed(loop, [*range(50), *range(80, 250)])
    last = list(pipes.PipeReader(pipe[0]).take())[-1]
    assert decode(m.Model, last.data).dropped == 30


def test_bytes_that_are_no_message_are_passed_over(loop, pipe):
    broken = replace(pose_record(60), data=b"\0\1\0\0 nonsense")
    loop.take([pose_record(0), broken])
    fed(loop, range(61, 250))
    assert loop.reports == 2


def test_a_reader_that_does_not_read_costs_reports_alone(loop, pipe):
    pipe_writer = loop.outputs[0]
    pipe_writer.write([bytes(1 << 21)], 0)  # full
    fed(loop, range(350))
    assert loop.reports == 3
    assert pipe_writer.dropped >= 3


def test_a_reader_that_is_gone_costs_reports_alone(loop, pipe):
    os.close(pipe[0])
    fed(loop, range(250))
    assert loop.outputs[0].dead


def test_numbers_that_are_missing_are_counted_by_topic():
    gaps = pipes.Gaps()
    for number in (5, 6, 9, 9, 10):
        gaps.take(pose_record(number))
    assert gaps.missed == 2


def report_record(loop):
    reports = [loop.feed.take(topics.MOCAP, decode(m.MocapPose, pose_record(n).data))
               for n in range(150)]  # fmt: skip
    return make_record(next(r for r in reports if r is not None), 0, EPOCH)


def test_reports_are_read_until_the_learner_ends(loop, pipe):
    reader, packed = pipes.PipeReader(pipe[0]), pipes.pack_record(report_record(loop))
    assert list(reader.take()) == []
    os.write(pipe[1], packed[:50])
    assert list(reader.take()) == []
    os.write(pipe[1], packed[50:])
    assert len(list(reader.take())) == 1
    os.write(pipe[1], packed)
    os.close(pipe[1])
    assert len(list(reader.rest(0))) == 1
    assert reader.fd is None
    assert list(reader.take()) == []


def test_a_run_without_a_learner_has_no_reports():
    assert list(pipes.PipeReader(None).take()) == list(pipes.PipeReader(None).rest(0)) == []
